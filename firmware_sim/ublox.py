"""u-blox receivers: a ZED-F9P, which is set up by keys (CFG-VALSET), and a NEO-M8N, set up by CFG-MSG, -RATE and -PRT.

From the factory they send NMEA once a second. Messages of an epoch leave in a fixed order, NAV-EOE last; NMEA follows.
All settings are lost with the power. Source: u-blox F9 HPG 1.32 interface description, 3.9, 3.10, 3.14 and 6; u-blox
M8 receiver description, 32. Where these say nothing: an unknown key rejects its whole CFG-VALSET.
"""

import logging
import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import accumulate

from . import sentences
from . import ublox_frames as ubx
from .fixes import Fix, FixSource
from .sentences import Epoch, with_checksum
from .uart import BITS, Uart
from .ublox_frames import Report, frame

BAUDS = (4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
_BOOT_S = 0.2
_BUFFER = 4096  # bytes; a message without room is lost
_SYNC, _INPUT_MAX = b"\xb5\x62", 4096
_UART1 = 1
_RATE_MEAS, _RATE_NAV, _BAUDRATE, _OUT_UBX, _OUT_NMEA = 0x30210001, 0x30210002, 0x40520001, 0x10740001, 0x10740002
_KEY_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8}
_ACK, _NAK = 1, 0

Message = tuple[int, int]
_FORMS: dict[Message, Callable[[Report], bytes]] = {  # in order of appearance
    (0x01, 0x07): ubx.pvt,
    (0x01, 0x03): ubx.status,
    (0x01, 0x04): ubx.dop,
    (0x01, 0x21): ubx.time_utc,
    (0x01, 0x36): ubx.covariance,
    (0x01, 0x3C): ubx.relative,
    (0x01, 0x35): ubx.satellites,
    (0x27, 0x09): ubx.security,
    (0x0A, 0x09): ubx.hardware,
    (0x01, 0x61): ubx.end,
}
_KEYS: dict[int, Message] = {  # of the output on UART1
    0x20910007: (0x01, 0x07),
    0x2091001B: (0x01, 0x03),
    0x20910039: (0x01, 0x04),
    0x2091005C: (0x01, 0x21),
    0x20910084: (0x01, 0x36),
    0x2091008E: (0x01, 0x3C),
    0x20910016: (0x01, 0x35),
    0x20910635: (0x27, 0x09),
    0x20910160: (0x01, 0x61),
}
_SENTENCES: dict[Message, Callable[[Epoch], list[str]]] = {
    (0xF0, 0x04): sentences.rmc,
    (0xF0, 0x05): sentences.vtg,
    (0xF0, 0x00): sentences.gga,
    (0xF0, 0x02): sentences.gsa,
    (0xF0, 0x03): sentences.gsv,
}

_log = logging.getLogger("firmware_sim.ublox")


@dataclass(frozen=True)
class Model:
    """A row of the receivers. has: their messages; interval_ms: the shortest."""

    software: str
    hardware: str
    extensions: tuple[str, ...]
    keys: bool
    has: frozenset[Message]
    baud: int
    interval_ms: int


_EVERY = frozenset(_FORMS)
ZED_F9P = Model(
    "EXT CORE 1.00 (3fda8e)",
    "00190000",
    ("ROM BASE 0x118B2060", "FWVER=HPG 1.32", "PROTVER=27.31", "MOD=ZED-F9P", "GPS;GLO;GAL;BDS", "QZSS"),
    keys=True,
    has=_EVERY - {(0x0A, 0x09)},
    baud=38400,
    interval_ms=50,
)
NEO_M8N = Model(
    "EXT CORE 3.01 (107900)",
    "00080000",
    ("ROM BASE 2.01 (75331)", "FWVER=SPG 3.01", "PROTVER=18.00", "MOD=NEO-M8N-0", "FIS=0xEF4015 (100111)", "GPS;GLO"),
    keys=False,
    has=_EVERY - {(0x01, 0x36), (0x01, 0x3C), (0x27, 0x09)},
    baud=9600,
    interval_ms=100,
)


class Ublox:
    """One receiver on its UART1, switched on at time 0.

    utc: UTC of time 0 in s since 1970. no_fix_s: how long it searches. mixed: NAV-PVT was switched on beside NMEA.
    answers: else it ignores what it is sent.
    """

    def __init__(
        self,
        source: FixSource,
        utc: float,
        baud: int = 0,
        rate_hz: float = 1.0,
        no_fix_s: float = 2.5,
        model: Model = ZED_F9P,
        mixed: bool = False,
        answers: bool = True,
    ) -> None:
        self.uart = Uart(baud or model.baud)
        self.lost = 0  # messages
        self.jamming = self.spoofing = 1
        self._model, self._source, self._utc, self._no_fix_s = model, source, utc, no_fix_s
        self._baud, self._interval_ms, self._mixed, self._answers = self.uart.baud, round(1e3 / rate_hz), mixed, answers
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """Boot with the default settings, and search again."""
        self.uart.clear()
        self.uart.baud, self._interval = self._baud, self._interval_ms / 1e3
        self.rates: dict[Message, int] = {**dict.fromkeys(_FORMS, 0), **dict.fromkeys(_SENTENCES, 1)}
        if self._mixed:
            self.rates |= {(0x01, 0x07): 1, (0x01, 0x61): int((0x01, 0x61) in self._model.has)}
        self.ubx_out = self.nmea_out = True
        self._input = bytearray()
        self._epochs = 0
        self._schedule = self._reports_since(t)
        self._next = next(self._schedule, None)

    def receive(self, data: bytes, t: float) -> None:
        """Take in bytes from the host: frames, of which the last may be incomplete; other bytes are skipped."""
        self.advance(t)
        self._input += data
        del self._input[:-_INPUT_MAX]
        while (start := self._input.find(_SYNC)) >= 0:
            del self._input[:start]
            if len(self._input) < 8:
                return
            end = 8 + int.from_bytes(self._input[4:6], "little")
            if end > _INPUT_MAX:
                del self._input[:2]
            elif len(self._input) < end:
                return
            else:
                body, checksum = bytes(self._input[2 : end - 2]), bytes(self._input[end - 2 : end])
                whole = checksum == bytes((sum(body) & 255, sum(accumulate(body)) & 255))
                del self._input[: end if whole else 2]
                if whole and self._answers:
                    self._execute((body[0], body[1]), body[4:], t + end * BITS / self.uart.baud)

    def advance(self, t: float) -> None:
        """Send all reports that were due until time `t`."""
        while self._next is not None and self._next[0] <= t:
            due, utc, fix = self._next
            self._report(utc, fix, due)
            self._next = next(self._schedule, None)

    def deadline(self) -> float:
        return math.inf if self._next is None else self.uart.earliest(self._next[0], 1)

    def prepare(self) -> None:
        """Nothing to compute ahead: a fix is little work."""

    def _reports_since(self, on: float) -> Iterator[tuple[float, float, Fix | None]]:
        """Time of arrival, UTC and fix of each report, switched on at time `on`."""
        t = on + _BOOT_S
        while (fix := self._source.after(t, self._interval)) is not None:
            found = fix.valid and fix.t - on >= self._no_fix_s
            yield fix.arrival, self._utc + fix.t, fix if found else None
            t = fix.t
        _log.info("end of the recording: silent")

    def _report(self, utc: float, fix: Fix | None, t: float) -> None:
        self._epochs += 1
        report = Report(utc, fix, self.jamming, self.spoofing, fix.heading_deg if fix else None)
        epoch = Epoch(utc, fix, fix is not None)
        if self.ubx_out:
            for kind, form in _FORMS.items():
                if self._due(kind):
                    self._send(form(report), t)
        if self.nmea_out:
            for kind, sentence in _SENTENCES.items():
                for body in sentence(epoch) if self._due(kind) else ():
                    self._send(with_checksum(body), t)

    def _due(self, kind: Message) -> bool:
        return bool(self.rates[kind]) and self._epochs % self.rates[kind] == 0

    def _send(self, message: bytes, t: float) -> None:
        if self.uart.backlog(t) <= _BUFFER:
            self.uart.send(message, t)
            return
        if not self.lost:
            _log.warning("%d baud is too slow for these messages: some are lost", self.uart.baud)
        self.lost += 1

    def _execute(self, kind: Message, payload: bytes, t: float) -> None:
        if kind == (0x0A, 0x04) and not payload:
            self._send(frame(0x0A, 0x04, self._version()), t)
        elif kind[0] == 0x06:
            done = self._configure(kind, payload, t)
            if self.ubx_out:
                self.uart.send(frame(0x05, _ACK if done else _NAK, bytes(kind)), t)
            if done and self._new_baud:
                self.uart.baud = self._new_baud  # after the answer, which is queued at the old speed
                _log.info("baud %d", self.uart.baud)

    def _version(self) -> bytes:
        texts = [self._model.software.ljust(30, "\0"), self._model.hardware.ljust(10, "\0")]
        return "".join([*texts, *(text.ljust(30, "\0") for text in self._model.extensions)]).encode("ascii")

    def _configure(self, kind: Message, payload: bytes, t: float) -> bool:
        self._new_baud = 0
        if kind == (0x06, 0x8A):
            return self._model.keys and self._set_keys(payload)
        if kind == (0x06, 0x00) and not payload:
            mask = self.ubx_out | self.nmea_out << 1
            self._send(
                frame(0x06, 0x00, struct.pack("<BBHIIHHHH", _UART1, 0, 0, 0x8D0, self.uart.baud, 7, mask, 0, 0)), t
            )
            return True
        if kind == (0x06, 0x00) and len(payload) == 20 and payload[0] == _UART1:
            baud, _, mask = struct.unpack_from("<IHH", payload, 8)
            if baud not in BAUDS:
                return False
            self._new_baud, self.ubx_out, self.nmea_out = baud, bool(mask & 1), bool(mask & 2)
            return True
        if kind == (0x06, 0x01) and len(payload) == 3:
            return self._set_message((payload[0], payload[1]), payload[2])
        if kind == (0x06, 0x08) and len(payload) == 6:
            return self._set_interval(int.from_bytes(payload[:2], "little"))
        return False

    def _set_message(self, kind: Message, every: int) -> bool:
        if kind[0] == 0xF0 and kind[1] <= 0x0D:
            if kind in _SENTENCES:
                self.rates[kind] = every
            return True
        if kind not in self._model.has:
            return False
        self.rates[kind] = every
        return True

    def _set_interval(self, ms: int) -> bool:
        if ms < self._model.interval_ms:
            return False
        self._interval = ms / 1e3
        return True

    def _set_keys(self, payload: bytes) -> bool:
        """All keys of a CFG-VALSET, or none. Keys of ports to which nobody listens are taken without effect."""
        if len(payload) < 4 or payload[0] > 1 or not payload[1] & 1:
            return False
        pairs, at = [], 4
        while at < len(payload):
            key = int.from_bytes(payload[at : at + 4], "little")
            size = _KEY_BYTES.get(key >> 28 & 7, 0)
            if not size or at + 4 + size > len(payload):
                return False
            pairs.append((key, int.from_bytes(payload[at + 4 : at + 4 + size], "little")))
            at += 4 + size
        if not all(self._knows(*pair) for pair in pairs):
            return False
        for pair in pairs:
            self._set_key(*pair)
        return True

    def _knows(self, key: int, value: int) -> bool:
        if key == _RATE_MEAS:
            return value >= self._model.interval_ms
        if key == _BAUDRATE:
            return value in BAUDS
        ports = {key - shift for shift in (0, 1, 2)}  # UART1, UART2, USB
        return key in (_RATE_NAV, _OUT_UBX, _OUT_NMEA) or any(_KEYS.get(one) in self._model.has for one in ports)

    def _set_key(self, key: int, value: int) -> None:
        if key == _RATE_MEAS:
            self._interval = value / 1e3
        elif key == _BAUDRATE:
            self._new_baud = value
        elif key == _OUT_UBX:
            self.ubx_out = bool(value)
        elif key == _OUT_NMEA:
            self.nmea_out = bool(value)
        elif key in _KEYS:
            self.rates[_KEYS[key]] = value
