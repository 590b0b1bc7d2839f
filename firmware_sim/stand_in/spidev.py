"""Stand-in for the package spidev: the same calls, on the emulated sensors of `imud.firmware_sim.bench`.

Put the folder of this file on PYTHONPATH, and say in IMUD_SIM which sensors (see `python -m imud.firmware_sim --help`).
"""

import errno
import os
import sys
from collections.abc import Sequence

from imud.firmware_sim.bench import ChipSelect, chip_selects


class SpiDev:
    """One open device, as spidev 3.8 has it."""

    def __init__(self) -> None:
        self._socket: ChipSelect | None = None
        self.mode = 0
        self.bits_per_word = 8
        self.max_speed_hz = 500_000
        self.lsbfirst = self.cshigh = self.no_cs = False

    def open(self, bus: int, device: int) -> None:
        """Raises OSError like the original."""
        if bus != 0 or device >= len(chip_selects()):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        self._socket = chip_selects()[device]

    def xfer2(
        self, values: Sequence[int], speed_hz: int = 0, delay_usecs: int = 0, bits_per_word: int = 0
    ) -> list[int]:
        """Chip select low throughout; the delay comes behind the last byte. A list is overwritten with the answer."""
        if self._socket is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        if (bits_per_word or self.bits_per_word) != 8 or self.lsbfirst or self.cshigh or self.no_cs:
            return [0xFF] * len(values)
        clock_hz = speed_hz or self.max_speed_hz
        answer = list(self._socket.transfer(bytes(values), clock_hz, self.mode, delay_usecs * 1e-6))
        if isinstance(values, list):
            values[:] = answer
            return values
        return answer

    def close(self) -> None:
        """Say on stderr how the device was treated."""
        if self._socket is not None:
            print(f"stand-in spidev: {self._socket}", file=sys.stderr, flush=True)
        self._socket = None
