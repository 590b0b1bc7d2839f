"""Suh et al., Attitude Estimation Adaptively Compensating External Acceleration: their two experiments, simulated.

Experiment 1: the sensor is still. Experiment 2: a cart is pushed to and fro by hand on rails along y, its attitude
fixed; the rails cause vibration. The sensor is an M-G350 whose biases have been zeroed at rest but for a fifth: that
leaves the 0.1 deg/s of their gyros ("less than 1 degree after 10 seconds"). Of experiment 2 they print figures only;
the claim is the order: roll error standard > simple adaptive > two-step, pitch about equal, r2 well above r1.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..compile.jit import kernel
from ..configuration.settings import Initial, Settings
from ..estimators import Estimator
from ..estimators.papers import suh as filters
from ..estimators.papers.suh import PITCH, R_NOMINAL, ROLL, STEP_S, SUH_ADAPTIVE, SUH_STANDARD, SUH_TWO_STEP
from ..estimators.records import SOLUTION
from ..math.arrays import Floats
from ..math.earth import STANDARD_GRAVITY
from .report import Report, Row, at_most, rms
from .simulate import level_at_rest, m_g350
from .suh_figures import figures

RATE_HZ, SECONDS = 200.0, 60.0
VIBRATION = 0.01 * STANDARD_GRAVITY  # m/s^2, 1 sigma per axis of rails and rollers
CARTS = 20  # repetitions of experiment 2
ZEROED = 0.2  # of the switch-on bias is left
FILTERS: dict[str, tuple[Estimator, bool]] = {
    "standard": (SUH_STANDARD, False),
    "simple adaptive": (SUH_ADAPTIVE, False),
    "two-step": (SUH_TWO_STEP, False),
    "standard, as printed": (SUH_STANDARD, True),
    "simple adaptive, as printed": (SUH_ADAPTIVE, True),
    "two-step, as printed": (SUH_TWO_STEP, True),
}
ORDER = ("standard", "simple adaptive", "two-step")
PRINTED_VARIANCES = "1.68e-05, 1.67e-05; 0.0032, 0.0040, 0.0031"


@dataclass(frozen=True)
class Run:
    """One filter on one recording, at its steps: angles and sigmas in deg, columns pitch and roll; r1, r2."""

    t: Floats
    angles: Floats
    sigmas: Floats
    r: Floats

    def rms_deg(self, axis: int) -> float:
        return rms(self.angles[:, axis])

    def largest_deg(self, axis: int) -> float:
        return float(np.max(np.abs(self.angles[:, axis])))


@kernel
def _record(step: Any, p: Any, s: Any, samples: Any, out: Any, rows: Any) -> int:
    """Step through the samples; one row t, pitch, roll, their variances, r1, r2 per step of the filter."""
    count = 0
    for k in range(len(samples)):
        step(p[0], s[0], samples[k], out[0])
        if s[0].steps > count:
            rows[count, 0] = s[0].t_ns * 1e-9
            for i in range(2):
                rows[count, 1 + i] = s[0].x[i]
                rows[count, 3 + i] = s[0].P[5 * i]
                rows[count, 5 + i] = s[0].r[i]
            count += 1
    return count


def filtered(name: str, samples: Any) -> Run:
    """The samples through one of FILTERS."""
    estimator, literal = FILTERS[name]
    p = estimator.configure(Settings(), RATE_HZ)
    p["literal"] = literal
    rows = np.zeros((len(samples), 7))
    n = _record(estimator.step, p, estimator.start(p, Initial()), samples, np.zeros(1, SOLUTION), rows)
    rows = rows[:n]
    return Run(rows[:, 0], np.degrees(rows[:, 1:3]), np.degrees(np.sqrt(rows[:, 3:5])), rows[:, 5:7])


def still(rng: np.random.Generator) -> Any:
    """Experiment 1: samples of the sensor at rest."""
    t = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    return m_g350(rng, t, *level_at_rest(len(t)), ZEROED)


def pushes(rng: np.random.Generator, t: Floats) -> Floats:
    """Acceleration along the rails in m/s^2: strokes to and fro by hand, each from rest to rest, with pauses."""
    a = np.zeros(len(t))
    start = 5.0
    direction = 1.0
    while start < t[-1] - 3.0:
        lasts, length = rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.5)
        inside = (t >= start) & (t < start + lasts)
        phase = 2.0 * np.pi * (t[inside] - start) / lasts
        # a stroke: length (u - sin(2 pi u) / 2 pi), u from 0 to 1
        a[inside] = direction * 2.0 * np.pi * length / lasts**2 * np.sin(phase)
        direction = -direction
        start += lasts + (rng.uniform(0.0, 0.2) if rng.random() < 0.7 else rng.uniform(1.0, 3.0))
    return a


def cart(rng: np.random.Generator, switch_on: float = ZEROED) -> tuple[Any, Floats]:
    """Experiment 2: samples on the cart, and its acceleration along y in m/s^2."""
    t = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    w, f = level_at_rest(len(t))
    push = pushes(rng, t)
    f[:, 1] += push
    moving = np.convolve(np.abs(push) > 0.0, np.ones(3), mode="same") > 0.0
    f += VIBRATION * moving[:, None] * rng.standard_normal(f.shape)
    return m_g350(rng, t, w, f, switch_on), push


def _parameter_rows() -> list[Row]:
    """His section 5, and ours."""
    alpha2 = filters.ALPHA2 * math.sqrt(filters.DELTA)
    printed = (
        ("T in s", 0.05, filters.STEP_S),
        ("q1", 1.0, filters.Q1),
        ("r1,nom = r2,nom", 0.05, filters.R_NOMINAL),
        ("r3", 1.0, filters.R3),
        ("δ", 0.005, filters.DELTA),
        ("α1", 0.4, filters.ALPHA1),
        ("α2 of e (ours: of e², times √δ)", 10.0, alpha2),
        ("r1, r2 of the simple adaptive filter", 5.0, filters.R_LARGE),
    )
    return [Row(name, f"{his:g}", f"{ours:g}", math.isclose(his, ours)) for name, his, ours in printed]


def averaged(samples: Any) -> tuple[Floats, Floats]:
    """Force in standard gravities and rate in deg/s, (n, 3) each, as the filters take them: means over STEP_S."""
    size = round(STEP_S * RATE_HZ)
    n = len(samples) // size * size
    force, rate = (samples[name][:n].reshape(-1, size, 3).mean(axis=1) for name in "fw")
    return force / STANDARD_GRAVITY, np.degrees(rate)


def _rest_rows(samples: Any, rest: dict[str, Run]) -> list[Row]:
    """Experiment 1."""
    force, rate = averaged(samples)
    variances = *force.var(axis=0)[:2], *rate.var(axis=0)
    ours = "{:.2e}, {:.2e}; {:.2g}, {:.2g}, {:.2g}".format(*variances)
    two_step = rest["two-step"]
    apart = float(np.max(np.abs(two_step.angles - rest["standard"].angles)))
    excess = float(np.max(np.abs(np.sum(force**2, axis=1) - 1.0)))
    return [
        Row("experiment 1: variances of a_x, a_y in g², of the gyros", PRINTED_VARIANCES, f"{ours} (M-G350, deg²/s²)"),
        Row("experiment 1: largest ||a|² - 1|", "0.005 = δ", f"{excess:.4f}"),
        at_most("experiment 1: largest pitch error", "0.733 deg", two_step.largest_deg(PITCH), 0.733, "deg"),
        at_most("experiment 1: largest roll error", "0.909 deg", two_step.largest_deg(ROLL), 0.909, "deg"),
        at_most("experiment 1: two-step from standard", "almost the same", apart, 0.01, "deg"),
    ]


def _number_rows(runs: dict[str, Run]) -> list[Row]:
    rows = []
    for name, run in runs.items():
        for axis, label in ((PITCH, "pitch"), (ROLL, "roll")):
            square, largest = run.rms_deg(axis), run.largest_deg(axis)
            ours = f"{square**2:8.4f} deg²  {square:6.3f} deg  {largest:6.3f} deg"
            rows.append(Row(f"{label}, {name}: S, RMS, max", "figure only", ours))
    return rows


def _ordered(runs: dict[str, Run], largest: bool) -> bool:
    values = [runs[n].largest_deg(ROLL) if largest else runs[n].rms_deg(ROLL) for n in ORDER]
    return values[0] > values[1] > values[2]


def _claims(runs: dict[str, Run]) -> list[Row]:
    pitch = [runs[n].rms_deg(PITCH) for n in ORDER]
    rolls = [runs[n].rms_deg(ROLL) for n in ORDER]
    r = runs["two-step"].r.mean(axis=0)
    roll = " > ".join(f"{value:.3f}" for value in rolls)
    top = " > ".join(f"{runs[n].largest_deg(ROLL):.3f}" for n in ORDER)
    return [
        Row("roll RMS in deg", "standard > simple adaptive > two-step", roll, _ordered(runs, False)),
        Row("largest roll error in deg", "standard > simple adaptive > two-step", top),
        at_most(
            "range of the three pitch RMS, as a part of roll's", "pitch similar", np.ptp(pitch) / np.ptp(rolls), 0.1
        ),
        Row("two-step: mean r1, r2", "r2 ≫ r1", f"{r[0]:.3f}, {r[1]:.3f}", bool(r[1] > 3.0 * r[0])),
        at_most("two-step: mean r1 of its nominal value", "near 1; vibration raises it", float(r[0]) / R_NOMINAL, 2.0),
    ]


def repeated(rng: np.random.Generator) -> list[Row]:
    """Does the order depend on this one cart, or on the zeroing?"""
    rows = []
    for switch_on, claimed in ((ZEROED, True), (1.0, False)):
        held = [0, 0]
        for _ in range(CARTS):
            samples, _ = cart(rng, switch_on)
            runs = {name: filtered(name, samples) for name in ORDER}
            held[0] += _ordered(runs, False)
            held[1] += _ordered(runs, True)
        for count, what, least in zip(held, ("RMS", "largest error"), (0.9, 0.7), strict=True):
            quantity = f"carts with the order of roll {what}, {switch_on:g} of the bias left"
            rows.append(Row(quantity, "1 of 1", f"{count} of {CARTS}", count >= least * CARTS if claimed else None))
    return rows


def reproduce(seed: int) -> Report:
    """Their numbers and figures. Angles are errors: the true ones are 0."""
    rng = np.random.default_rng(seed)
    at_rest = still(rng)
    rest = {name: filtered(name, at_rest) for name in ("standard", "two-step")}
    samples, push = cart(rng)
    runs = {name: filtered(name, samples) for name in FILTERS}
    rows = [
        *_parameter_rows(),
        *_rest_rows(at_rest, rest),
        *_number_rows(runs),
        *_claims(runs),
        *repeated(rng),
    ]
    title = "Suh et al., Attitude Estimation Adaptively Compensating External Acceleration"
    sigma_a = np.where(push == 0.0, 0.0, VIBRATION)
    drawn = figures(averaged(at_rest), rest["two-step"], runs, ORDER, samples, push, sigma_a)
    return Report(title, rows, drawn)
