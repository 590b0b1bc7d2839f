"""Suh's claims on a user's recording of a sensor with three gyros, at rest or pushed without being turned.

The true attitude is not known: errors are counted from the attitude filter of imud, whose own sigma is printed. His
claims are about a sensor whose attitude is fixed; how far it turned is printed, too.
"""

import numpy as np

from ..configuration.settings import Initial
from ..errors import BadDataError
from ..estimators import registry
from ..estimators.papers.suh import DELTA, PITCH, ROLL, STEP_S
from ..estimators.records import SOLUTION
from ..figures import Figure, Panel, Trace
from ..math.arrays import Floats, Records
from ..math.rotation_arrays import roll_and_pitch
from ..pipeline import Filter
from .recorded import Recorded
from .report import Report, Row, at_most
from .runs import AttitudeRun
from .suh import FILTERS, ORDER, PRINTED_VARIANCES, claims, filtered, number_rows
from .suh_cart import averaged

FIXED_DEG = 3.0  # of tilt: within it the attitude was fixed
LEAST_S, REST_S = 5.0, 3.0
NAMES = [name for name in FILTERS if "as printed" not in name]


def _reference(data: Recorded, samples: Records) -> tuple[Floats, Floats]:
    """Pitch and roll by `attitude`, and their sigmas, deg, (n, 2)."""
    out = np.zeros(len(samples), SOLUTION)
    Filter(registry.by_name("attitude"), data.settings, Initial(), data.rate_hz).run(samples.copy(), out)
    return np.degrees(roll_and_pitch(out["q_nb"])[:, ::-1]), np.degrees(out["sigma_rpy"][:, 1::-1])


def _counted_from(run: AttitudeRun, t: Floats, reference: Floats) -> AttitudeRun:
    """The run with its errors for angles."""
    known = np.column_stack([np.interp(run.t, t, reference[:, i]) for i in range(2)])
    return AttitudeRun(run.t, (run.angles - known + 180.0) % 360.0 - 180.0, run.sigmas, run.r)


def _rest_rows(force: Floats, rate: Floats, runs: dict[str, AttitudeRun]) -> list[Row]:
    """Experiment 1."""
    variances = *force.var(axis=0)[:2], *rate.var(axis=0)
    ours = "{:.2e}, {:.2e}; {:.2g}, {:.2g}, {:.2g}".format(*variances)
    two_step = runs["two-step"]
    return [
        Row("experiment 1: variances of a_x, a_y in g², of the gyros in deg²/s²", PRINTED_VARIANCES, ours),
        at_most("experiment 1: largest pitch error", "0.733 deg", two_step.largest_deg(PITCH), 0.733, "deg"),
        at_most("experiment 1: largest roll error", "0.909 deg", two_step.largest_deg(ROLL), 0.909, "deg"),
    ]


def reproduce(data: Recorded) -> Report:
    """Their numbers and figures from the recording."""
    if not all(data.gyro_axes):
        raise BadDataError(f"{data.name}: its sensor has not three gyros, which these filters need")
    if data.rate_hz < 0.9 / STEP_S:
        raise BadDataError(f"{data.name}: {data.rate_hz:.3g} samples/s; these filters need {1.0 / STEP_S:g}")
    if data.seconds < LEAST_S:
        raise BadDataError(f"{data.name}: {data.seconds:.3g} s of samples; at least {LEAST_S:g} are needed")
    samples = data.samples[np.isfinite(data.samples["f"]).all(axis=1) & np.isfinite(data.samples["w"]).all(axis=1)]
    t = samples["t_ns"] * 1e-9
    reference, sigma = _reference(data, samples)
    runs = {name: _counted_from(filtered(name, samples, data.rate_hz), t, reference) for name in NAMES}
    force, rate = averaged(samples, data.rate_hz)
    excess = np.abs(np.sum(force**2, axis=1) - 1.0)
    beyond = float(np.mean(excess > DELTA))
    turned = float(np.max(np.ptp(reference[t > t[0] + REST_S], axis=0)))
    known = "{:.2f}, {:.2f} deg".format(*sigma.mean(axis=0))
    pushed = bool(np.max(excess) > 10.0 * DELTA)
    rows = [
        Row("recording", "", f"{data.name}: {data.seconds:.1f} s at {data.rate_hz:.6g} Hz"),
        Row("attitude: range of pitch or roll", "fixed", f"{turned:.2f} deg", turned < FIXED_DEG),
        Row("the reference, `attitude`: its mean σ of pitch, roll", "exact", known),
        Row("||a|² - 1|: largest; part above δ", "0.005 = δ at rest", f"{excess.max():.4f}; {100 * beyond:.0f} %"),
    ]
    if pushed:
        rows += [*number_rows("experiment 2", runs), *claims("experiment 2", runs)]
    else:
        rows += [*_rest_rows(force, rate, runs), *number_rows("experiment 1", runs)]
    return Report(f"Suh et al., Attitude Estimation, on {data.name}", rows, _figures(runs, t, samples), ours=False)


def _figures(runs: dict[str, AttitudeRun], t: Floats, samples: Records) -> list[Figure]:
    errors, covariances = [], []
    for axis, label in ((PITCH, "pitch"), (ROLL, "roll")):
        for name in ORDER:
            trace = Trace(f"{label}, {name}", runs[name].t, runs[name].angles[:, axis], runs[name].sigmas[:, axis])
            errors.append(Panel(f"{label}, {name}", "time [s]", "from `attitude` [deg]", [trace]))
    for name in NAMES[1:]:
        traces = [Trace(f"{r}, {name}", runs[name].t, runs[name].r[:, i]) for i, r in enumerate(("r1", "r2"))]
        covariances.append(Panel(name, "time [s]", "r [g²]", traces))
    forces = [Trace(f"a_{axis}", t, samples["f"][:, i]) for i, axis in enumerate("xyz")]
    return [
        Figure("Specific force", [Panel("specific force", "time [s]", "m/s²", forces)], columns=1),
        Figure("Fig. 5: ±σ of his covariances", errors, columns=3),
        Figure("Fig. 6: covariances of the accelerometer", covariances, columns=3),
    ]
