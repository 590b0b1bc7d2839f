"""Epson M-G350-PD11, the device's side of its UART: the flat register map and the frames without a checksum.

Facts: the data sheet's scale factors; registers and commands as public host code drives them (docs/protocols.md §1).
"""

import struct

from .epson import EpsonSensor, Map
from .noise import ImuErrors, Signal
from .sampling import M_G350_WORDS

_COUNT_CTRL = (0, 0x50)
_NAMES = {(0, 0x6A): b"G350PD11", (0, 0x72): b"\x13\x00", (0, 0x74): b"S0000042"}  # product, version, serial number

TAPS_G350 = {1: 2, 2: 4, 3: 8, 4: 16, 5: 32, 6: 64, 7: 128}  # filter code -> taps
TAPS_V340 = {2: 1, 3: 2, 4: 4, 5: 8, 6: 16, 7: 32}  # the sibling's table, should a unit have that one


class G350(EpsonSensor):
    """One unit, switched on at time 0."""

    header = 0x20
    map = Map(
        flag=(0, 0x00),
        data=tuple((0, address) for address in range(0x02, 0x10, 2)),
        gpio=(0, 0x10),
        count=(0, 0x12),
        burst=(0, 0x20),
        signal=(0, 0x32),
        test=(0, 0x34),
        rate=(0, 0x36),
        filter=(0, 0x38),
        mode=(0, 0x38),
        uart=(0, 0x3A),
        diagnosis=(0, 0x3C),
        command=(0, 0x3E),
        reset={
            (0, 0x10): (0x0200, 0x0707),  # GPIO: DATA b10-8, DIR b2-0
            (0, 0x32): (0xFE00, 0xFE00),  # new-data flags enabled
            (0, 0x34): (0x0006, 0x00E6),  # DRDY on, active high; EXT_SEL, EXT_POL
            (0, 0x36): (0x0100, 0x0F00),  # rate code
            (0, 0x38): (0x0001, 0x00FF),  # filter code
            (0, 0x3A): (0x0000, 0x0003),  # UART_AUTO b0, AUTO_START b1
            (0, 0x3C): (0x0000, 0x0000),
            _COUNT_CTRL: (0x0000, 0x0001),  # COUNT in frames
        },
    )

    def __init__(
        self,
        signal: Signal,
        errors: ImuErrors,
        baud: int = 460800,
        *,
        count_step: int | None = None,
        identity: bool = True,
        taps: dict[int, int] = TAPS_G350,
        oscillator: float = 1.0,
    ) -> None:
        """identity: whether product name, version and serial number are there to read. The rest: see EpsonSensor."""
        names = _NAMES if identity else {}
        super().__init__(signal, errors, baud, M_G350_WORDS, taps, names, 0.08, count_step, oscillator)

    def _fields(self) -> bytes:
        count = struct.pack(">H", self._count) if self._word[_COUNT_CTRL] & 1 else b""
        return struct.pack(">H", self._flag) + self._sample + struct.pack(">H", self._word[self.map.gpio]) + count
