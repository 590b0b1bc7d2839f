"""Numbers as decimal text, written straight into a byte buffer: a replay writes tens of millions of them."""

import numpy as np
from numpy.typing import NDArray

from ..compile.jit import kernel

Bytes = NDArray[np.uint8]
_ZERO, _MINUS, _POINT = ord("0"), ord("-"), ord(".")
MAX_WIDTH = 22  # sign, 19 digits of an int64, point, separator
_LARGEST = 9.2e18
_UNITS = np.array([10**n for n in range(19)])
_PAIRS = np.frombuffer("".join(f"{n:02d}" for n in range(100)).encode(), np.uint8)


@kernel
def _write_digits(buffer: Bytes, end: int, value: int, digits: int) -> None:
    """Write the last `digits` digits of value >= 0, in pairs, so that they end before `end`."""
    while digits > 3:
        rest = value // 10_000
        four = value - 10_000 * rest
        high = four * 5243 >> 19  # four // 100, for numbers below 43 699
        low = 2 * (four - 100 * high)
        high *= 2
        buffer[end - 4] = _PAIRS[high]
        buffer[end - 3] = _PAIRS[high + 1]
        buffer[end - 2] = _PAIRS[low]
        buffer[end - 1] = _PAIRS[low + 1]
        value = rest
        end -= 4
        digits -= 4
    if digits > 1:
        rest = value // 100
        pair = 2 * (value - 100 * rest)
        buffer[end - 2] = _PAIRS[pair]
        buffer[end - 1] = _PAIRS[pair + 1]
        value = rest
        end -= 2
        digits -= 2
    if digits > 0:
        buffer[end - 1] = _ZERO + value % 10


@kernel
def write_integer(buffer: Bytes, at: int, value: int) -> int:
    """Write value >= 0; returns the position behind it."""
    if value < 10:
        buffer[at] = _ZERO + value
        return at + 1
    n = 1
    rest = value // 10
    while rest > 0:
        n += 1
        rest //= 10
    _write_digits(buffer, at + n, value, n)
    return at + n


@kernel
def write_fixed(buffer: Bytes, at: int, value: float, decimals: int) -> int:
    """Write `value` with `decimals` digits after the point, halves away from zero; returns the position behind it.

    decimals: 0 to 18. Nothing is written unless |value| 10^decimals fits 63 bits: NaN and infinity become empty cells.
    """
    unit = _UNITS[decimals]
    size = abs(value)
    scaled = size * unit + 0.5
    if not scaled < _LARGEST:
        return at
    digits = int(scaled)
    if value < 0.0 and digits > 0:
        buffer[at] = _MINUS
        at += 1
    whole = int(size)
    fraction = digits - whole * unit
    if fraction < 0 or fraction >= unit:  # rounded to the next whole number, or larger than doubles are exact
        whole = digits // unit
        fraction = digits - whole * unit
    at = write_integer(buffer, at, whole)
    if decimals > 0:
        buffer[at] = _POINT
        at += 1 + decimals
        _write_digits(buffer, at, fraction, decimals)
    return at


@kernel
def write_seconds(buffer: Bytes, at: int, t_ns: int) -> int:
    """Write int64 ns as seconds with nine decimals; returns the position behind it."""
    if t_ns < 0:
        buffer[at] = _MINUS
        at += 1
        t_ns = -t_ns
    whole = t_ns // 1_000_000_000
    at = write_integer(buffer, at, whole)
    buffer[at] = _POINT
    _write_digits(buffer, at + 10, t_ns - whole * 1_000_000_000, 9)
    return at + 10
