"""The two dialects of Epson's inertial sensors: where their registers are, and what their automatic frames look like.

Flat: M-G350 and M-V340 (sensor_epsonV340.h of Epson's public driver; rtedwards' code for the G350). Windowed: M-G320,
M-G354, M-G362 and all later ones (register maps of Epson's py_esensorlib; docs/protocols.md §1.7), known by their ID.
"""

from dataclasses import dataclass

from .registers import Register, Setting


@dataclass(frozen=True)
class Layout:
    """Automatic frames of one shape, and the register words that make a sensor send them."""

    header: int
    length: int  # bytes, header and CR included
    settings: tuple[Setting, ...]
    checked: bool = False  # the word before CR is the sum of the words between the header and it
    drawback: str = ""


@dataclass(frozen=True)
class Dialect:
    """Registers by their purpose. In MODE_CTRL, SMPL_CTRL and MSC_CTRL the high byte is what is written."""

    mode: Register  # MODE_CTRL
    rate: Register  # SMPL_CTRL
    filter: Register  # low byte
    uart: Register  # UART_CTRL
    test: Register  # MSC_CTRL
    signal: Register  # SIG_CTRL
    diagnosis: Register  # DIAG_STAT
    command: Register  # GLOB_CMD
    product: tuple[Register, ...]
    version: Register
    serial: tuple[Register, ...]
    layouts: tuple[Layout, ...]  # that this driver asks for, best first
    lengths: range  # of frames that another host may have asked for
    rates: dict[int, float]  # samples per second by rate code

    @property
    def header(self) -> int:
        """Of all its frames."""
        return self.layouts[0].header


def _text(first: int, window: int | None) -> tuple[Register, ...]:
    return tuple(Register(first + 2 * i, window) for i in range(4))


BINARY_RATES = {1: 1000.0, 2: 500.0, 3: 250.0, 4: 125.0, 5: 62.5, 6: 31.25, 7: 15.625}
# without 13, 40/s: a byte that is CR may end the command before its time
DECIMAL_RATES = {8: 400.0, 9: 200.0, 10: 100.0, 11: 80.0, 12: 50.0, 14: 25.0, 15: 20.0}

_COUNT_CTRL = Register(0x50)
FLAT = Dialect(
    mode=Register(0x38),
    rate=Register(0x36),
    filter=Register(0x38),
    uart=Register(0x3A),
    test=Register(0x34),
    signal=Register(0x32),
    diagnosis=Register(0x3C),
    command=Register(0x3E),
    product=_text(0x6A, None),
    version=Register(0x72),
    serial=_text(0x74, None),
    layouts=(
        Layout(0x20, 22, ((_COUNT_CTRL, 1, None),)),
        Layout(
            0x20, 20, ((_COUNT_CTRL, 0, None),), drawback="the sensor does not number its samples: losses are estimated"
        ),
    ),
    lengths=range(20, 24, 2),
    rates=BINARY_RATES,
)

IDENTITY, IDENTITY_VALUE = Register(0x4C, 0), 0x5345  # of the windowed dialect alone
_BURST_CTRL1, _BURST_CTRL2 = Register(0x0C, 1), Register(0x0E, 1)
_FIELDS = (_BURST_CTRL1, 0x03, 0xF0)  # COUNT, checksum; flags, temperature, gyros, accelerometers
WIDE = Layout(0x80, 36, (_FIELDS, (_BURST_CTRL2, None, 0x70)), checked=True)  # all but FLAG and COUNT of 32 bits
NARROW = Layout(0x80, 22, (_FIELDS, (_BURST_CTRL2, None, 0x00)), checked=True)
WINDOWED = Dialect(
    mode=Register(0x02, 0),
    rate=Register(0x04, 1),
    filter=Register(0x06, 1),
    uart=Register(0x08, 1),
    test=Register(0x02, 1),
    signal=Register(0x00, 1),
    diagnosis=Register(0x04, 0),
    command=Register(0x0A, 1),
    product=_text(0x6A, 1),
    version=Register(0x72, 1),
    serial=_text(0x74, 1),
    layouts=(WIDE, NARROW),
    lengths=range(8, 74, 2),
    rates={0: 2000.0} | BINARY_RATES | DECIMAL_RATES,
)
