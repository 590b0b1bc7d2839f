"""SparkFun Serial Accelerometer V5, the device's side of its UART: menu, three output modes, any byte stops the stream.

Facts: docs/protocols.md §3 (the seed's specimen line and limits), the firmware of the board's successor, and the data
sheet of the MMA7260QT on it. What the V5 itself says in its menu is not known: the wording here is our own. The board
lies with its parts up: its x is forward, y left, z up, and it reports +1 g on the axis that points up.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .noise import MILLI_G, STANDARD_GRAVITY, Grade, ImuErrors, Signal
from .uart import BITS, Uart

BAUDS = (9600, 19200, 38400, 57600)
MODES = ("gravity", "raw", "binary")
RATE_MAX_HZ = {"gravity": 125.0, "raw": 195.0, "binary": 195.0}  # the seed's table
MV_PER_G = {1.5: 800, 2.0: 600, 4.0: 300, 6.0: 200}  # data sheet, by range
_SUPPLY_MV, _ZERO_G_MV, _FULL_COUNT = 3300, 1650, 1023
_SWING_MV = 1400.0  # the sensor's output stays 0.25 V away from supply and ground
_BOARD = np.array([1.0, -1.0, -1.0]) / STANDARD_GRAVITY  # FRD in m/s^2 to the board's axes in g
_BOOT_S, _START_S = 0.2, 0.02
_BLOCK = 32  # lines computed ahead
_WIRE_SHARE = 0.95

_log = logging.getLogger("firmware_sim.seraccel")


def mma7260(rate_hz: float, range_g: float = 1.5) -> Grade:
    """Errors of a calibrated unit: 350 ug/sqrt(Hz) up to the pole at 350 Hz, all of it aliased into `rate_hz`."""
    noise = 0.35 * MILLI_G * math.sqrt(350.0 * math.pi / 2.0 / rate_hz)
    return Grade(
        random_walk=(0.0, noise),
        turn_on=(0.0, 20.0 * MILLI_G),
        in_run=(0.0, 2.0 * MILLI_G),
        scale=(0.0, 0.02),
        misalignment=(0.0, math.radians(0.5)),
        limit=(math.inf, _SWING_MV / MV_PER_G[range_g] * STANDARD_GRAVITY),
    )


@dataclass
class Settings:
    """The settings of the menu, which the board stores."""

    mode: str = "gravity"
    rate_hz: float = 50.0
    range_g: float = 1.5


class SerAccel:
    """One board, switched on at time 0.

    streaming: streams from then on, as after a stray byte's menu was left; else it waits in its menu.
    labelled: X=, Y=, Z= before gravity values of three decimals, as the seed shows; else two decimals and tabs.
    oscillator: speed of its clock against true time.
    """

    def __init__(
        self,
        signal: Signal,
        errors: ImuErrors,
        baud: int = 57600,
        settings: Settings | None = None,
        *,
        streaming: bool = False,
        labelled: bool = True,
        line_end: bytes = b"\n\r",
        oscillator: float = 1.0,
    ) -> None:
        self.uart = Uart(baud)
        self.settings = settings or Settings()
        self.skipped = 0  # samples for which the line had no room
        self._signal, self._errors, self._oscillator = signal, errors, oscillator
        self._labelled, self._line_end = labelled, line_end
        self._streams_at_boot = streaming
        self._next = 0  # sample
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """Boot; the settings survive."""
        self.uart.clear()
        self._key: Callable[[str, float], None] | None = None  # handles the next byte; None while streaming
        self._start = math.inf
        self._lines: list[bytes] = []
        self._boots_at = t + _BOOT_S

    def receive(self, data: bytes, t: float) -> None:
        """Process bytes from the host: each is a key. While the board prints it ignores them."""
        self.advance(t)
        for byte in data:
            if self._key is not None and self.uart.backlog(t) <= 0.0:
                self._key(chr(byte).lower(), t)
            elif self.streaming:
                _log.info("stopped by a byte")
                self._menu(t)

    def advance(self, t: float) -> None:
        """Send all that was due until time `t`."""
        if t >= self._boots_at:
            boot, now = self._stream if self._streams_at_boot else self._menu, self._boots_at
            self._boots_at = math.inf
            boot(now)
        while self._due() <= t:
            due = self._due()
            line = self._line()
            self._lines.pop()
            self._next += 1
            if self.uart.backlog(due) > len(line):
                self.skipped += 1
            else:
                self.uart.send(line, due)

    def deadline(self) -> float:
        if self._boots_at < math.inf:
            return self._boots_at
        due = self._due()
        return self.uart.earliest(due, len(self._line())) if due < math.inf else due

    def prepare(self) -> None:
        if self.streaming and not self._lines:
            self._compute()

    @property
    def streaming(self) -> bool:
        """Whether it sends lines by itself."""
        return self._start < math.inf

    def _due(self) -> float:
        t = self._start + self._next / (self.settings.rate_hz * self._oscillator)
        return t if t <= self._signal.end else math.inf

    def _stream(self, t: float) -> None:
        self._limit_rate()
        self._key, self._start, self._next, self._lines = None, t + _START_S, 0, []
        _log.info("streaming %s values, %g/s", self.settings.mode, self.settings.rate_hz)

    def _line(self) -> bytes:
        """The next line, without consuming it."""
        if not self._lines:
            self._compute()
        return self._lines[-1]

    def _compute(self) -> None:
        """The block of lines from the next sample on, last line first."""
        times = self._start + np.arange(self._next, self._next + _BLOCK) / (self.settings.rate_hz * self._oscillator)
        force = self._errors.measure(self._signal, times)[:, 3:]
        volts = np.clip(MV_PER_G[self.settings.range_g] * force * _BOARD, -_SWING_MV, _SWING_MV) + _ZERO_G_MV
        counts = np.rint(volts * (_FULL_COUNT / _SUPPLY_MV)).astype(int)
        self._lines = [self._format(*row) for row in counts[::-1].tolist()]

    def _format(self, x: int, y: int, z: int) -> bytes:
        if self.settings.mode == "binary":
            return b"#" + b"".join(count.to_bytes(2, "big") for count in (x, y, z)) + b"$"
        if self.settings.mode == "raw":
            return b"%04d\t%04d\t%04d" % (x, y, z) + self._line_end
        swing = MV_PER_G[self.settings.range_g]
        g = tuple((count * _SUPPLY_MV // _FULL_COUNT - _ZERO_G_MV) / swing for count in (x, y, z))
        form = b"X=% .3f Y=% .3f Z=% .3f" if self._labelled else b"% .2f\t% .2f\t% .2f"
        return form % g + self._line_end

    def _print(self, text: str, t: float) -> None:
        self.uart.send(text.replace("\n", "\n\r").encode("ascii"), t)

    def _menu(self, t: float) -> None:
        s = self.settings
        self._start, self._lines = math.inf, []
        if self._limit_rate():
            self._print(f"\nOutput frequency lowered to {s.rate_hz:g} Hz\n", t)
        self._print(
            "\nSparkFun Serial Accelerometer V5\n"
            "[1] Calibrate\n"
            f"[2] Output mode: {s.mode} values\n"
            f"[3] Output frequency: {s.rate_hz:g} Hz\n"
            f"[4] Sensor range: +/- {s.range_g:g} g\n"
            f"[5] Baud rate: {self.uart.baud}\n"
            "[x] Exit\n"
            "Selection: ",
            t,
        )
        self._key = self._choose

    def _limit_rate(self) -> bool:
        """Limit the rate to that of mode and line; whether it was lowered."""
        line_bytes = {"gravity": 28, "raw": 16, "binary": 8}[self.settings.mode]
        rate_max = min(RATE_MAX_HZ[self.settings.mode], math.floor(_WIRE_SHARE * self.uart.baud / BITS / line_bytes))
        lower = self.settings.rate_hz > rate_max
        self.settings.rate_hz = min(self.settings.rate_hz, rate_max)
        return lower

    def _choose(self, key: str, t: float) -> None:
        if key == "x":
            self._print("x\n\n", t)
            self._stream(t)
            return
        choices: dict[str, tuple[str, Callable[[str, float], None]]] = {
            "1": ("Hold each axis up, then down, and press a key (x to exit)", lambda _, t: self._menu(t)),
            "2": ("Select the output mode: [1] gravity [2] raw [3] binary", self._choose_mode),
            "3": ("[i] raises, [d] lowers the output frequency, [x] exits", self._change_rate),
            "4": ("Select the sensor range: [1] 1.5 g [2] 2 g [3] 4 g [4] 6 g", self._choose_range),
            "5": ("Select the baud rate: [1] 9600 [2] 19200 [3] 38400 [4] 57600", self._choose_baud),
        }
        if key in choices:
            text, self._key = choices[key]
            self._print(f"{key}\n{text}\n", t)
        else:
            self._print("\nInvalid selection!\n", t)
            self._menu(t)

    def _choose_mode(self, key: str, t: float) -> None:
        self.settings.mode = dict(zip("123", MODES, strict=True)).get(key, self.settings.mode)
        self._menu(t)

    def _change_rate(self, key: str, t: float) -> None:
        if key == "x":
            self._menu(t)
            return
        self.settings.rate_hz = max(1.0, self.settings.rate_hz + {"i": 1.0, "d": -1.0}.get(key, 0.0))
        self._print(f"Output frequency: {self.settings.rate_hz:3g}\r", t)

    def _choose_range(self, key: str, t: float) -> None:
        self.settings.range_g = dict(zip("1234", MV_PER_G, strict=True)).get(key, self.settings.range_g)
        self._menu(t)

    def _choose_baud(self, key: str, t: float) -> None:
        baud = dict(zip("1234", BAUDS, strict=True)).get(key, self.uart.baud)
        self.uart.baud = baud
        self._menu(t)
