"""Smoothing of the attitude filter: `smooth_attitude`.

What the filter corrects of the yaw at the first rest was known earlier: it is corrected from then on (`_left_yaw`).
What it forgets about the tilt although the body did not turn is carried back as it is: over coarse levelling,
and over the time in which the tilt was wrong before the filter noticed it.
"""

from collections.abc import Callable

import numpy as np

from ..estimators.ahrs.state import STATES
from ..estimators.records import ATTITUDE_VALID, HEADING_VALID, SOLUTION
from ..math.arrays import Floats, Indices, Records
from ..math.rotation_arrays import about_down, euler_sigmas, matrices, of_rotation_vectors, products
from ..pipeline import Filter
from .fixed_interval import smoothed_estimates
from .intervals import INTERVAL, record_intervals
from .reversal import BLOCK
from .rows import Rows

# of the accelerometer's axes, over its scale error: it is no state, and no average of attitudes removes it
_MISALIGNMENT = 0.5
_AROUND_S = 2.0  # before and after an interval

ERROR = np.dtype(  # of the filter's solution, at the end of an interval
    [
        ("turn", "<f8", (4,)),  # quaternion: from the filter's attitude to the smoothed one, in NED
        ("turn_before", "<f8", (4,)),  # the same before the interval's corrections
        ("var", "<f8", (3, 3)),  # of the attitude, rad^2
        ("bg", "<f8", (3,)),
        ("ba", "<f8", (3,)),
        ("bias_var", "<f8", (6,)),
    ]
)


def smooth_attitude(filter_: Filter, samples: Records, write: Callable[[Records], object]) -> None:
    """Write the smoothed solutions (SOLUTION) in blocks. filter_: before the first of the samples (SAMPLE)."""
    recorded, kept = Rows(SOLUTION), Rows(INTERVAL)
    record_intervals(filter_, samples, recorded, kept)
    solutions, intervals = recorded.array(), kept.array()
    if not len(intervals):
        write(solutions)
        return
    tuning = filter_.parameters["tuning"][0]
    errors = _errors(intervals, smoothed_estimates(intervals, float(tuning["position_decay_time_s"])))
    errors["var"][:, [0, 1], [0, 1]] += _MISALIGNMENT**2 * float(filter_.parameters["accel_scale_var"][0])
    _limit_tilt_confidence(intervals, errors)
    for start in range(0, len(solutions), BLOCK):
        rows = solutions[start : start + BLOCK]
        write(_corrected(rows, start + np.arange(len(rows)), intervals, errors, float(tuning["valid_tilt_rad"])))


def _errors(intervals: Records, estimates: Records) -> Records:
    """ERROR of each interval."""
    errors, history = np.zeros(len(intervals), ERROR), intervals["history"]
    yaw = about_down(_left_yaw(history))  # the errors are counted in axes that turn with the yaw
    yaw_before = np.concatenate([[[1.0, 0.0, 0.0, 0.0]], yaw[:-1]])
    to_corrected = matrices(yaw)
    errors["turn"] = of_rotation_vectors(np.einsum("nij,nj->ni", to_corrected, estimates["x"][:, :3]))
    var = estimates["attitude_var"].reshape(-1, 3, 3)
    errors["var"] = to_corrected @ var @ np.swapaxes(to_corrected, 1, 2)
    errors["bg"], errors["ba"] = estimates["x"][:, 3:6], estimates["x"][:, 6:]
    errors["bias_var"] = estimates["bias_var"]
    q, q_before = products(yaw, intervals["q_nb"]), products(yaw_before, history["q_before"])
    corrections = products(q, q_before * [1.0, -1.0, -1.0, -1.0])
    for k in reversed(range(1, len(intervals))):  # back over what was carried
        errors["turn_before"][k] = products(errors["turn"][k], corrections[k])
        if history["coarse"][k]:
            errors["turn"][k - 1], errors["var"][k - 1] = errors["turn_before"][k], errors["var"][k]
    errors["turn_before"][0] = products(errors["turn"][0], corrections[0])
    for end in np.flatnonzero(history["wrong_tilt_s"]):
        begin_ns = intervals["t_ns"][end] - np.round(1e9 * history["wrong_tilt_s"][end]).astype(np.int64)
        for k in range(end, int(np.searchsorted(intervals["t_ns"], begin_ns)), -1):
            errors["turn"][k - 1], errors["var"][k - 1] = errors["turn_before"][k], errors["var"][k]
            errors["turn_before"][k - 1] = products(errors["turn"][k - 1], corrections[k - 1])
    errors["turn"] = products(errors["turn"], yaw)
    errors["turn_before"] = products(errors["turn_before"], yaw_before)
    return errors


def _left_yaw(history: Records) -> Floats:
    """What the filter had left of the yaw's correction at the end of each interval and made at the first rest, rad."""
    yaw, made = np.zeros(len(history)), False
    for k in reversed(range(1, len(history))):
        made = bool(history["yaw_corrected"][k]) or (made and history["left_yaw"][k] != 0.0)
        yaw[k - 1] = history["left_yaw"][k] if made else 0.0
    return yaw


def _limit_tilt_confidence(intervals: Records, errors: Records) -> None:
    """The smoothed variances of the tilt become at least half the filter's smallest ones of the seconds around.

    Data before and after a moment know about equally much of the tilt: together they halve its variance. Where the
    recursion claims more, it counts on noises of the filter that are too small, as in walks begun in motion.
    """
    times_s = 1e-9 * intervals["t_ns"]
    first, last = (np.searchsorted(times_s, times_s + shift) for shift in (-_AROUND_S, _AROUND_S))
    diagonal = intervals["P"][:, [0, STATES]]  # packed upper triangle; the attitude comes first
    diagonal = diagonal + intervals["history"]["possible_tilt_var"][:, None]
    least = np.array([diagonal[begin:end].min(axis=0) for begin, end in zip(first, last, strict=True)])
    for i in range(2):
        errors["var"][:, i, i] = np.maximum(errors["var"][:, i, i], 0.5 * least[:, i])


def _corrected(rows: Records, at: Indices, intervals: Records, errors: Records, valid_tilt_rad: float) -> Records:
    """Solutions without the errors, which change evenly within an interval. at: their places among all solutions."""
    out, ends, times = rows.copy(), intervals["sample"], intervals["t_ns"]
    after = np.minimum(np.searchsorted(ends, at), len(ends) - 1)
    before = np.maximum(after - 1, 0)
    part = np.clip((rows["t_ns"] - times[before]) / np.maximum(times[after] - times[before], 1), 0.0, 1.0)
    restart_ns = intervals["history"]["restart_ns"][after]
    part = np.where(restart_ns > 0, rows["t_ns"] >= restart_ns, part)
    part = np.where((at >= ends[after]) | (before == after), 1.0, part)

    def at_rows(name: str) -> Floats:
        weight = part.reshape((-1,) + (1,) * (errors[name].ndim - 1))
        mean: Floats = (1.0 - weight) * errors[name][before] + weight * errors[name][after]
        return mean

    first = errors["turn"][before]
    then = np.where((at >= ends[after])[:, None], errors["turn"][after], errors["turn_before"][after])
    first = np.where(np.sum(first * then, axis=1)[:, None] < 0.0, -first, first)
    turn = first + part[:, None] * (then - first)
    out["q_nb"] = products(turn / np.linalg.norm(turn, axis=1)[:, None], rows["q_nb"])
    var, bias_sigmas = at_rows("var"), np.sqrt(at_rows("bias_var"))
    for bias, raw, axes in (("bg", "w", slice(0, 3)), ("ba", "f", slice(3, 6))):
        shift = at_rows(bias)
        out[bias] += shift
        out[raw] -= shift
        out[f"sigma_{bias}"] = bias_sigmas[:, axes]
    out["sigma_rpy"] = euler_sigmas(out["q_nb"], var)
    valid = np.maximum(var[:, 0, 0], var[:, 1, 1]) < valid_tilt_rad**2
    out["status"] = np.where(valid, out["status"] | ATTITUDE_VALID, out["status"] & ~(ATTITUDE_VALID | HEADING_VALID))
    return out
