"""Two estimates of one state, averaged by their variances: `combined`.

The errors of the two are taken as independent, and each component stands for itself: with variances a and b the mean
has the variance a b / (a + b). Where two differ by more than their sigmas allow, the sigma grows with their distance
(the Birge ratio). What only one of them knows is taken from it.
"""

import numpy as np

from ..estimators.records import ATTITUDE_VALID, HEADING_VALID, HEIGHT_VALID, POSITION_VALID
from ..math.arrays import Floats, Records
from ..math.earth import MEAN_RADIUS_M
from ..math.rotation_arrays import matrices, of_euler, wrapped

_CONTRADICTION = 4.0  # squared difference over its variance beyond which the sigma grows
_ALL_VALID = ATTITUDE_VALID | HEADING_VALID | POSITION_VALID | HEIGHT_VALID


def combined(forward: Records, backward: Records) -> Records:
    """Solutions (SOLUTION) of the same samples, of the filter that ran forward and of that which ran backward.

    Times and the bits AT_REST, COASTING, REJECTING and SATURATED are the forward ones.
    """
    out = forward.copy()
    out["status"] |= backward["status"] & _ALL_VALID
    _average_attitude(out, forward, backward)
    _average_position(out, forward, backward)
    for bias, raw, sign in (("bg", "w", -1.0), ("ba", "f", 1.0)):
        mean, sigma, _ = average(
            forward[bias], sign * backward[bias], forward[f"sigma_{bias}"], backward[f"sigma_{bias}"]
        )
        out[raw] -= np.nan_to_num(mean - forward[bias])
        out[bias], out[f"sigma_{bias}"] = mean, sigma
    return out


def average(a: Floats, b: Floats, sigma_a: Floats, sigma_b: Floats) -> tuple[Floats, Floats, Floats]:
    """(mean, its sigma, the weight of b); NaN: unknown.

    >>> mean, sigma, weight = average(np.array([1.0]), np.array([2.0]), np.array([1.0]), np.array([1.0]))
    >>> print(mean[0], round(sigma[0], 3), weight[0])
    1.5 0.707 0.5
    """
    var_a, var_b = np.square(sigma_a), np.square(sigma_b)
    only_a, only_b = np.isnan(b + var_b), np.isnan(a + var_a)
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.where(only_a, 0.0, np.where(only_b, 1.0, var_a / (var_a + var_b)))
        inflation = np.maximum(1.0, np.square(b - a) / (var_a + var_b) / _CONTRADICTION)
        variance = np.where(only_a, var_a, np.where(only_b, var_b, weight * var_b * inflation))
    mean = np.where(only_a, a, np.where(only_b, b, a + weight * (b - a)))
    return mean, np.sqrt(variance), weight


def _valid(rows: Records, bit: int) -> Floats:
    """1 where the bit is set, else NaN."""
    ones: Floats = np.where(rows["status"] & bit != 0, 1.0, np.nan)
    return ones


def _average_position(out: Records, forward: Records, backward: Records) -> None:
    f, b = (_valid(rows, POSITION_VALID) for rows in (forward, backward))
    f_height, b_height = (_valid(rows, HEIGHT_VALID) for rows in (forward, backward))
    lat, lon = (np.where(np.isnan(f), backward[name], forward[name]) for name in ("lat", "lon"))
    height = np.where(np.isnan(f_height) & ~np.isnan(b_height), backward["height"], forward["height"])
    east_m = MEAN_RADIUS_M * np.cos(lat)
    components = (  # backward less forward
        ((backward["lat"] - lat) * MEAN_RADIUS_M, f, b),
        (wrapped(backward["lon"] - lon) * east_m, f, b),
        (height - backward["height"], f_height, b_height),
    )
    shift = np.zeros((len(out), 3))
    for i, (difference, of_forward, of_backward) in enumerate(components):
        known = ~np.isnan(of_forward) | ~np.isnan(of_backward)
        sigmas = forward["sigma_p"][:, i] * of_forward, backward["sigma_p"][:, i] * of_backward
        mean, sigma, _ = average(0.0 * difference, difference, *sigmas)
        shift[:, i] = np.where(known, mean, 0.0)
        out["sigma_p"][:, i] = np.where(known, sigma, forward["sigma_p"][:, i])
    out["lat"], out["lon"], out["height"] = (
        lat + shift[:, 0] / MEAN_RADIUS_M,
        wrapped(lon + shift[:, 1] / east_m),
        height - shift[:, 2],
    )
    v, sigma_v, _ = average(
        forward["v"], -backward["v"], forward["sigma_v"] * f[:, None], backward["sigma_v"] * b[:, None]
    )
    known = (~np.isnan(f) | ~np.isnan(b))[:, None]
    out["v"], out["sigma_v"] = np.where(known, v, forward["v"]), np.where(known, sigma_v, forward["sigma_v"])


def _average_attitude(out: Records, forward: Records, backward: Records) -> None:
    """The vertical in body axes, which no yaw changes; then yaw. One that is not from north stays the forward one."""
    f, b = (_valid(rows, ATTITUDE_VALID) for rows in (forward, backward))
    of_f, of_b = (matrices(rows["q_nb"]) for rows in (forward, backward))
    sigma_f, sigma_b = forward["sigma_rpy"] * f[:, None], backward["sigma_rpy"] * b[:, None]
    tilt_f, tilt_b = (np.hypot(sigma[:, 0], sigma[:, 1]) for sigma in (sigma_f, sigma_b))
    away = np.linalg.norm(of_f[:, 2] - of_b[:, 2], axis=1)
    _, tilt, weight = average(0.0 * away, away, tilt_f, tilt_b)
    down = (1.0 - weight)[:, None] * np.nan_to_num(of_f[:, 2]) + weight[:, None] * np.nan_to_num(of_b[:, 2])
    down /= np.linalg.norm(down, axis=1)[:, None]
    roll, pitch = np.arctan2(down[:, 1], down[:, 2]), np.arcsin(np.clip(-down[:, 0], -1.0, 1.0))

    yaw_f, yaw_b = (np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0]) for matrix in (of_f, of_b))
    difference = wrapped(yaw_b - yaw_f)
    north_f, north_b = (_valid(rows, HEADING_VALID) for rows in (forward, backward))
    north = ~np.isnan(north_f) | ~np.isnan(north_b)
    mean, yaw_sigma, _ = average(0.0 * difference, difference, sigma_f[:, 2] * north_f, sigma_b[:, 2] * north_b)
    turn = np.where(north, mean, 0.0)

    known = ~np.isnan(f) | ~np.isnan(b)
    out["q_nb"] = np.where(known[:, None], of_euler(roll, pitch, yaw_f + turn), forward["q_nb"])
    surer = np.where((weight < 0.5)[:, None], forward["sigma_rpy"], backward["sigma_rpy"])
    factor = tilt / np.hypot(surer[:, 0], surer[:, 1])
    sigmas = np.stack(
        [surer[:, 0] * factor, surer[:, 1] * factor, np.where(north, yaw_sigma, forward["sigma_rpy"][:, 2])]
    )
    out["sigma_rpy"] = np.where(known[:, None], sigmas.T, forward["sigma_rpy"])
