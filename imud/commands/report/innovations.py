"""Figures of innovations: their consistency with the claimed sigma, and their whiteness."""

import math

import numpy as np

from ...figures import Figure, Panel, Trace
from .session import TIME, Innovations
from .statistics import autocorrelation, chi2_bounds, moving_mean

WINDOW = 20  # normalised innovations whose mean square is one point
PLOTTED_SIGMA_MAX = 10.0  # medians: larger sigmas, as at the start, would hide the others
BINS = np.arange(-5.0, 5.01, 0.25)


def _panels(i: Innovations) -> list[Panel]:
    unit = i.kind.rpartition("_")[2].replace("ps", "/s")
    z = i.normalised
    zero, lags = np.zeros(len(z)), autocorrelation(z[i.used]) if np.count_nonzero(i.used) > 2 else np.ones(1)
    plotted = np.where(i.sigma < PLOTTED_SIGMA_MAX * np.median(i.sigma), i.sigma, np.nan)
    values = [Trace("used", i.t, i.value, plotted, about=zero, style="markers")]
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


def consistency(name: str, kinds: list[Innovations]) -> Figure | None:
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


def whiteness(name: str, kinds: list[Innovations]) -> Figure:
    """Four panels for each kind: values, normalised values, their histogram and autocorrelation."""
    title = f"{name}: value, normalised, histogram, autocorrelation"
    return Figure(title, [panel for i in kinds for panel in _panels(i)], columns=4)
