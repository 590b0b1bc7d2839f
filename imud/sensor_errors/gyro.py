"""A gyro's bias at rest, and its temperature coefficient."""

import numpy as np

from ..math.arrays import Records
from .rest import WINDOW_S, Estimate, UnfitError, mean, rest_intervals, windows

_BIAS_S = 10.0  # the least time at rest for a bias
_SPAN_K = 5.0  # of temperature, for a slope


def bias(samples: Records, rate_hz: float) -> Estimate:
    """Bias in rad/s (3) from the longest time at rest. Raises UnfitError."""
    interval = max(rest_intervals(samples, rate_hz), key=lambda s: s.stop - s.start)
    seconds = (interval.stop - interval.start) / rate_hz
    if seconds < _BIAS_S:
        raise UnfitError(f"the longest rest lasts {seconds:.1f} s; the gyro's bias needs {_BIAS_S:.0f} s")
    return mean(samples["w"][interval.start : interval.stop], max(1, round(WINDOW_S * rate_hz)))


def slope(samples: Records, rate_hz: float) -> tuple[Estimate, Estimate, float]:
    """Bias in rad/s at the mean temperature, its slope in rad/s/K (3 each), and that temperature. Raises UnfitError."""
    intervals = rest_intervals(samples, rate_hz)
    rest = np.concatenate([samples[s.start : s.stop] for s in intervals])
    if not np.isfinite(rest["temperature"]).all():
        raise UnfitError("the recording holds no temperature")
    m = max(1, round(2.0 * WINDOW_S * rate_hz))
    w = windows(rest["w"], m).mean(axis=1)
    t = rest["temperature"][: len(w) * m].reshape(-1, m).mean(axis=1)
    if np.ptp(t) < _SPAN_K:
        raise UnfitError(
            f"the temperature changes by {np.ptp(t):.1f} K only; a slope needs {_SPAN_K:.0f} K: start cold"
        )
    centre = float(t.mean())
    A = np.stack([np.ones_like(t), t - centre], axis=1)
    solution = np.linalg.lstsq(A, w, rcond=None)[0]
    noise = (w - A @ solution).std(axis=0, ddof=2)
    sigma = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))[:, None] * noise
    return Estimate(solution[0], sigma[0]), Estimate(solution[1], sigma[1]), centre
