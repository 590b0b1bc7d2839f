"""San Jose FV-M11 (MTK-3301): the receiver's reports and their times, and its PMTK commands.

First boot text; then epochs without a position by an arbitrary clock; one epoch with a position of quality 0; fixes.
Order within an epoch: GGA, GSA, GSV, RMC, PMTKCHN, VTG last. Facts: docs/protocols.md §4, from a real power-up log.
"""

import logging
import math
from collections.abc import Callable, Iterator

from . import sentences
from .fixes import COMPUTE_S, Fix, FixSource
from .sentences import Epoch, with_checksum
from .uart import BITS, Uart

BAUDS = (4800, 9600, 19200, 38400, 57600, 115200)
INTERVAL_S = (0.2, 1.0)  # 1 to 5 fixes a second
_BOOT_S = 0.1
_BOOT = (
    with_checksum("PMTK010,001") + b"$POLYN,TIME,RESTART_OCCURRED\r\n$POLYN,EPH,0,00000000\r\n$POLYN,ALM,0,00000000\r\n"
)
_RTC = 315532800.0 + 4 * 86400.0 + 86386.005  # 5 January 1980, 23:59:46.005: the clock before the first fix
_BUFFER = 2048  # bytes; a sentence without room is lost

# in order of appearance: formatter, index in PMTK314, default divider (0 is off)
_TABLE: list[tuple[Callable[[Epoch], list[str]], int, int]] = [
    (sentences.gga, 3, 1),
    (sentences.gsa, 4, 5),
    (sentences.gsv, 5, 5),
    (sentences.rmc, 1, 1),
    (sentences.channels, 18, 0),
    (sentences.vtg, 2, 1),
]
_INVALID, _UNSUPPORTED, _FAILED, _DONE = 0, 1, 2, 3  # flags of PMTK001

_log = logging.getLogger("firmware_sim.nmea")


class FvM11:
    """One receiver, switched on at time 0.

    utc: UTC of time 0 in s since 1970. no_fix_s: how long it searches. periods: the commands that set the fix interval
    (PMTK220 is not proven for this receiver: leave it out to emulate one without).
    """

    def __init__(
        self,
        source: FixSource,
        utc: float,
        baud: int = 9600,
        rate_hz: float = 1.0,
        no_fix_s: float = 2.5,
        periods: tuple[int, ...] = (220, 300),
    ) -> None:
        self.uart = Uart(baud)
        self.lost = 0  # sentences
        self._source, self._utc, self._no_fix_s, self._periods = source, utc, no_fix_s, periods
        self._default_baud = baud
        self._default_interval = 1.0 / rate_hz
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """Boot with the default settings, and search again."""
        self.uart.clear()
        self.uart.baud, self._interval = self._default_baud, self._default_interval
        self._dividers = self._defaults()
        self._line = bytearray()
        self._epochs = 0
        self._schedule = self._reports_since(t)
        self._next = next(self._schedule, None)

    def receive(self, data: bytes, t: float) -> None:
        """Take in bytes from the host: lines of NMEA."""
        self.advance(t)
        for byte in data:
            if byte == ord("$"):
                self._line.clear()
            self._line.append(byte)
            if byte == ord("\n"):
                self._execute(bytes(self._line).strip(), t)
                self._line.clear()
        del self._line[:-300]

    def advance(self, t: float) -> None:
        """Send all reports that were due until time `t`."""
        while self._next is not None and self._next[0] <= t:
            due, report = self._next
            if isinstance(report, Epoch):
                self._report(report, due)
            else:
                self.uart.send(report, due)
            self._next = next(self._schedule, None)

    def deadline(self) -> float:
        return math.inf if self._next is None else self.uart.earliest(self._next[0], 1)

    def prepare(self) -> None:
        """Nothing to compute ahead: a fix is little work."""

    @staticmethod
    def _defaults() -> dict[int, int]:
        return {index: divider for _, index, divider in _TABLE}

    def _reports_since(self, on: float) -> Iterator[tuple[float, bytes | Epoch]]:
        """Switched on at time `on`."""
        yield on + _BOOT_S, _BOOT
        t = on + 3.0 * _BOOT_S
        while t < on + self._no_fix_s:
            yield t, Epoch(_RTC + t - on, None, False)
            t += self._interval
        last = max(on + self._no_fix_s, t - self._interval)
        fix = self._fix(last)
        if fix is not None and self._no_fix_s > 0.0:
            early = (last + fix.t) / 2.0  # between epochs: the clock jumps to UTC but is not steered yet
            yield min(early + COMPUTE_S, fix.arrival), Epoch(self._utc + early, fix, False)
            _log.info("fix")
        while fix is not None:
            yield fix.arrival, Epoch(self._utc + fix.t, fix if fix.valid else None, fix.valid)
            fix = self._fix(fix.t)
        _log.info("end of the recording: silent")

    def _fix(self, t: float) -> Fix | None:
        return self._source.after(t, self._interval)

    def _report(self, epoch: Epoch, t: float) -> None:
        self._epochs += 1
        for form, index, _ in _TABLE:
            divider = self._dividers[index]
            if not divider or self._epochs % divider:
                continue
            for body in form(epoch):
                if self.uart.backlog(t) > _BUFFER:
                    self._count_lost()
                else:
                    self.uart.send(with_checksum(body), t)
        for body in sentences.hdt(epoch):
            self.uart.send(with_checksum(body), t)

    def _count_lost(self) -> None:
        if not self.lost:
            _log.warning("%d baud is too slow for these sentences: some are lost", self.uart.baud)
        self.lost += 1

    def _execute(self, line: bytes, t: float) -> None:
        body, _, _ = line.decode("ascii", "ignore").partition("*")
        if not body.startswith("$PMTK") or with_checksum(body[1:]).strip() != line.upper():
            return
        number, *values = body[5:].split(",")
        try:
            command, numbers = int(number), [int(value) for value in values]
        except ValueError:
            return
        flag = self._command(command, numbers)
        arrived = t + len(line) * BITS / self.uart.baud
        self.uart.send(with_checksum(f"PMTK001,{command:03d},{flag}"), arrived)
        if command == 251 and flag == _DONE:
            self.uart.baud = numbers[0] or self._default_baud  # after the answer, which is queued at the old speed
            _log.info("baud %d", self.uart.baud)

    def _command(self, command: int, values: list[int]) -> int:
        if command == 0:
            return _DONE
        if command in self._periods:
            return self._set_interval(values)
        if command == 314:
            return self._set_dividers(values)
        if command == 251:
            return _DONE if len(values) == 1 and values[0] in (0, *BAUDS) else _FAILED
        return _UNSUPPORTED

    def _set_interval(self, values: list[int]) -> int:
        if not values or not INTERVAL_S[0] <= values[0] / 1000.0 <= INTERVAL_S[1]:
            return _FAILED
        self._interval = values[0] / 1000.0
        return _DONE

    def _set_dividers(self, values: list[int]) -> int:
        if values == [-1]:
            self._dividers = self._defaults()
        elif len(values) == 19 and all(0 <= value <= 5 for value in values):
            self._dividers = {index: values[index] for index in self._dividers}
        else:
            return _FAILED
        return _DONE
