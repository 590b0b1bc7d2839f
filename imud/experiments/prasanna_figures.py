"""The figures of Prasanna's filters, each random quantity with its +-sigma."""

from collections.abc import Sequence

import numpy as np

from ..figures import Figure, Panel, Trace
from ..math.arrays import Floats
from .gps_walk import Track
from .report import circles
from .runs import LoopRun


def gps_figure(his: Track, matched: Track, sigma_m: float) -> Figure:
    """His track, its errors, its velocity."""

    def path(name: str, p: Floats, style: str = "lines") -> Trace:
        return Trace(name, p[:, 1], p[:, 0], style=style)

    lines = [
        path("Q, R as printed", his.p),
        Trace("σ, Q, R as printed", *circles(his.p, his.sigma_p[:, 0], 20)),
        path("matched", matched.p),
        Trace("σ, matched", *circles(matched.p, matched.sigma_p[:, 0], 20)),
        path("truth", his.truth),
    ]
    track = Panel("track", "east [m]", "north [m]", [path("fixes", his.raw, "markers"), *lines], equal=True)
    panels = [track]
    for name, run in (("Q, R as printed", his), ("matched", matched)):
        error = (run.p - run.truth)[:, 0]
        trace = Trace(f"north error, {name}", run.t, error, run.sigma_p[:, 0], np.zeros(len(run.t)))
        raw = Trace(
            f"fix error, {name}",
            run.t,
            (run.raw - run.truth)[:, 0],
            np.full(len(run.t), sigma_m),
            np.zeros(len(run.t)),
            "markers",
        )
        panels.append(Panel(f"north error, {name}", "time [s]", "error [m]", [trace, raw]))
    late = slice(5, None)
    speed = np.gradient(matched.truth, axis=0)[late, 0]
    velocity = Trace("north velocity, matched", matched.t[late], matched.v[late, 0], matched.sigma_v[late, 0])
    panels.append(
        Panel(
            "north velocity", "time [s]", "velocity [m/s]", [velocity, Trace("true velocity", matched.t[late], speed)]
        )
    )
    return Figure("GPS Kalman filter (gps-track)", panels)


def path_figure(raw: Floats, p: Floats, sigma: Floats) -> Figure:
    """A recorded track and his filter's, north and east in m."""
    traces = [
        Trace("fixes", raw[:, 1], raw[:, 0], style="markers"),
        Trace("Q, R as printed", p[:, 1], p[:, 0]),
        Trace("σ, Q, R as printed", *circles(p, sigma[:, 0], max(len(p) // 30, 1))),
    ]
    return Figure("GPS Kalman filter", [Panel("track", "east [m]", "north [m]", traces, equal=True)], columns=1)


def loop_figure(run: LoopRun) -> Figure:
    """His paths, displacements and accelerations; circles are +-sigma."""
    hz = round(1.0 / (run.t[1] - run.t[0]))
    paths = [
        ("measured", run.measured),
        ("predicted", run.predicted),
        ("estimated", run.estimated),
        ("truth", run.truth),
    ]
    traces = [Trace(n, p[:, 1], p[:, 0]) for n, p in paths]
    traces.append(Trace("σ, measured", *circles(run.measured, run.reckoned_sigma, hz)))
    traces.append(Trace("σ, predicted and estimated", *circles(run.estimated, run.sigma, hz)))
    track = Panel("path", "east [m]", "north [m]", traces, equal=True)
    panels = [track]
    for i, axis in enumerate(("north", "east", "down")):
        estimate = Trace(axis, run.t, run.estimated[:, i], run.sigma)
        panels.append(
            Panel(
                f"displacement {axis}",
                "time [s]",
                f"{axis} [m]",
                [estimate, Trace(f"true {axis}", run.t, run.truth[:, i])],
            )
        )
    for i, axis in enumerate(("north", "east")):
        estimate = Trace(f"acceleration {axis}", run.t, run.acceleration[:, i], run.acceleration_sigma)
        true = Trace(f"true acceleration {axis}", run.t, run.true_acceleration[:, i])
        panels.append(Panel(f"acceleration {axis}", "time [s]", f"{axis} [m/s²]", [estimate, true]))
    printed = [
        Trace("as printed", run.literal[:, 1], run.literal[:, 0]),
        Trace("σ of 8 mg twice integrated", *circles(run.literal, run.literal_sigma, 2 * hz)),
        Trace("true path", run.truth[:, 1], run.truth[:, 0]),
    ]
    panels.append(Panel("path as printed, no bias removed", "east [m]", "north [m]", printed, equal=True))
    return Figure("INS Kalman filter on a table top (ins9)", panels)


def tilt_figure(tilts_deg: Sequence[float], tilts: Sequence[tuple[float, float, float, float]]) -> Figure:
    """Errors of the tilt at tilts_deg; tilts: tilt and its sigma in deg first."""
    true = np.array(tilts_deg)
    error, sigma = np.array([row[0] for row in tilts]) - true, np.array([row[1] for row in tilts])
    trace = Trace("tilt error", true, error, sigma, np.zeros(len(true)), "markers")
    return Figure(
        "Tilt from the accelerometer", [Panel("tilt error", "true tilt [deg]", "error [deg]", [trace])], columns=1
    )
