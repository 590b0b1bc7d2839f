"""Big-endian 16-bit words in a receive buffer, for the decoders of devices that send such."""

from typing import Any

from .jit import kernel


@kernel
def word(rx: Any, i: int) -> int:
    """Unsigned word at i."""
    high: int = rx[i]
    low: int = rx[i + 1]
    return high * 256 + low


@kernel
def signed(rx: Any, i: int) -> int:
    """Two's complement word at i."""
    return (word(rx, i) ^ 0x8000) - 0x8000
