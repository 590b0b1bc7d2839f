"""The figures of a report, panel by panel, each axis with its unit."""

import math
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from drivers import sample as flag
from imud.estimators.records import (
    AT_REST,
    ATTITUDE_VALID,
    COASTING,
    HEADING_VALID,
    POSITION_VALID,
    REJECTING,
    SATURATED,
)
from imud.figures import Figure, Panel, Trace
from imud.kernels.earth import radii

from .session import Clock, Estimates, Fixes, Innovations, Sensor, Session
from .statistics import LEAST, autocorrelation, chi2_bounds, moving_mean

Floats = NDArray[np.float64]
TIME = "time, s"
RADIUS_95 = math.sqrt(-2.0 * math.log(0.05))  # of a plane normal distribution, in sigmas
ELLIPSES = 40  # along the track
WINDOW = 20  # normalised innovations whose mean square is one point
UNSEEN = 10.0  # medians: a sigma of the start that would leave nothing else to be seen
BINS = np.arange(-5.0, 5.01, 0.25)
STATUS = {
    "attitude valid": ATTITUDE_VALID,
    "heading valid": HEADING_VALID,
    "position valid": POSITION_VALID,
    "at rest": AT_REST,
    "coasting": COASTING,
    "rejecting": REJECTING,
    "saturated": SATURATED,
}
FLAGS = {
    "suspect": flag.SUSPECT,
    "device error": flag.DEVICE_ERROR,
    "saturated": flag.SATURATED,
    "no rate": flag.NO_RATE,
    "no force": flag.NO_FORCE,
}


def _wrapped(yaw: Floats) -> Floats:
    """Degrees within half a turn of north; where it jumps, nothing."""
    y = yaw - 360.0 * np.round(yaw / 360.0)
    return np.where(np.abs(np.diff(y, prepend=y[:1])) > 180.0, np.nan, y)


def _states(session: Session, title: str, unit: str, names: Iterable[str], factor: float = 1.0) -> Figure:
    """Panels of the columns `names`, each with its 1 sigma, every estimate in them."""
    panels = []
    for name in names:
        traces = []
        for e in session.estimates:
            y, sigma = factor * e.columns[name], factor * e.columns[f"s{name}"]
            y = _wrapped(y) if name == "yaw_deg" else y
            if np.isfinite(y).any():
                traces.append(Trace(e.name, e.columns["t_s"], y, sigma))
        panels.append(Panel(name.rpartition("_")[0], TIME, unit, traces))
    return Figure(title, panels, columns=3)


def _origin(session: Session) -> tuple[float, float] | None:
    """Latitude and longitude in degrees of the first position known."""
    for e in session.estimates:
        known = np.flatnonzero(np.isfinite(e.columns["lat_deg"]))
        if len(known):
            return float(e.columns["lat_deg"][known[0]]), float(e.columns["lon_deg"][known[0]])
    for fixes in session.fixes:
        if len(fixes.rows):
            return math.degrees(fixes.rows["lat"][0]), math.degrees(fixes.rows["lon"][0])
    return None


def _grid(lat_deg: float, lon_deg: float) -> Callable[[Floats, Floats], tuple[Floats, Floats]]:
    """From degrees to metres (north, east) of the plane that touches the ellipsoid there."""
    lat = math.radians(lat_deg)
    meridian, normal = radii(lat)

    def metres(lats: Floats, lons: Floats) -> tuple[Floats, Floats]:
        turned = np.mod(lons - lon_deg + 180.0, 360.0) - 180.0
        return np.radians(lats - lat_deg) * meridian, np.radians(turned) * normal * math.cos(lat)

    return metres


def _ellipses(north: Floats, east: Floats, sn: Floats, se: Floats) -> tuple[Floats, Floats]:
    """Outlines (north, east) of the 95 % ellipses about some of the points, with axes along north and east."""
    known = np.flatnonzero(np.isfinite(north) & np.isfinite(sn))
    chosen = known[:: max(1, len(known) // ELLIPSES)]
    turn = np.append(np.linspace(0.0, 2.0 * np.pi, 37), np.nan)
    n = north[chosen, None] + RADIUS_95 * sn[chosen, None] * np.cos(turn)
    e = east[chosen, None] + RADIUS_95 * se[chosen, None] * np.sin(turn)
    return n.ravel(), e.ravel()


def _track(session: Session) -> Figure | None:
    origin = _origin(session)
    if origin is None:
        return None
    metres = _grid(*origin)
    plan, ellipses, heights = [], [], []
    for e in session.estimates:
        c = e.columns
        if not np.isfinite(c["lat_deg"]).any():
            continue
        north, east = metres(c["lat_deg"], c["lon_deg"])
        plan.append(Trace(e.name, east, north))
        n, e95 = _ellipses(north, east, c["sn_m"], c["se_m"])
        ellipses.append(Trace(f"{e.name}: 95 % ellipses", e95, n))
        heights.append(Trace(e.name, c["t_s"], c["height_m"], c["sd_m"]))
    for fixes in session.fixes:
        north, east = metres(np.degrees(fixes.rows["lat"]), np.degrees(fixes.rows["lon"]))
        plan.append(Trace(f"{fixes.name}: fixes", east, north, style="markers"))
        heights.append(Trace(f"{fixes.name}: fixes", _epochs(fixes), fixes.rows["height"], style="markers"))
    return Figure(
        f"Track about {origin[0]:.6f}°, {origin[1]:.6f}°",
        [
            Panel("Plan", "east, m", "north, m", [*plan, *ellipses], equal=True),
            Panel("Height", TIME, "m above the ellipsoid", heights),
        ],
    )


def _epochs(fixes: Fixes) -> Floats:
    return np.asarray(fixes.rows["t_ns"] * 1e-9)


def _innovation_panels(i: Innovations) -> list[Panel]:
    unit = i.kind.rpartition("_")[2].replace("ps", "/s")
    z = i.normalised
    zero, lags = np.zeros(len(z)), autocorrelation(z[i.used]) if np.count_nonzero(i.used) > 2 else np.ones(1)
    usual = np.where(i.sigma < UNSEEN * np.median(i.sigma), i.sigma, np.nan)
    values = [Trace("used", i.t, i.value, usual, about=zero, style="markers")]
    normalised = [Trace("used", i.t[i.used], z[i.used], style="markers")]
    if not i.used.all():
        values.append(Trace("rejected", i.t[~i.used], i.value[~i.used], style="markers"))
        normalised.append(Trace("rejected", i.t[~i.used], z[~i.used], style="markers"))
    counts, edges = np.histogram(z[i.used], BINS)
    middle = 0.5 * (edges[1:] + edges[:-1])
    density = counts / max(1, counts.sum()) / (edges[1] - edges[0])
    normal = np.exp(-0.5 * middle**2) / math.sqrt(2.0 * math.pi)
    lag = np.arange(len(lags), dtype=float)
    bound = np.full(len(lags), 1.96 / math.sqrt(max(1, int(np.count_nonzero(i.used)))))
    return [
        Panel(f"{i.kind}: innovation ±σ", TIME, unit, values),
        Panel(f"{i.kind}: normalised", TIME, "σ", normalised),
        Panel(
            "histogram",
            "σ",
            "density, 1/σ",
            [Trace("found", middle, density, style="bars"), Trace("N(0, 1)", middle, normal)],
        ),
        Panel(
            "autocorrelation; 95 % if white",
            "lag, innovations",
            "correlation",
            [
                Trace("found", lag, lags, style="bars"),
                Trace("±1.96/√N", lag, bound, colour=1, dashed=True),
                Trace("", lag, -bound, colour=1, dashed=True),
            ],
        ),
    ]


def _consistency(name: str, kinds: list[Innovations]) -> Figure | None:
    """Moving mean squares of the normalised innovations between the 95 % bounds of chi-square; None: too few."""
    low, high = chi2_bounds(float(WINDOW))
    traces = []
    for i in kinds:
        z, t = i.normalised[i.used], i.t[i.used]
        if len(z) >= WINDOW:
            traces.append(Trace(i.kind, t[WINDOW - 1 :], moving_mean(z * z, WINDOW)))
    if not traces:
        return None
    ends = np.array([traces[0].x[0], traces[0].x[-1]])
    traces += [
        Trace(f"χ² {p} %", ends, np.full(2, y), colour=4, dashed=True) for p, y in (("2.5", low), ("97.5", high))
    ]
    return Figure(
        f"{name}: consistency",
        [Panel(f"Mean square of {WINDOW} normalised innovations; 1 is right", TIME, "σ²", traces)],
        columns=1,
    )


def _words(title: str, t: Floats, bits: NDArray[np.int64], table: dict[str, int]) -> Panel:
    """When each of the words held, one above the other."""
    traces = [
        Trace(name, t, np.where(bits & bit, float(k), np.nan), style="markers")
        for k, (name, bit) in enumerate(table.items())
    ]
    return Panel(title, TIME, "", traces, rungs=tuple(table))


def _status(e: Estimates) -> Figure:
    return Figure(f"{e.name}: status", [_words("", e.columns["t_s"], e.status, STATUS)], columns=1)


def _sensor(s: Sensor) -> Figure:
    c = s.columns
    panels = [
        Panel("Rates, FRD", TIME, "rad/s", [Trace(a, c["t_s"], c[f"w{a}"]) for a in "xyz"]),
        Panel("Forces, FRD", TIME, "m/s²", [Trace(a, c["t_s"], c[f"f{a}"]) for a in "xyz"]),
        Panel("Between samples", TIME, "ms", [Trace("interval", c["t_s"], c["interval_ms"])]),
    ]
    if np.isfinite(c["temperature_c"]).any():
        panels.append(Panel("Temperature", TIME, "°C", [Trace("sensor", c["t_s"], c["temperature_c"])]))
    if any((s.flags & bit).any() for bit in FLAGS.values()):
        panels.append(_words("Health", c["t_s"], s.flags, FLAGS))
    return Figure(f"{s.name}: the sensor at {s.rate_hz:.6g} Hz", panels)


def _clock(c: Clock) -> Figure:
    rows = c.rows
    t = rows["t_ns"] * 1e-9
    late = [Trace("mean of late", t, 1e3 * rows["late"]), Trace("at most so far", t, 1e3 * rows["latest"])]
    lost = [Trace(name, t, rows[name].astype(float)) for name in ("bad", "lost", "errors", "corrections")]
    return Figure(
        f"{c.name}: the sensor's clock and line",
        [
            Panel("Clock drift ± σ", TIME, "ppm", [Trace("drift", t, 1e6 * rows["drift"], 1e6 * rows["sigma_drift"])]),
            Panel("Arrivals about the fitted line", TIME, "µs", [Trace("residual", t, 1e6 * rows["residual"])]),
            Panel("Latency: samples later than at best", TIME, "ms", late),
            Panel("Counted since it connected", TIME, "number", lost),
        ],
    )


def _receivers(session: Session) -> list[Figure]:
    late = [
        Trace(f.name, _epochs(f), (f.rows["arrival_ns"] - f.rows["t_ns"]) * 1e-9, style="markers")
        for f in session.fixes
    ]
    used = [Trace(f.name, _epochs(f), f.rows["hdop"], style="markers") for f in session.fixes]
    if not late:
        return []
    panels = [
        Panel("Latency: arrival after epoch", TIME, "s", late),
        Panel("Dilution of precision", TIME, "HDOP, no unit", used),
    ]
    return [Figure("The receiver", panels)]


def panels(session: Session) -> list[Figure]:
    """All that can be drawn of these files."""
    drawn: list[Figure] = []
    if track := _track(session):
        drawn.append(track)
    if session.estimates:
        drawn.append(_states(session, "Attitude ± σ", "deg", ("roll_deg", "pitch_deg", "yaw_deg")))
        if any(np.isfinite(e.columns["vn_mps"]).any() for e in session.estimates):
            drawn.append(_states(session, "Velocity ± σ", "m/s", ("vn_mps", "ve_mps", "vd_mps")))
        rates, forces = ([f"b{kind}{axis}_{unit}" for axis in "xyz"] for kind, unit in (("g", "radps"), ("a", "mps2")))
        drawn.append(_states(session, "Gyro bias ± σ", "deg/s", rates, math.degrees(1.0)))
        drawn.append(_states(session, "Accelerometer bias ± σ", "m/s²", forces))
        drawn += [_status(e) for e in session.estimates]
    shown = [i for i in session.innovations if len(i.t) >= LEAST]
    for name in dict.fromkeys(i.name for i in shown):
        kinds = [i for i in shown if i.name == name]
        if consistency := _consistency(name, kinds):
            drawn.append(consistency)
        drawn.append(
            Figure(
                f"{name}: value, normalised, histogram, autocorrelation",
                [p for i in kinds for p in _innovation_panels(i)],
                columns=4,
            )
        )
    drawn += [_sensor(sensor) for sensor in session.sensors] + [_clock(clock) for clock in session.clocks]
    return [*drawn, *_receivers(session)]
