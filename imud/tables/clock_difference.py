"""Samples and fixes on clocks that differ: by the turns that both show.

The angle by which the sensor turns about the vertical between two fixes is that by which the course turns, if the
vehicle goes where it points. So the one is regressed on the other, with a constant for the gyro bias, for each
difference of the clocks. The regression must explain nearly all, with the scale 1, to be believed, and much less at all
the differences that the navigation filter finds by itself. What drifts or hovers proves nothing.
"""

from collections.abc import Callable

import numpy as np

from ..math.arrays import Floats, Records
from ..math.earth import MEAN_RADIUS_M

_STEP_S, _LARGEST_S = 0.25, 120.0  # differences that are compared
_FOUND_S = 1.5  # up to which the navigation filter finds them by itself
_APART_S = (0.9, 3.0)  # between two fixes
_SLOWEST_MPS = 2.0  # the course of what is slower is noise
_PAIRS = 40  # of fixes
_COMPARED_S = 900.0  # from the first pair on: more needs more memory
_TURNED_RAD = np.pi  # in all, to and fro
_EXPLAINED = 0.9  # share of the variance
_RESIDUAL = 0.2  # of the best one, over the least that the filter would find
_ALIKE = 2.0  # residuals of two differences that are as good as each other, one over the other
_SCALES = (0.8, 1.25)
_LEVELLING_S = 2.0  # over which the specific force is averaged for the vertical


def warn_of_clocks(
    samples: Records, fixes: Records, warn: Callable[[str], object], remedy: Callable[[float], str]
) -> None:
    """Call `warn` if the fixes (array of FIX) are plainly on another clock than the samples (array of SAMPLE).

    remedy: what the user is to do about fixes that are so many seconds behind.
    """
    if (behind_s := clock_difference_s(samples, fixes)) is not None:
        side = "behind" if behind_s > 0.0 else "ahead of"
        warn(
            f"the times of its fixes are about {abs(behind_s):g} s {side} those of the inertial sensor, by the turns "
            f"in both: the estimates are wrong; {remedy(behind_s)}"
        )


def clock_difference_s(samples: Records, fixes: Records) -> float | None:
    """By how much the times of the fixes (array of FIX) are behind those of the samples (array of SAMPLE).

    None: it is small, or not known.
    """
    if len(fixes) < _PAIRS:
        return None
    begin, end, course = _turns_of_course(fixes)
    if len(course) < _PAIRS:
        return None
    within = np.searchsorted(samples["t_ns"], 1e9 * np.array([begin[0] - _LARGEST_S, end[-1] + _LARGEST_S]))
    samples = samples[slice(*within)]
    if len(samples) < 2:
        return None
    t_s, yaw = 1e-9 * samples["t_ns"], _turned(samples)
    differences = np.arange(-_LARGEST_S, _LARGEST_S + _STEP_S, _STEP_S)
    explained, scales = np.zeros((2, len(differences)))
    for i, difference in enumerate(differences):
        inside = (begin + difference >= t_s[0]) & (end + difference <= t_s[-1])
        if inside.sum() < _PAIRS or np.abs(course[inside]).sum() < _TURNED_RAD:
            continue
        turned = np.interp(end + difference, t_s, yaw) - np.interp(begin + difference, t_s, yaw)
        gyro, receiver = turned[inside] - turned[inside].mean(), course[inside] - course[inside].mean()
        both, most = gyro @ receiver, (gyro @ gyro) * (receiver @ receiver)
        if both > 0.0:
            explained[i], scales[i] = both * both / most, gyro @ gyro / both
    residual, near = 1.0 - explained, np.abs(differences) <= _FOUND_S
    best = _nearest_minimum(residual)
    is_clear = explained[best] > _EXPLAINED and _SCALES[0] < scales[best] < _SCALES[1]
    is_clear = is_clear and residual[best] < _RESIDUAL * residual[near].min()
    return float(differences[best]) if is_clear else None


def _nearest_minimum(residual: Floats) -> int:
    """Of the minima that are about as good as the best one, the one nearest to no difference: a tractor that goes to
    and fro over a field turns alike at many of them.
    """
    outside = np.pad(residual, 1, constant_values=np.inf)
    is_minimum = (residual <= outside[:-2]) & (residual <= outside[2:]) & (residual <= _ALIKE * residual.min())
    minima = np.flatnonzero(is_minimum)
    return int(minima[np.argmin(np.abs(minima - len(residual) // 2))])


def _turns_of_course(fixes: Records) -> tuple[Floats, Floats, Floats]:
    """Begin and end (s) of pairs of fixes in motion, and by how much the course turns between them (rad)."""
    fixes = fixes[np.argsort(fixes["t_ns"], kind="stable")]
    seconds = (fixes["t_ns"] - fixes["t_ns"][:1] + 500_000_000) // 1_000_000_000
    fixes = fixes[np.unique(seconds, return_index=True)[1]]  # so that pairs do not overlap
    t_s, v = 1e-9 * fixes["t_ns"], _velocity(fixes)
    fast = np.flatnonzero(np.abs(v) > _SLOWEST_MPS)
    second = np.searchsorted(t_s, t_s[fast] + _APART_S[0])
    known = (second < len(fixes)) & np.isin(second, fast)
    first, second = fast[known], second[known]
    close = t_s[second] - t_s[first] < _APART_S[1]
    first, second = first[close], second[close]
    early = t_s[second] < t_s[first[:1]] + _COMPARED_S
    first, second = first[early], second[early]
    return t_s[first], t_s[second], np.angle(v[second] * np.conj(v[first]))


def _velocity(fixes: Records) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    """North + i east, m/s, as reported, or by the positions."""
    reported = fixes["v"][:, 0] + 1j * fixes["v"][:, 1]
    reported = np.where(np.isfinite(reported), reported, fixes["speed"] * np.exp(1j * fixes["course"]))
    t_s, lat, lon = 1e-9 * fixes["t_ns"], fixes["lat"], np.unwrap(fixes["lon"])
    by_positions = MEAN_RADIUS_M * (np.gradient(lat, t_s) + 1j * np.cos(lat) * np.gradient(lon, t_s))
    return np.where(np.isfinite(reported), reported, by_positions)


def _turned(samples: Records) -> Floats:
    """The angle by which the sensor has turned about the vertical since the first sample, rad."""
    t_s, w, sums = 1e-9 * samples["t_ns"], np.nan_to_num(samples["w"]), np.cumsum(np.nan_to_num(samples["f"]), axis=0)
    half, at = max(1, round(0.5 * _LEVELLING_S / float(np.median(np.diff(t_s))))), np.arange(len(t_s))
    up = sums[np.minimum(at + half, len(t_s) - 1)] - sums[np.maximum(at - half, 0)]
    rate = -np.einsum("ij,ij->i", w, up) / np.maximum(np.linalg.norm(up, axis=1), 1e-9)
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s))])
