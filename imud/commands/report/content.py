"""The figures of a report, panel by panel, each axis with its unit."""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from imud.drivers import sample as flag

from ...estimators.records import (
    AT_REST,
    ATTITUDE_VALID,
    COASTING,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
    REJECTING,
    SATURATED,
)
from ...figures import Figure, Panel, Trace
from ...math.arrays import Floats
from .filter_states import filter_states
from .innovations import consistency, whiteness
from .session import TIME, Clock, Estimates, Sensor, Session
from .settled import settled_range
from .statistics import COUNT_MIN
from .track import epochs, track

STATUS = {
    "attitude valid": ATTITUDE_VALID,
    "heading valid": HEADING_VALID,
    "position valid": POSITION_VALID,
    "height valid": HEIGHT_VALID,
    "at rest": AT_REST,
    "coasting": COASTING,
    "rejecting": REJECTING,
    "saturated": SATURATED,
}
AXES = {"vn": "north", "ve": "east", "vd": "down"} | {f"b{sensor}{axis}": axis for sensor in "ga" for axis in "xyz"}
WRAPPED = ("roll_deg", "yaw_deg")
GAP_S, GAP_STEPS = 1.0, 5.0  # without rows, and of the usual step, from which on a curve is broken
FLAGS = {
    "suspect": flag.SUSPECT,
    "device error": flag.DEVICE_ERROR,
    "saturated": flag.SATURATED,
    "no rate": flag.NO_RATE,
    "no force": flag.NO_FORCE,
}


def _wrapped(angle: Floats) -> Floats:
    """Degrees in ±180; NaN where the angle jumps."""
    y = angle - 360.0 * np.round(angle / 360.0)
    return np.where(np.abs(np.diff(y, prepend=y[:1])) > 180.0, np.nan, y)


def _broken(t: Floats, y: Floats) -> Floats:
    """The curve, with NaN behind each gap, over which a line would be drawn else."""
    if len(t) < 2:
        return y
    steps = np.diff(t, prepend=t[:1])
    return np.where(steps > max(GAP_S, GAP_STEPS * float(np.median(steps))), np.nan, y)


def _states(session: Session, title: str, unit: str, names: Iterable[str], factor: float = 1.0) -> Figure:
    """Panels of the columns `names`, each with its 1 sigma, every estimate in them."""
    panels = []
    for name in names:
        traces = []
        for e in session.estimates:
            y, sigma = factor * e.columns[name], factor * e.columns[f"s{name}"]
            y = _broken(e.columns["t_s"], _wrapped(y) if name in WRAPPED else y)
            if np.isfinite(y).any():
                traces.append(Trace(e.name, e.columns["t_s"], y, sigma))
        y_range = settled_range(traces)
        stem, note = name.rpartition("_")[0], " (a large σ is cut off)" if y_range else ""
        panels.append(Panel(AXES.get(stem, stem) + note, TIME, unit, traces, y_range=y_range))
    return Figure(title, panels, columns=3)


def _flag_panel(title: str, t: Floats, bits: NDArray[np.int64], table: dict[str, int]) -> Panel:
    """When each flag was set, one flag above the other."""
    traces = [
        Trace(name, t, np.where(bits & bit, float(k), np.nan), style="markers")
        for k, (name, bit) in enumerate(table.items())
    ]
    return Panel(title, TIME, "", traces, rungs=tuple(table))


def _status(e: Estimates) -> Figure:
    return Figure(f"{e.name}: status", [_flag_panel("", e.columns["t_s"], e.status, STATUS)], columns=1)


def _sensor(s: Sensor) -> Figure:
    c = s.columns
    rates, forces = ([Trace(a, c["t_s"], _broken(c["t_s"], c[f"{kind}{a}"])) for a in "xyz"] for kind in "wf")
    panels = [
        Panel("Rates, FRD", TIME, "rad/s", rates),
        Panel("Forces, FRD", TIME, "m/s²", forces),
        Panel("Between samples", TIME, "ms", [Trace("interval", c["t_s"], c["interval_ms"])]),
    ]
    if np.isfinite(c["temperature_c"]).any():
        panels.append(Panel("Temperature", TIME, "°C", [Trace("sensor", c["t_s"], c["temperature_c"])]))
    if any((s.flags & bit).any() for bit in FLAGS.values()):
        panels.append(_flag_panel("Health", c["t_s"], s.flags, FLAGS))
    return Figure(f"{s.name}: the sensor at {s.rate_hz:.6g} Hz", panels)


def _clock(c: Clock) -> Figure:
    rows = c.rows
    t = rows["t_ns"] * 1e-9
    drift = [Trace("drift", t, 1e6 * rows["drift"], 1e6 * rows["sigma_drift"])]
    late = [Trace("mean of late", t, 1e3 * rows["late"]), Trace("at most so far", t, 1e3 * rows["latest"])]
    lost = [Trace(name, t, rows[name].astype(float)) for name in ("bad", "lost", "errors", "corrections")]
    return Figure(
        f"{c.name}: the sensor's clock and line",
        [
            Panel("Clock drift ± σ", TIME, "ppm", drift, y_range=settled_range(drift)),
            Panel("Arrivals about the fitted line", TIME, "µs", [Trace("residual", t, 1e6 * rows["residual"])]),
            Panel("Latency: samples later than at best", TIME, "ms", late),
            Panel("Counted since it connected", TIME, "number", lost),
        ],
    )


def _receivers(session: Session) -> list[Figure]:
    late = [
        Trace(f.name, epochs(f), (f.rows["arrival_ns"] - f.rows["t_ns"]) * 1e-9, style="markers") for f in session.fixes
    ]
    used = [Trace(f.name, epochs(f), f.rows["hdop"], style="markers") for f in session.fixes]
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
    if plan := track(session):
        drawn.append(plan)
    if session.estimates:
        drawn.append(_states(session, "Attitude ± σ", "deg", ("roll_deg", "pitch_deg", "yaw_deg")))
        if any(np.isfinite(e.columns["vn_mps"]).any() for e in session.estimates):
            drawn.append(_states(session, "Velocity ± σ", "m/s", ("vn_mps", "ve_mps", "vd_mps")))
        rates, forces = ([f"b{kind}{axis}_{unit}" for axis in "xyz"] for kind, unit in (("g", "radps"), ("a", "mps2")))
        drawn.append(_states(session, "Gyro bias ± σ", "deg/s", rates, math.degrees(1.0)))
        drawn.append(_states(session, "Accelerometer bias ± σ", "m/s²", forces))
        drawn += [_status(e) for e in session.estimates]
    drawn += filter_states(session)
    shown = [i for i in session.innovations if len(i.t) >= COUNT_MIN]
    for name in dict.fromkeys(i.name for i in shown):
        kinds = [i for i in shown if i.name == name]
        if moving := consistency(name, kinds):
            drawn.append(moving)
        drawn.append(whiteness(name, kinds))
    drawn += [_sensor(sensor) for sensor in session.sensors] + [_clock(clock) for clock in session.clocks]
    return [*drawn, *_receivers(session)]
