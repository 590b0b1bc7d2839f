"""Bytes and big-endian 16-bit words in a receive buffer, for the decoders of devices that send such."""

import numpy as np
from numpy.typing import NDArray

from .jit import kernel

Bytes = NDArray[np.uint8]  # a receive buffer


@kernel
def byte(rx: Bytes, i: int) -> int:
    """The byte at i >= 0. An unsigned index spares numba the check for one that counts from the end."""
    return int(np.int64(rx[np.uint64(i)]))


@kernel
def word(rx: Bytes, i: int) -> int:
    """Unsigned word at i."""
    return byte(rx, i) << 8 | byte(rx, i + 1)


@kernel
def signed(rx: Bytes, i: int) -> int:
    """Two's complement word at i."""
    return (word(rx, i) ^ 0x8000) - 0x8000


@kernel
def move_to_front(rx: Bytes, start: int, n: int) -> None:
    """rx[:n] <- rx[start : start + n]"""
    if start > 0:
        for i in range(n):
            rx[np.uint64(i)] = rx[np.uint64(start + i)]
