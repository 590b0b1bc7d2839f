"""Suh et al., Attitude Estimation Adaptively Compensating External Acceleration: their two experiments, simulated.

Experiment 1: the sensor is still. Experiment 2: a cart is pushed to and fro by hand on rails along y, its attitude
fixed; the rails cause vibration. Of experiment 2 they print figures only; the claim is the order: roll error standard >
simple adaptive > two-step, pitch about equal, r2 well above r1. All of it on their sensors, and on a better one.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np

from ..compile.jit import kernel
from ..configuration.settings import Initial, Settings
from ..estimators import Estimator
from ..estimators.papers import suh as filters
from ..estimators.papers.suh import (
    ABSOLUTE,
    PITCH,
    R_NOMINAL,
    ROLL,
    SIGNED,
    SQUARE,
    SUH_ADAPTIVE,
    SUH_STANDARD,
    SUH_TWO_STEP,
)
from ..estimators.records import SOLUTION
from .report import Report, Row, at_most
from .runs import AttitudeRun
from .suh_cart import RATE_HZ, SENSORS, VIBRATION, ZEROED, Sensor, averaged, cart, still, zeroed
from .suh_figures import figures

CARTS = 20  # repetitions of experiment 2
FILTERS: dict[str, tuple[Estimator, int, int]] = {  # the filter, whether as printed, its rule (9)
    "standard": (SUH_STANDARD, 0, SQUARE),
    "simple adaptive": (SUH_ADAPTIVE, 0, SQUARE),
    "two-step": (SUH_TWO_STEP, 0, SQUARE),
    "two-step, 10 |e|": (SUH_TWO_STEP, 0, ABSOLUTE),
    "standard, as printed": (SUH_STANDARD, 1, SQUARE),
    "simple adaptive, as printed": (SUH_ADAPTIVE, 1, SQUARE),
    "two-step, as printed": (SUH_TWO_STEP, 1, SIGNED),
}
ORDER = ("standard", "simple adaptive", "two-step")
WITH_PRINT = ("standard", "simple adaptive", "two-step, 10 |e|")
PRINTED_VARIANCES = "1.68e-05, 1.67e-05; 0.0032, 0.0040, 0.0031"


@kernel
def _record(p: Any, s: Any, samples: Any, out: Any, rows: Any) -> int:
    """Step through the samples; one row t, pitch, roll, their variances, r1, r2 per step of the filter."""
    count = 0
    for k in range(len(samples)):
        filters.step(p[0], s[0], samples[k], out[0])
        if s[0].steps > count:
            rows[count, 0] = s[0].t_ns * 1e-9
            for i in range(2):
                rows[count, 1 + i] = s[0].x[i]
                rows[count, 3 + i] = s[0].P[5 * i]
                rows[count, 5 + i] = s[0].r[i]
            count += 1
    return count


def filtered(name: str, samples: Any, rate_hz: float = RATE_HZ) -> AttitudeRun:
    """The samples through one of FILTERS."""
    estimator, literal, rule = FILTERS[name]
    p = estimator.configure(Settings(), rate_hz)
    p["literal"], p["rule"] = literal, rule
    rows = np.zeros((len(samples), 7))
    n = _record(p, estimator.start(p, Initial()), samples, np.zeros(1, SOLUTION), rows)
    rows = rows[:n]
    return AttitudeRun(rows[:, 0], np.degrees(rows[:, 1:3]), np.degrees(np.sqrt(rows[:, 3:5])), rows[:, 5:7])


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
        ("α2 of e; our rule: 141 of e², times √δ", 10.0, alpha2),
        ("r1, r2 of the simple adaptive filter", 5.0, filters.R_LARGE),
    )
    return [Row(name, f"{his:g}", f"{ours:g}", math.isclose(his, ours)) for name, his, ours in printed]


def _rest_rows(make: str, samples: Any, rest: dict[str, AttitudeRun]) -> list[Row]:
    """Experiment 1."""
    force, rate = averaged(samples)
    variances = *force.var(axis=0)[:2], *rate.var(axis=0)
    ours = "{:.2e}, {:.2e}; {:.2g}, {:.2g}, {:.2g}".format(*variances)
    two_step = rest["two-step"]
    apart = float(np.max(np.abs(two_step.angles - rest["standard"].angles)) / np.max(np.abs(two_step.angles)))
    excess = np.abs(np.sum(force**2, axis=1) - 1.0)
    beyond = f"{excess.max():.4f}; {100 * np.mean(excess > filters.DELTA):.0f} % of the steps above δ"
    claim = f"experiment 1, {make}"
    return [
        Row(f"{claim}: variances of a_x, a_y in g², of the gyros in deg²/s²", PRINTED_VARIANCES, ours),
        Row(f"{claim}: largest ||a|² - 1|", "0.005 = δ", beyond),
        at_most(f"{claim}: largest pitch error", "0.733 deg", two_step.largest_deg(PITCH), 0.733, "deg"),
        at_most(f"{claim}: largest roll error", "0.909 deg", two_step.largest_deg(ROLL), 0.909, "deg"),
        at_most(f"{claim}: two-step from standard, as a part of the largest error", "almost the same", apart, 0.1),
    ]


def number_rows(make: str, runs: dict[str, AttitudeRun]) -> list[Row]:
    """S, RMS and largest error of each filter; r1 and r2 where they vary."""
    rows = []
    for name, run in runs.items():
        for axis, label in ((PITCH, "pitch"), (ROLL, "roll")):
            square, largest = run.rms_deg(axis), run.largest_deg(axis)
            ours = f"{square**2:8.4f} deg²  {square:6.3f} deg  {largest:6.3f} deg"
            rows.append(Row(f"{make}, {label}, {name}: S, RMS, max", "figure only", ours))
    for name, run in runs.items():
        if np.ptp(run.r) > 0.0:
            (mean1, mean2), (top1, top2) = run.r.mean(axis=0), run.r.max(axis=0)
            above = 100.0 * float(np.mean(run.r[:, 0] > 1.001 * R_NOMINAL))
            ours = f"r1 {mean1:.3f}, {top1:.3f}, {above:.0f} %; r2 {mean2:.3f}, {top2:.3f}"
            rows.append(Row(f"{make}, {name}: mean and max, part of r1 above nominal", "figure only", ours))
    return rows


def is_ordered(runs: dict[str, AttitudeRun], largest: bool, order: tuple[str, ...] = ORDER) -> bool:
    """Whether the roll errors fall in this order."""
    values = [runs[n].largest_deg(ROLL) if largest else runs[n].rms_deg(ROLL) for n in order]
    return all(a > b for a, b in pairwise(values))


def claims(make: str, runs: dict[str, AttitudeRun]) -> list[Row]:
    """What he says of experiment 2, with our rule and with 10 |e|."""
    rows = []
    for rule, order in (("141 e²", ORDER), ("10 |e|", WITH_PRINT)):
        claim, two_step = f"{make}, {rule}", runs[order[-1]]
        pitch, rolls = ([runs[n].rms_deg(axis) for n in order] for axis in (PITCH, ROLL))
        tops = [runs[n].largest_deg(ROLL) for n in order]
        r = two_step.r.mean(axis=0)
        roll, top = (", ".join(f"{value:.3f}" for value in values) for values in (rolls, tops))
        similar = np.ptp(pitch) / np.ptp(rolls)
        rows += [
            Row(f"{claim}: roll RMS in deg", " > ".join(ORDER), roll, is_ordered(runs, False, order)),
            Row(f"{claim}: largest roll error in deg", " > ".join(ORDER), top, is_ordered(runs, True, order)),
            at_most(f"{claim}: range of the three pitch RMS, as a part of roll's", "pitch similar", similar, 0.1),
            Row(f"{claim}: mean r1, r2", "r2 ≫ r1", f"{r[0]:.3f}, {r[1]:.3f}", bool(r[1] > 3.0 * r[0])),
            at_most(
                f"{claim}: mean r1 of its nominal value", "near 1; vibration raises it", float(r[0]) / R_NOMINAL, 2.0
            ),
        ]
    return rows


def repeated(rng: np.random.Generator) -> list[Row]:
    """Does the order depend on this one cart, on the sensor, or on the zeroing?"""
    rows = []
    sensors: list[tuple[str, Sensor, bool]] = [
        ("his sensors", SENSORS["his sensors"], True),
        (f"M-G350, {ZEROED:g} of the bias left", zeroed(), True),
        ("M-G350, all of the bias left", zeroed(1.0), False),
    ]
    for make, sensor, claimed in sensors:
        for rule, order in (("141 e²", ORDER), ("10 |e|", WITH_PRINT)):
            held = [0, 0]
            for _ in range(CARTS):
                samples, _ = cart(rng, sensor)
                runs = {name: filtered(name, samples) for name in order}
                held[0] += is_ordered(runs, False, order)
                held[1] += is_ordered(runs, True, order)
            for count, what, least in zip(held, ("RMS", "largest error"), (0.9, 0.7), strict=True):
                quantity = f"{make}, {rule}: carts with the order of roll {what}"
                holds = count >= least * CARTS if claimed else None
                rows.append(Row(quantity, "1 of 1", f"{count} of {CARTS}", holds))
    return rows


def reproduce(seed: int) -> Report:
    """Their numbers and figures. Angles are errors: the true ones are 0."""
    rng = np.random.default_rng(seed)
    rows, drawn = _parameter_rows(), []
    for make, sensor in SENSORS.items():
        at_rest = still(rng, sensor)
        rest = {name: filtered(name, at_rest) for name in ("standard", "two-step")}
        samples, push = cart(rng, sensor)
        runs = {name: filtered(name, samples) for name in FILTERS}
        rows += [*_rest_rows(make, at_rest, rest), *number_rows(make, runs), *claims(make, runs)]
        sigma_a = np.where(push == 0.0, 0.0, VIBRATION)
        drawn += figures(make, averaged(at_rest), rest["two-step"], runs, ORDER, samples, push, sigma_a)
    title = "Suh et al., Attitude Estimation Adaptively Compensating External Acceleration"
    return Report(title, [*rows, *repeated(rng)], drawn)
