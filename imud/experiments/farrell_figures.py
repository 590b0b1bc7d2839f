"""The figures of Farrell's solutions, each random quantity with its +-sigma."""

import math

import numpy as np

from ..figures import Figure, Panel, Trace
from ..math.arrays import Floats
from .runs import AxisRun
from .whiteness import LAGS, autocorrelation

SETTLED = 10  # residuals of the transient
SPAN_S = 10.0
NAMES = (("position", "m"), ("velocity", "m/s"), ("bias", "m/s²"))


def state_figure(title: str, run: AxisRun) -> Figure:
    panels = []
    for i, (name, unit) in enumerate(NAMES):
        for part, span in (("first 10 s", run.t <= SPAN_S), ("last 10 s", run.t > run.t[-1] - SPAN_S)):
            t = run.t[span]
            error = (run.states - run.truth)[span, i]
            trace = Trace(f"{name} error, {part}", t, error, run.sigmas[span, i], np.zeros(len(t)))
            panels.append(Panel(f"{name}, {part}", "time [s]", f"{name} error [{unit}]", [trace]))
    return Figure(title, panels)


def _histogram(values: Floats, sigma: float, name: str) -> list[Trace]:
    counts, edges = np.histogram(values, bins=31, range=(-4.0 * sigma, 4.0 * sigma), density=True)
    x = np.linspace(-4.0 * sigma, 4.0 * sigma, 201)
    normal = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
    bars = Trace(name, 0.5 * (edges[1:] + edges[:-1]), counts, style="bars")
    edge = Trace(
        "±σ", np.array([-sigma, -sigma, math.nan, sigma, sigma]), np.array([0, normal.max(), math.nan, 0, normal.max()])
    )
    return [bars, Trace("normal density", x, normal), edge]


def residual_figure(title: str, run: AxisRun) -> Figure:
    k = np.arange(1, len(run.residual) + 1, dtype=np.float64)
    zero, one = np.zeros(len(k)), np.ones(len(k))
    tail = slice(SETTLED, None)
    lags, rho = np.arange(1, LAGS + 1, dtype=np.float64), autocorrelation(run.normalised)
    bound = np.full(LAGS, 1.0 / math.sqrt(len(k)))
    late, settled_sigma = run.residual[tail], float(run.residual_sigma[-1])
    correlation = Trace("ρ", lags, rho, bound, np.zeros(LAGS), "markers")
    panels = [
        Panel("residual", "time [s]", "r [m]", [Trace("r", k, run.residual, run.residual_sigma, zero)]),
        Panel(
            "after the transient",
            "time [s]",
            "r [m]",
            [Trace("r, later", k[tail], late, run.residual_sigma[tail], zero[tail])],
        ),
        Panel("normalised residual", "time [s]", "r / √S", [Trace("η", k, run.normalised, one, zero, "markers")]),
        Panel("autocorrelation of η", "lag [s]", "correlation", [correlation]),
        Panel(
            "histogram of r after the transient", "r [m]", "density [1/m]", _histogram(late, settled_sigma, "r density")
        ),
        Panel("histogram of η", "r / √S", "density", _histogram(run.normalised, 1.0, "η density")),
    ]
    return Figure(title, panels)


def drift_figure(run: AxisRun, what: str = "M-G350 data") -> Figure:
    panels = []
    for i, (name, unit) in enumerate(NAMES[:2]):
        zero = np.zeros(len(run.t))
        trace = Trace(f"dead-reckoned {name}", run.t, run.states[:, i], run.sigmas[:, i], zero)
        panels.append(Panel(f"{name} without measurements", "time [s]", f"{name} [{unit}]", [trace]))
    return Figure(f"Problem 2: drift of dead reckoning, b̂ = 0, {what}", panels)
