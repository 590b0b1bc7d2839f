"""A solution as gpsd's JSON messages: which field carries what, in which unit, and when it is left out.

Unknown is NaN, and a number that is not finite is never printed: its key is left out. Objects are compact, begin with
their class and hold flat scalars only, because gpsd's clients depend on it. `EST` is a class of our own, with the keys
and units of `imud replay`'s est.csv; gpsd's clients ignore it. `STATES`, for which a client must ask, has those of
states.csv. Errors in gpsd's fields are 95 % bounds, those in `EST` and `STATES` one sigma.

Source: gpsd_json(5); gpsd 3.22, 3.25 and 3.27.5 tried.
"""

import functools
import math
from collections.abc import Callable

from ..estimators.records import (
    AT_REST,
    ATTITUDE_VALID,
    COASTING,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
    REJECTING,
    SATURATED,
)
from ..sensors.readings import NO_VECTOR, ReceiverReport
from .gpsd_fix import fix_object
from .gpsd_objects import Numbers, head, line, quoted, time_of
from .gpsd_sky import sky_object
from .view import NAN, NO_SOLUTION, State, Vector, View, decode, euler


def _bound95(*sigmas: float) -> float:
    """Radius that holds 95 % of an error with independent normal components: within 1.5 % for any of their ratios.

    Satterthwaite's chi-square for the sum of squares, its quantile after Wilson and Hilferty (1931).
    """
    largest = max(map(abs, sigmas))
    if not largest > 0.0:
        return largest
    squares = [(s / largest) ** 2 for s in sigmas]
    mean = sum(squares)
    a = 2.0 / 9.0 * sum(s * s for s in squares) / (mean * mean)
    return largest * math.sqrt(mean * (1.0 - a + 1.6448536 * math.sqrt(a)) ** 3)


_NORMAL95 = 1.959964
_TPV = Numbers(
    ept="%.3g", lat="%.12g", lon="%.12g", altHAE="%.9g", altMSL="%.9g", alt="%.9g", geoidSep="%.6g",
    epx="%.4g", epy="%.4g", epv="%.4g", eph="%.4g", sep="%.4g",
    track="%.7g", speed="%.7g", climb="%.6g", epd="%.4g", eps="%.4g", epc="%.4g",
    velN="%.7g", velE="%.7g", velD="%.7g",
)  # fmt: skip


def _motion(s: State) -> Vector:
    """Track, speed, climb and their bounds epd, eps, epc. A track known to less than a quarter turn is no track."""
    (vn, ve, vd), (sn, se, sd) = s.v, s.sigma_v
    speed = math.hypot(vn, ve)
    if speed > 0.0:
        along, across = math.hypot(vn * sn, ve * se) / speed, math.hypot(ve * sn, vn * se) / speed
        epd = math.degrees(_NORMAL95 * across / speed)
    else:
        along, epd = max(sn, se), NAN
    known = epd < 90.0
    track = math.degrees(math.atan2(ve, vn)) % 360.0 if known else NAN
    return track, speed, 0.0 - vd, epd if known else NAN, _NORMAL95 * along, _NORMAL95 * sd


def _altitudes(s: State, gnss: ReceiverReport | None) -> tuple[float, float]:
    """Above the ellipsoid, and above sea level."""
    if gnss is None:
        return s.height, NAN
    return (NAN, s.height) if gnss.height_is_msl else (s.height, s.height - gnss.geoid_sep)


_DEAD_RECKONING, _GNSS_AND_DEAD_RECKONING, _SIMULATED = 5, 6, 8
_OF_QUALITY = {2: 2, 4: 3, 5: 4, 8: _SIMULATED}  # of GGA: differential, RTK, float RTK


def _fix(view: View, s: State) -> str:
    """`status` where gpsd defines one, and `mode`: 0 no data yet, 1 no position, 2 no height, 3 all."""
    if not s.status & POSITION_VALID:
        return f',"mode":{0 if view.solution == NO_SOLUTION and view.gnss is None else 1}'
    mode = f',"mode":{3 if s.status & HEIGHT_VALID else 2}'
    if not view.estimator:
        status = _OF_QUALITY.get(view.gnss.quality or 0) if view.gnss else None
        return f',"status":{status}{mode}' if status else mode
    status = _SIMULATED if view.emulated else _DEAD_RECKONING if s.status & COASTING else _GNSS_AND_DEAD_RECKONING
    return f',"status":{status}{mode}'


def _tpv(view: View, s: State) -> str:
    sn, se, sd = s.sigma_p
    hae, msl = _altitudes(s, view.gnss)
    geoid_sep = view.gnss.geoid_sep if view.gnss else NAN
    numbers = _TPV(
        view.utc_error_s if view.utc_s is not None else NAN, s.lat, s.lon, hae, msl, msl, geoid_sep,
        _NORMAL95 * se, _NORMAL95 * sn, _NORMAL95 * sd, _bound95(sn, se), _bound95(sn, se, sd),
        *_motion(s), *s.v,
    )  # fmt: skip
    return f"{head('TPV', view)}{_fix(view, s)}{time_of(view)}{numbers}}}"


def _turn_rate(roll: float, pitch: float, w: Vector) -> float:
    """Rate of the heading in the unit of w, positive to starboard; NaN where it is not defined, pitch near 90 deg."""
    cos_pitch = math.cos(math.radians(pitch))
    if cos_pitch < 0.01:
        return NAN
    r = math.radians(roll)
    return (w[1] * math.sin(r) + w[2] * math.cos(r)) / cos_pitch


_ATT = Numbers(
    heading="%.7g", yaw="%.7g", pitch="%.6g", roll="%.7g", rot="%.6g",
    acc_len="%.7g", acc_x="%.7g", acc_y="%.7g", acc_z="%.7g", gyro_x="%.7g", gyro_y="%.7g", gyro_z="%.7g", temp="%.5g",
)  # fmt: skip


def _att(view: View, s: State) -> str:
    """Body axes FRD, specific force in m/s^2, gyros in deg/s, `rot` in deg/min."""
    roll, pitch, yaw = euler(s.q_nb) if s.status & ATTITUDE_VALID else NO_VECTOR
    if not s.status & HEADING_VALID:
        yaw = NAN
    rot = 60.0 * _turn_rate(roll, pitch, s.w)
    numbers = _ATT(yaw % 360.0, yaw, pitch, roll, rot, math.hypot(*s.f), *s.f, *s.w, view.temperature)
    return f"{head('ATT', view)}{time_of(view)}{numbers}}}"


_IMU = Numbers(
    gyro_x="%.7g", gyro_y="%.7g", gyro_z="%.7g", acc_x="%.7g", acc_y="%.7g", acc_z="%.7g", acc_len="%.7g", temp="%.5g",
)  # fmt: skip


def _imu(view: View, s: State) -> str:
    """The sensor's last sample, without bias correction, in ATT's axes and units."""
    rates, forces = map(math.degrees, view.sensed[:3]), view.sensed[3:]
    numbers = _IMU(*rates, *forces, math.hypot(*forces), view.temperature)
    return f'{head("IMU", view)}{time_of(view)},"msg":"imud"{numbers}}}'


STATUS_NAMES = {
    ATTITUDE_VALID: "attitude",
    HEADING_VALID: "heading",
    POSITION_VALID: "position",
    HEIGHT_VALID: "height",
    AT_REST: "at-rest",
    COASTING: "coasting",
    REJECTING: "rejecting",
    SATURATED: "saturated",
}


@functools.lru_cache(maxsize=256)
def status_text(status: int) -> str:
    """The status bits by name, separated by commas; "aligning" when nothing is valid yet."""
    names = [word for bit, word in STATUS_NAMES.items() if status & bit]
    return ",".join(names if status & ATTITUDE_VALID else ["aligning", *names])


_EST = Numbers(
    lat_deg="%.12g", lon_deg="%.12g", height_m="%.9g", vn_mps="%.7g", ve_mps="%.7g", vd_mps="%.7g",
    roll_deg="%.7g", pitch_deg="%.7g", yaw_deg="%.7g",
    sn_m="%.4g", se_m="%.4g", sd_m="%.4g", svn_mps="%.4g", sve_mps="%.4g", svd_mps="%.4g",
    sroll_deg="%.4g", spitch_deg="%.4g", syaw_deg="%.4g", q0="%.9g", q1="%.9g", q2="%.9g", q3="%.9g",
    bgx_dps="%.6g", bgy_dps="%.6g", bgz_dps="%.6g", bax_mps2="%.6g", bay_mps2="%.6g", baz_mps2="%.6g",
    sbgx_dps="%.4g", sbgy_dps="%.4g", sbgz_dps="%.4g", sbax_mps2="%.4g", sbay_mps2="%.4g", sbaz_mps2="%.4g",
    gnss_age_s="%.4g", gnss_quality="%.4g", clock_residual_us="%.4g", clock_drift_ppm="%.4g",
    sclock_drift_ppm="%.4g",
)  # fmt: skip


def _health_of(sensor: str, faults: tuple[str, ...] | None) -> str:
    """The field, or nothing where there is no such sensor."""
    return "" if faults is None else f',"{sensor}_health":{quoted("; ".join(faults) or "ok")}'


def _out_of_limits(names: tuple[str, ...]) -> str:
    return f',"out_of_limits":"{",".join(names)}"' if names else ""


def _est(view: View, s: State) -> str:
    gnss = view.gnss or ReceiverReport()
    numbers = _EST(
        s.lat, s.lon, s.height, *s.v, *euler(s.q_nb), *s.sigma_p, *s.sigma_v, *s.sigma_rpy, *s.q_nb,
        *s.bg, *s.ba, *s.sigma_bg, *s.sigma_ba, gnss.age_s, NAN if gnss.quality is None else gnss.quality,
        *(1e6 * number for number in view.health.clock),
    )  # fmt: skip
    return (
        f'{head("EST", view)}{time_of(view)},"t_mono_ns":{view.t_mono_ns},"seq":{view.seq}'
        f',"estimator":{quoted(view.estimator)},"status":{s.status},"state":"{status_text(s.status)}"'
        f"{_health_of('imu', view.health.imu)}{_health_of('gnss', view.health.gnss)}"
        f"{_out_of_limits(view.health.out_of_limits)}{numbers}}}"
    )


def _states(view: View) -> str:
    numbers = "".join(f',"{name}":{number:.9g}' for name, number in view.states().items() if math.isfinite(number))
    return f'{head("STATES", view)}{time_of(view)},"t_mono_ns":{view.t_mono_ns}{numbers}}}'


_ENCODERS: dict[str, Callable[[View, State], str]] = {
    "TPV": _tpv,
    "SKY": lambda view, _: sky_object(view),
    "ATT": _att,
    "IMU": _imu,
    "EST": _est,
    "FIX": lambda view, _: fix_object(view),
    "STATES": lambda view, _: _states(view),
}
CLASSES = tuple(_ENCODERS)
DEFAULT_CLASSES = tuple(kind for kind in CLASSES if kind not in ("FIX", "STATES"))


class Report:
    """The messages of one view, each encoded when it is first asked for."""

    def __init__(self, view: View) -> None:
        self.view = view
        self._state = decode(view.solution)
        self._position = (view.receiver, decode(view.receiver.solution)) if view.receiver else (view, self._state)
        self._objects: dict[str, str] = {}
        self._lines: dict[tuple[str, ...], bytes] = {}

    def object(self, kind: str) -> str:
        """One of CLASSES as a JSON object."""
        if kind not in self._objects:
            source = self._position if kind == "TPV" else (self.view, self._state)
            self._objects[kind] = _ENCODERS[kind](*source)
        return self._objects[kind]

    def lines(self, kinds: tuple[str, ...]) -> bytes:
        """Messages as bytes; those without data are left out."""
        if kinds not in self._lines:
            empty = set() if self.view.estimator else {"ATT", "IMU", "EST", "STATES"}
            if self.view.gnss is None:
                empty.add("SKY")
            if self.view.gnss is None or not self.view.gnss.fix:
                empty.add("FIX")
            self._lines[kinds] = line(*(self.object(kind) for kind in kinds if kind not in empty))
        return self._lines[kinds]

    def poll(self, watched: bool) -> str:
        """The answer to ?POLL as an object; empty lists for a client that does not watch."""
        tpv, sky = (self.object("TPV"), self.object("SKY")) if watched else ("", "")
        active = len(self.view.devices) if watched else 0
        return f'{{"class":"POLL"{time_of(self.view)},"active":{active},"tpv":[{tpv}],"gst":[],"sky":[{sky}]}}'
