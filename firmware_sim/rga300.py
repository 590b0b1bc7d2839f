"""Crossbow DMU RGA300CA, the device's side: single-letter commands, angle-mode packets, timer, zeroing, baud rate.

Facts: Prasanna (2009) and a packet and host code of a real unit (docs/protocols.md §2). Where they say nothing the
emulator behaves in the most difficult plausible way for the host: it ignores input while it starts and while it zeroes,
streams meanwhile, and packets show the latest of its internal samples, so that their spacing varies.
"""

import logging
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .ellipsoid import Array
from .noise import DEG, MILLI_G, STANDARD_GRAVITY, Grade, ImuErrors, SampledSignal, Signal
from .uart import BITS, Uart

BAUDS = (9600, 19200, 38400, 57600, 115200)  # that "b" finds
PACKET = 24  # bytes
START_UP_S = 0.3
INTERNAL_S = 3.5e-3  # between its own samples
TIMER_S = 0.79e-6
PART_NUMBER, SERIAL, VERSION = 300, 30042, b"RGA300CA-100 REV C, 0.5"
_COUNT_UNIT = 100  # samples that a unit of the z command stands for
_TILT_S = 0.3  # time constant of the tilt angles
_ANSWER_S = 200e-6  # from a command to its answer
_LSB = np.array([150.0 * DEG, *[3.0 * STANDARD_GRAVITY] * 3]) / 32768.0  # yaw rate, accelerations x y z

# no figures of this model are published; these are of the order of the maker's AHRS400
RGA300 = Grade(
    random_walk=(2.25 * DEG / 60.0, 0.1 / 60.0),
    turn_on=(0.5 * DEG, 8.0 * MILLI_G),
    in_run=(0.02 * DEG, 0.5 * MILLI_G),
    scale=(0.01, 0.01),
    misalignment=(0.3 * DEG, 0.1 * DEG),
    limit=(100.0 * DEG, 2.0 * STANDARD_GRAVITY),
    warm_up_degc=6.0,
)

_log = logging.getLogger("firmware_sim.rga300")


@dataclass(frozen=True)
class Reading:
    """The content of one packet. gravity: as the unit sees it, +1 g on z when level (x y z, m/s^2)."""

    roll: float  # rad
    pitch: float
    yaw_rate: float  # rad/s
    gravity: tuple[float, float, float]
    timer: int  # word
    temperature: float  # degC
    bit: int = 0

    def packet(self) -> bytes:
        """The 24 bytes."""
        angles = [_wrapped(angle / math.pi * 32768.0) for angle in (self.roll, self.pitch)]
        rates = np.clip(np.rint(np.array([self.yaw_rate, *self.gravity]) / _LSB), -32768, 32767)
        volts = self.temperature / 44.44 + 1.375
        unsigned = (self.timer, round(volts * 4096.0 / 5.0), PART_NUMBER, self.bit)
        body = struct.pack(">6h4H", *angles, *(int(value) for value in rates), *unsigned)
        return b"\xaa\x55" + body + struct.pack(">H", sum(body) % 0xFFFF)


def _wrapped(lsb: float) -> int:
    return (round(lsb) + 0x8000) % 0x10000 - 0x8000


class AutobaudUart(Uart):
    """A UART that, while `searching`, changes to the baud rate at which it receives an "a"."""

    searching = False

    def receive_from(self, data: bytes, talker_baud: int) -> bytes:
        if self.searching and b"a" in data and talker_baud in BAUDS:
            self.baud = talker_baud
        return super().receive_from(data, talker_baud)


class Rga300:
    """One unit, switched on at time 0, polled."""

    def __init__(
        self, signal: Signal, errors: ImuErrors, baud: int = 38400, *, rate_hz: float = 100.0, oscillator: float = 1.0
    ) -> None:
        """rate_hz: packets per second in continuous mode, at most 160 (38400 baud). oscillator: speed of its clock."""
        self._line = AutobaudUart(baud)
        self.uart: Uart = self._line
        self.bit = 0
        self._signal, self._errors = signal, errors
        self._period, self._internal = 1.0 / (rate_hz * oscillator), INTERNAL_S / oscillator
        self._oscillator = oscillator
        self._default_baud = baud
        self._count = 0  # ticks that the timer word is ahead
        self.restart(0.0)
        self._commands: dict[int, Callable[[float], None]] = {
            ord("R"): lambda t: self._answer(b"H", t),
            ord("P"): lambda _: self._stop(),
            ord("C"): self._start,
            ord("G"): self._poll,
            ord("S"): lambda t: self._answer(_with_byte_sum(struct.pack(">I", SERIAL)), t),
            ord("v"): lambda t: self._answer(b"\xff" + VERSION + b"$", t),
            ord("b"): self._search_baud,
        }

    def restart(self, t: float) -> None:
        """Start up: polled, at the default speed, without a gyro zero."""
        self.uart.clear()
        self.uart.baud, self._line.searching = self._default_baud, False
        self._ready_at = t + START_UP_S
        self._next = math.inf  # when the next packet of a stream is due
        self._ahead: Reading | None = None  # computed for that time
        self._zeroing: tuple[float, float] | None = None  # begin and end
        self._expects_count = False  # the byte after z
        self._zero = 0.0  # of the gyro, rad/s
        self._gravity: Array | None = None  # averaged
        self._averaged_at = t

    def receive(self, data: bytes, t: float) -> None:
        """Take in bytes from the host."""
        self.advance(t)
        for byte in data:
            if t < self._ready_at or self._zeroing is not None:
                continue
            if self._expects_count:
                self._begin_zeroing(byte, t)
            elif self._line.searching:
                self._find_baud(byte, t)
            elif byte == ord("z"):
                self._expects_count = True
            elif byte in self._commands:
                self._commands[byte](t)

    def advance(self, t: float) -> None:
        """Send what was due until time `t`."""
        if self._zeroing is not None and self._zeroing[1] <= t:
            self._end_zeroing(*self._zeroing)
        while self._next <= t:
            due, reading = self._next, self._ahead or self._read(self._next)
            self._ahead = None
            self._next = self._next_after(due)
            if self.uart.backlog(due) <= PACKET:
                self.uart.send(reading.packet(), due)

    def deadline(self) -> float:
        zeroed = self._zeroing[1] if self._zeroing else math.inf
        return min(zeroed, self.uart.earliest(self._next, PACKET))

    def jump_count(self, by: int) -> None:
        """The timer misses so many ticks."""
        self._count += by
        self._ahead = None

    def prepare(self) -> None:
        if self._ahead is None and self._next < math.inf:
            self._ahead = self._read(self._next)

    def _answer(self, reply: bytes, t: float) -> None:
        self.uart.send(reply, t + BITS / self.uart.baud + _ANSWER_S)

    @property
    def streaming(self) -> bool:
        """Whether it sends packets by itself."""
        return self._next < math.inf

    def _next_after(self, t: float) -> float:
        if isinstance(self._signal, SampledSignal):
            return self._signal.after(t)
        after = t + self._period
        return after if after <= self._signal.end else math.inf

    def _start(self, t: float) -> None:
        if self._next == math.inf:
            self._next = self._next_after(t)
            _log.info("continuous, %g/s", 1.0 / self._period)

    def _stop(self) -> None:
        if self._next < math.inf:
            self._next, self._ahead = math.inf, None
            _log.info("polled")

    def _poll(self, t: float) -> None:
        self._stop()
        self._answer(self._read(t).packet(), t)

    def _search_baud(self, t: float) -> None:
        self._stop()
        self._answer(b"B", t)
        self._line.searching = True

    def _find_baud(self, byte: int, t: float) -> None:
        self._line.searching = False
        if byte == ord("a"):
            self._answer(b"A", t)
            _log.info("%d baud", self.uart.baud)

    def _begin_zeroing(self, count: int, t: float) -> None:
        self._expects_count = False
        self._zeroing = t, t + count * _COUNT_UNIT * self._internal

    def _end_zeroing(self, begin: float, end: float) -> None:
        self._zeroing, self._zero = None, 0.0
        if end > begin:
            self._zero = float(self._errors.measure(self._signal, np.linspace(begin, end, _COUNT_UNIT))[:, 2].mean())
        self._answer(b"Z", end)
        _log.info("gyro zero %.3f deg/s", self._zero / DEG)

    def _read(self, t: float) -> Reading:
        """The latest internal sample at time `t`."""
        recorded = isinstance(self._signal, SampledSignal)
        sampled = t if recorded else math.floor(t / self._internal) * self._internal
        row = self._errors.measure(self._signal, np.array([sampled]))[0]
        gravity = -row[3:]
        x, y, z = self._average(gravity, sampled).tolist()
        return Reading(
            roll=math.atan2(y, z),
            pitch=math.atan2(-x, math.hypot(y, z)),
            yaw_rate=float(row[2]) - self._zero,
            gravity=tuple(gravity.tolist()),
            timer=-(math.floor(sampled * self._oscillator / TIMER_S) + self._count) & 0xFFFF,
            temperature=self._errors.temperature(t),
            bit=self.bit,
        )

    def _average(self, gravity: Array, t: float) -> Array:
        if self._gravity is None:
            self._gravity = gravity
        weight = -math.expm1(-max(0.0, t - self._averaged_at) / _TILT_S)
        self._gravity = self._gravity + weight * (gravity - self._gravity)
        self._averaged_at = t
        return self._gravity


def _with_byte_sum(data: bytes) -> bytes:
    return b"\xff" + data + bytes([sum(data) & 0xFF])
