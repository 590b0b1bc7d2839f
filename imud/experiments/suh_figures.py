"""The figures of Suh's two experiments, each random quantity with its +-sigma."""

import math
from typing import Any

import numpy as np

from ..estimators.papers.suh import DELTA, PITCH, ROLL, STEP_S
from ..figures import Figure, Panel, Trace
from ..math.arrays import Floats
from ..math.earth import STANDARD_GRAVITY
from .runs import AttitudeRun
from .suh_cart import SIGMAS

AXES = ("x", "y", "z")


def _sensor_figures(make: str, force: Floats, rate: Floats) -> list[Figure]:
    """Figs. 1 and 2: what the sensor shows at rest, its noise about its mean, and what (7) makes of it."""
    sigma_a, sigma_w = SIGMAS[make]
    t: Floats = STEP_S * np.arange(1.0, len(force) + 1.0)
    panels = []
    for values, sigma, name, unit in ((force, sigma_a, "a", "g"), (rate, sigma_w, "g", "deg/s")):
        for i, axis in enumerate(AXES):
            mean = np.full(len(t), values[:, i].mean())
            trace = Trace(f"{name}_{axis}", t, values[:, i], np.full(len(t), sigma[i]), mean)
            panels.append(Panel(f"{name}_{axis}", "time [s]", f"{name}_{axis} [{unit}]", [trace]))
    excess = np.abs(np.sum(force**2, axis=1) - 1.0)
    band = np.full(len(t), 2.0 * sigma_a[2])  # d|a|^2 = 2 a da
    seen = Trace("f(a)", t, excess, band, np.full(len(t), excess.mean()))
    limit = Trace("δ", t[[0, -1]], np.full(2, DELTA), dashed=True)
    return [
        Figure(f"Fig. 1: experiment 1, {make} at rest", panels, columns=3),
        Figure(
            f"Fig. 2: experiment 1, {make}, f(a) = | |a|² - 1 |", [Panel("f(a)", "time [s]", "f(a)", [seen, limit])], 1
        ),
    ]


def _angle_panels(runs: dict[str, AttitudeRun], names: tuple[str, ...]) -> list[Panel]:
    panels = []
    for axis, label in ((PITCH, "pitch"), (ROLL, "roll")):
        for name in names:
            run = runs[name]
            trace = Trace(f"{label}, {name}", run.t, run.angles[:, axis], run.sigmas[:, axis])
            panels.append(Panel(f"{label}, {name}", "time [s]", f"{label} error [deg]", [trace]))
    return panels


def _cart_figure(
    make: str, runs: dict[str, AttitudeRun], order: tuple[str, ...], samples: Any, push: Floats, vibration: Floats
) -> Figure:
    t = samples["t_ns"] * 1e-9
    sample_noise = SIGMAS[make][0][1] * STANDARD_GRAVITY * math.sqrt(STEP_S / (t[1] - t[0]))
    measured = Trace("measured a_y", t, samples["f"][:, 1], np.hypot(vibration, sample_noise))
    rolls = [Trace(n, runs[n].t, runs[n].angles[:, ROLL], runs[n].sigmas[:, ROLL]) for n in order]
    return Figure(
        f"Experiment 2: the cart, {make}",
        [
            Panel("acceleration along the rails", "time [s]", "a_y [m/s²]", [measured, Trace("true a_y", t, push)]),
            Panel("roll, all three", "time [s]", "roll error [deg]", rolls),
        ],
    )


def figures(
    make: str,
    at_rest: tuple[Floats, Floats],
    rest: AttitudeRun,
    runs: dict[str, AttitudeRun],
    order: tuple[str, ...],
    samples: Any,
    push: Floats,
    vibration: Floats,
) -> list[Figure]:
    """Figs. 1 to 3 of experiment 1; the cart, Figs. 5 and 6 of experiment 2.

    at_rest: force in g and rate in deg/s per step; vibration: m/s^2, 1 sigma per sample.
    """
    covariances = []
    for name in (*order[1:], "two-step, 10 |e|"):
        run = runs[name]
        traces = [Trace(f"{r}, {name}", run.t, run.r[:, i]) for i, r in enumerate(("r1", "r2"))]
        covariances.append(Panel(name, "time [s]", "r [g²]", traces))
    return [
        *_sensor_figures(make, *at_rest),
        Figure(f"Fig. 3: experiment 1, {make} at rest", _angle_panels({"two-step": rest}, ("two-step",))),
        _cart_figure(make, runs, order, samples, push, vibration),
        Figure(f"Fig. 5: experiment 2, {make}, ±σ of his covariances", _angle_panels(runs, order), columns=3),
        Figure(f"Fig. 6: covariances of the accelerometer, {make}", covariances),
    ]
