"""Epson M-G364, M-G365 and M-G370, the device's side of their UART: two register windows, frames as BURST_CTRL asks.

Facts: register maps, defaults and scale factors of Epson's public drivers (docs/protocols.md §1.7). The 16-bit words
are the high words of the 32-bit ones. Delta angles, attitude, range and flash are not emulated: those bits of
BURST_CTRL are not stored.
"""

import struct
from dataclasses import dataclass, replace

from .epson import BINARY_RATES, EpsonSensor, Map
from .noise import DEG, M_G350, MILLI_G, STANDARD_GRAVITY, Grade, ImuErrors, Signal
from .sampling import Words

_BURST_CTRL1, _BURST_CTRL2 = (1, 0x0C), (1, 0x0E)
_TEMPERATURE, _GYRO, _ACCELEROMETER = (0x4000, range(1)), (0x2000, range(1, 4)), (0x1000, range(4, 7))
_FLAG, _GPIO, _COUNT, _CHECKSUM = 0x8000, 0x0004, 0x0002, 0x0001
TAPS = {code: 1 << code for code in range(8)}  # filter code -> taps; the Kaiser filters are not emulated
_DECIMAL_RATES = {8: 5, 9: 10, 10: 20, 11: 25, 12: 40, 13: 50, 14: 80, 15: 100}  # 400 to 20 /s


@dataclass(frozen=True)
class Variant:
    """What sets a model apart."""

    product: bytes
    words: Words
    limit: tuple[float, float]  # rad/s and m/s^2
    self_test_s: float = 0.08

    @property
    def grade(self) -> Grade:
        """The M-G350's noise, with this model's range."""
        return replace(M_G350, limit=self.limit)


_G = STANDARD_GRAVITY
G364 = Variant(b"G364PDCA", Words(0.00375 * DEG, 0.125 * MILLI_G, -0.0037918, 2634, 4), (100.0 * DEG, 3.0 * _G))
G365 = Variant(b"G365PDF1", Words(DEG / 66.0, 0.4 * MILLI_G, -0.0037918, 2634, 4), (450.0 * DEG, 10.0 * _G))
G370 = Variant(b"G370PDF1", Words(DEG / 66.0, 0.4 * MILLI_G, -0.0037918, 2634, 4), (450.0 * DEG, 10.0 * _G), 0.15)
VARIANTS = {"g364": G364, "g365": G365, "g370": G370}


class Windowed(EpsonSensor):
    """One unit, switched on at time 0."""

    header = 0x80
    map = Map(
        flag=(0, 0x06),
        data=tuple((0, address) for address in range(0x0E, 0x2A, 4)),
        gpio=(0, 0x08),
        count=(0, 0x0A),
        burst=(0, 0x80),
        signal=(1, 0x00),
        test=(1, 0x02),
        rate=(1, 0x04),
        filter=(1, 0x06),
        mode=(0, 0x02),
        uart=(1, 0x08),
        diagnosis=(0, 0x04),
        command=(1, 0x0A),
        reset={
            (0, 0x04): (0x0000, 0x0000),
            (0, 0x08): (0x0200, 0x0707),
            (0, 0x4C): (0x5345, 0x0000),  # ID
            (1, 0x00): (0xFE00, 0xFE00),  # new-data flags enabled
            (1, 0x02): (0x0006, 0x00E6),
            (1, 0x04): (0x0103, 0x0F00),  # rate code
            (1, 0x06): (0x0001, 0x001F),  # filter code
            (1, 0x08): (0x0000, 0x0003),  # UART_AUTO b0, AUTO_START b1
            _BURST_CTRL1: (0xF006, 0xF007),
            _BURST_CTRL2: (0x0000, 0x7000),
            **{(1, 0x38 + 2 * i): (0x4000 if i % 4 == 0 else 0x0000, 0xFFFF) for i in range(9)},  # rotation matrix
        },
        window=0x7E,
        rates={0: 1, **BINARY_RATES, **_DECIMAL_RATES},
    )

    def __init__(
        self,
        variant: Variant,
        signal: Signal,
        errors: ImuErrors,
        baud: int = 460800,
        *,
        count_step: int | None = None,
        oscillator: float = 1.0,
    ) -> None:
        """See EpsonSensor."""
        names = {(1, 0x6A): variant.product, (1, 0x72): b"\x30\x02", (1, 0x74): b"W0000042"}
        seconds = variant.self_test_s
        super().__init__(signal, errors, baud, variant.words, TAPS, names, seconds, count_step, oscillator)

    def _fields(self) -> bytes:
        chosen, wide = self._word[_BURST_CTRL1], self._word[_BURST_CTRL2]
        fields = struct.pack(">H", self._flag) if chosen & _FLAG else b""
        for bit, values in (_TEMPERATURE, _GYRO, _ACCELEROMETER):
            if chosen & bit:
                fields += b"".join(self._value(i)[: 4 if wide & bit else 2] for i in values)
        if chosen & _GPIO:
            fields += struct.pack(">H", self._word[self.map.gpio])
        if chosen & _COUNT:
            fields += struct.pack(">H", self._count)
        if chosen & _CHECKSUM:
            fields += struct.pack(">H", sum(struct.unpack(f">{len(fields) // 2}H", fields)) & 0xFFFF)
        return fields
