"""The overlapping Allan variance of a rate signal.

Source: IEEE Std 952-2020, annex C; W. J. Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, sec. 5.2.3.
"""

from ..compile.jit import kernel
from .arrays import Floats


@kernel
def integrated(rate: Floats, out: Floats) -> None:
    """Running sum of `rate` (n) less its mean, from zero, into `out` (n + 1): the mean would cost digits."""
    mean = 0.0
    for i in range(len(rate)):
        mean += (rate[i] - mean) / (i + 1)
    out[0] = 0.0
    for i in range(len(rate)):
        out[i + 1] = out[i] + (rate[i] - mean)


@kernel
def allan_variance(angle: Floats, m: int) -> float:
    """Overlapping Allan variance of the rate whose running sum is `angle`, over clusters of `m` samples.

    In the rate's unit squared. `angle` must have at least 2 m + 1 values.
    """
    total = 0.0
    terms = len(angle) - 2 * m
    for k in range(terms):
        second = angle[k + 2 * m] - 2.0 * angle[k + m] + angle[k]
        total += second * second
    return total / (2.0 * terms * m * m)
