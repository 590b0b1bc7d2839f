"""A solution as NMEA 0183 sentences for plotters and autopilots: GGA, RMC, VTG, HDT, ROT and PASHR.

A field that is not known, or not valid, is empty; the talker is GP, which every listener accepts. Positions are WGS-84,
altitudes above mean sea level if the receiver reports the geoid, angles true.

Source: NMEA 0183 4.11; PASHR as in Hemisphere's and Applanix' manuals (right side down and bow up are positive).
"""

import functools
import math
import operator
import time
from collections.abc import Callable

from ..estimators.records import ATTITUDE_VALID, COASTING, HEADING_VALID, POSITION_VALID
from .view import State, View, decode, euler

_KNOT = 1852.0 / 3600.0  # m/s
_ESTIMATED = 6
_MODES = {2: "D", 4: "R", 5: "F", _ESTIMATED: "E"}  # of GGA's quality; else A


def sentences(view: View) -> bytes:
    """All sentences of one instant, in the order of `_SENTENCES`."""
    whole = view, decode(view.solution)
    position = (view.receiver, decode(view.receiver.solution)) if view.receiver else whole
    return b"".join(_with_checksum(make(*(position if make in _OF_POSITION else whole))) for make in _SENTENCES)


def _with_checksum(body: str) -> bytes:
    data = body.encode("ascii")
    return b"$%b*%02X\r\n" % (data, functools.reduce(operator.xor, data, 0))


def _number(form: str, value: float) -> str:
    return form % value if math.isfinite(value) else ""


def _microseconds(utc_s: float) -> int:
    """Rounded, so that a time that is a float and not quite 0.2 s has no 19 hundredths."""
    return round(utc_s * 1e6)


def _clock(view: View) -> str:
    if view.utc_s is None:
        return ""
    second, hundredth = divmod(_microseconds(view.utc_s) // 10_000, 100)
    return time.strftime("%H%M%S", time.gmtime(second)) + f".{hundredth:02d}"


def _date(view: View) -> str:
    return "" if view.utc_s is None else time.strftime("%d%m%y", time.gmtime(_microseconds(view.utc_s) // 1_000_000))


def _degrees(value: float, width: int, positive: str, negative: str) -> str:
    """`ddmm.mmmmmm,N`. Rounded as a whole, so that no minute is 60."""
    if not math.isfinite(value):
        return ","
    degrees, minutes = divmod(round(abs(value) * 60e6), 60_000_000)
    whole, millionths = divmod(minutes, 1_000_000)
    return f"{degrees:0{width}d}{whole:02d}.{millionths:06d},{positive if value >= 0.0 else negative}"


def _position(state: State) -> str:
    return _degrees(state.lat, 2, "N", "S") + "," + _degrees(state.lon, 3, "E", "W")


def _quality(view: View, state: State) -> int:
    if not state.status & POSITION_VALID:
        return 0
    if state.status & COASTING or view.gnss is None or not view.gnss.quality:
        return _ESTIMATED
    return view.gnss.quality


def _course(state: State) -> tuple[float, float]:
    """Course over ground in deg, NaN if the speed is not certain enough to have one; speed in m/s."""
    north, east, _ = state.v
    speed = math.hypot(north, east)
    known = speed > 2.0 * math.hypot(*state.sigma_v[:2])
    return (round(math.degrees(math.atan2(east, north)), 2) % 360.0 if known else math.nan), speed


def _mode(view: View, state: State) -> str:
    quality = _quality(view, state)
    return _MODES.get(quality, "A") if quality else "N"


def gga(view: View, state: State) -> str:
    gnss, quality = view.gnss, _quality(view, state)
    separation = gnss.geoid_sep if gnss and quality else math.nan
    satellites = "" if gnss is None or gnss.satellites is None else f"{gnss.satellites:02d}"
    hdop = _number("%.1f", gnss.hdop) if gnss else ""
    altitude = _number("%.3f", state.height - (0.0 if gnss and gnss.height_is_msl else separation))
    return (
        f"GPGGA,{_clock(view)},{_position(state)},{quality},{satellites},{hdop},"
        f"{altitude},M,{_number('%.3f', separation)},M,,"
    )


def rmc(view: View, state: State) -> str:
    course, speed = _course(state)
    mode = _mode(view, state)
    valid = "V" if mode == "N" else "A"
    knots, track = _number("%.3f", speed / _KNOT), _number("%.2f", course)
    return f"GPRMC,{_clock(view)},{valid},{_position(state)},{knots},{track},{_date(view)},,,{mode}"


def vtg(view: View, state: State) -> str:
    course, speed = _course(state)
    knots, kmh = _number("%.3f", speed / _KNOT), _number("%.3f", speed * 3.6)
    return f"GPVTG,{_number('%.2f', course)},T,,M,{knots},N,{kmh},K,{_mode(view, state)}"


def _angles(state: State) -> tuple[float, float, float]:
    """Roll, pitch and heading in deg; NaN where not valid."""
    roll, pitch, yaw = euler(state.q_nb)
    if not state.status & ATTITUDE_VALID:
        return math.nan, math.nan, math.nan
    return roll, pitch, (round(yaw, 2) % 360.0 if state.status & HEADING_VALID else math.nan)


def hdt(view: View, state: State) -> str:
    return f"GPHDT,{_number('%.2f', _angles(state)[2])},T"


def rot(view: View, state: State) -> str:
    """Rate of turn in deg/min, to starboard positive."""
    roll, pitch, _ = (math.radians(angle) for angle in _angles(state))
    level = math.cos(pitch)
    rate = (state.w[1] * math.sin(roll) + state.w[2] * math.cos(roll)) / level if level > 1e-3 else math.nan
    return f"GPROT,{_number('%.2f', 60.0 * rate)},{'A' if math.isfinite(rate) else 'V'}"


def pashr(view: View, state: State) -> str:
    roll, pitch, heading = _angles(state)
    angles_and_sigmas = zip(_angles(state), state.sigma_rpy, strict=True)
    sigmas = (sigma if math.isfinite(angle) else math.nan for angle, sigma in angles_and_sigmas)
    errors = ",".join(_number("%.3f", sigma) for sigma in sigmas)
    quality = {0: 0, 4: 2, 5: 2}.get(_quality(view, state), 1)
    aligned = int(bool(state.status & ATTITUDE_VALID))
    return (
        f"PASHR,{_clock(view)},{_number('%.2f', heading)},T,{_number('%+.2f', roll)},{_number('%+.2f', pitch)},,"
        f"{errors},{quality},{aligned}"
    )


# RMC is the last with a time: gpsd ends the burst with the last one, and reports no position if that is PASHR.
_SENTENCES: tuple[Callable[[View, State], str], ...] = (gga, vtg, hdt, rot, pashr, rmc)
_OF_POSITION = (gga, vtg, rmc)
