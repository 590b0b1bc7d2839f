"""Numbers as decimal text, written straight into a byte buffer: a replay writes tens of millions of them."""

import numpy as np
from numpy.typing import NDArray

from ..compile.jit import kernel

Bytes = NDArray[np.uint8]
_ZERO, _MINUS, _POINT = ord("0"), ord("-"), ord(".")
MAX_WIDTH = 22  # sign, 19 digits of an int64, point, separator
_LARGEST = 9.2e18


@kernel
def write_integer(buffer: Bytes, at: int, value: int, digits: int) -> int:
    """Write value >= 0 with at least `digits` digits; returns the position behind it."""
    n = 1
    rest = value // 10
    while rest > 0:
        n += 1
        rest //= 10
    n = max(n, digits)
    for i in range(n - 1, -1, -1):
        buffer[at + i] = _ZERO + value % 10
        value //= 10
    return at + n


@kernel
def write_fixed(buffer: Bytes, at: int, value: float, decimals: int) -> int:
    """Write `value` with `decimals` digits after the point, halves away from zero; returns the position behind it.

    Nothing is written unless |value| 10^decimals fits 63 bits: NaN and infinity become empty cells.
    """
    unit = 1
    for _ in range(decimals):
        unit *= 10
    scaled = abs(value) * unit + 0.5
    if not scaled < _LARGEST:
        return at
    digits = int(scaled)
    if value < 0.0 and digits > 0:
        buffer[at] = _MINUS
        at += 1
    at = write_integer(buffer, at, digits // unit, 1)
    if decimals > 0:
        buffer[at] = _POINT
        at = write_integer(buffer, at + 1, digits % unit, decimals)
    return at


@kernel
def write_seconds(buffer: Bytes, at: int, t_ns: int) -> int:
    """Write int64 ns as seconds with nine decimals; returns the position behind it."""
    if t_ns < 0:
        buffer[at] = _MINUS
        at += 1
        t_ns = -t_ns
    at = write_integer(buffer, at, t_ns // 1_000_000_000, 1)
    buffer[at] = _POINT
    return write_integer(buffer, at + 1, t_ns % 1_000_000_000, 9)
