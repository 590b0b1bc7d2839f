"""The common part of Epson's inertial sensors, from the device's side: registers, modes, sampling, resets; its UART.

A model adds its register map and the words of its frames. Where sources say nothing the emulator behaves in the most
difficult plausible way for the host: a command that is not exactly two bytes and CR is ignored, and so is every
command but the NOT_READY poll during start-up.
"""

import abc
import logging
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from .noise import ImuErrors, SampledSignal, Signal
from .sampling import TICK_HZ, RowSampler, Sampler, Words
from .uart import BITS, Uart

START_UP_S = 0.8  # NOT_READY after power-on and soft reset
_STALL_S = 25e-6  # from the end of a command to its answer
_CR = 0x0D
_ALL_NEW = 0xFE00  # FLAG b15-9: temperature, gyro x y z, accelerometer x y z
_MODE_STAT, _NOT_READY, _SELF_TEST = 0x0400, 0x0400, 0x0400  # b10 of MODE_CTRL, GLOB_CMD, MSC_CTRL
_DRDY_HIGH = 0x0006  # of MSC_CTRL: that line is on, and high when a sample is there
_UART_OVERRUN = 0x0008  # of DIAG_STAT

Key = tuple[int, int]  # window, and address of the low byte

BINARY_RATES = {code: 1 << code for code in range(1, 8)}  # rate code -> ticks per sample: 1000 to 15.625 /s

_log = logging.getLogger("firmware_sim.epson")


def _not_wired(_t: float) -> None:
    """The line is not wired."""


@dataclass(frozen=True)
class Map:
    """The registers of a dialect."""

    flag: Key
    data: tuple[Key, ...]  # temperature, gyros, accelerometers: their high words
    gpio: Key
    count: Key
    burst: Key
    signal: Key  # SIG_CTRL
    test: Key  # MSC_CTRL
    rate: Key  # SMPL_CTRL
    filter: Key
    mode: Key
    uart: Key
    diagnosis: Key
    command: Key  # GLOB_CMD
    reset: dict[Key, tuple[int, int]]  # value after reset, bits that a write stores
    window: int | None = None  # address of WIN_CTRL, if there are windows
    rates: dict[int, int] = field(default_factory=lambda: dict(BINARY_RATES))


class EpsonSensor(abc.ABC):
    """One unit, switched on at time 0. Models say what `_fields` there are in their frames."""

    map: Map
    header: int

    def __init__(
        self,
        signal: Signal,
        errors: ImuErrors,
        baud: int,
        words: Words,
        taps: dict[int, int],
        names: dict[Key, bytes],
        self_test_s: float,
        count_step: int | None,
        oscillator: float,
    ) -> None:
        """count_step: COUNT per output sample; None: it counts the internal 2 kHz ticks. names: texts to read.

        oscillator: speed of the device's clock against true time.
        """
        self.uart = Uart(baud)
        self._signal, self._errors, self._oscillator = signal, errors, oscillator
        self._words, self._taps, self._names, self._self_test_s = words, taps, names, self_test_s
        self._count_step = count_step
        self._sampler: Sampler | RowSampler | None = None
        self._count = self._step = 0
        self.on_data_ready: Callable[[float], None] = _not_wired  # called when that line rises
        self.restart(0.0)

    def receive(self, data: bytes, t: float) -> None:
        """Take in bytes from the host; CR ends a command."""
        self.advance(t)
        for byte in data:
            if byte != _CR:
                self._command.append(byte)
                continue
            if len(self._command) == 2:
                self._execute(self._command[0], self._command[1], t)
            self._command.clear()
        del self._command[3:]  # too long already, however long it becomes

    def advance(self, t: float) -> None:
        """Sample, and in auto mode send, all that was due until time `t`."""
        while self._sampler is not None and self._sampler.next_time <= t:
            due = self._sampler.next_time
            self._sample = self._sampler.row()
            self._count = (self._count + self._step) & 0xFFFF
            self._fresh = _ALL_NEW & self._word[self.map.signal]
            if self._word[self.map.test] & _DRDY_HIGH == _DRDY_HIGH:
                self.on_data_ready(due)  # low since it was read, or for a moment before
            if not self.streaming:
                continue
            if self.uart.backlog(due) > self._frame_size:
                self._word[self.map.diagnosis] |= _UART_OVERRUN
            else:
                self.uart.send(self._frame(), due)

    @property
    def next_sample(self) -> float:
        """Time of the next sample; infinite while the sensor does not sample."""
        return math.inf if self._sampler is None else self._sampler.next_time

    def deadline(self) -> float:
        if self._sampler is None or not self.streaming:
            return math.inf
        return self.uart.earliest(self._sampler.next_time, self._frame_size)

    def prepare(self) -> None:
        if self._sampler is not None:
            self._sampler.prepare()

    def restart(self, t: float) -> None:
        self.uart.clear()
        self._word = {key: value for key, (value, _) in self.map.reset.items()}
        for (window, address), text in self._names.items():  # the first character is the low byte
            for i in range(0, len(text), 2):
                self._word[window, address + i] = text[i] | text[i + 1] << 8
        self._window = 0
        self._command = bytearray()
        self._sampler = None
        self._sample = bytes(7 * self._words.size)
        self._fresh = 0  # FLAG bits of data not yet read
        self._count = self._step = 0
        self._ready_at = t + START_UP_S
        self._tested_at = t

    def jump_count(self, by: int) -> None:
        """COUNT misses so many."""
        self._count = (self._count + by) & 0xFFFF

    @abc.abstractmethod
    def _fields(self) -> bytes:
        """What stands between header and CR."""

    @property
    def streaming(self) -> bool:
        """Whether the sensor sends samples on the UART by itself; then no register can be read."""
        return self._sampler is not None and bool(self._word[self.map.uart] & 1)

    def _frame(self) -> bytes:
        return bytes((self.header,)) + self.burst() + b"\r"

    @property
    def _frame_size(self) -> int:
        return len(self._fields()) + 2

    @property
    def _flag(self) -> int:
        return self._fresh | (self._word[self.map.diagnosis] != 0)

    def _value(self, index: int) -> bytes:
        """Of the last sample: temperature, gyro x y z, accelerometer x y z."""
        size = self._words.size
        return self._sample[index * size : (index + 1) * size]

    def accepts(self, address: int, t: float) -> bool:
        """Whether a command is accepted: during start-up all but the NOT_READY poll are ignored."""
        return t >= self._ready_at or address & 0x7F in (self.map.command[1], self.map.window)

    def is_burst(self, address: int, value: int) -> bool:
        """Whether a command asks for all data at once."""
        return (self._window, address) == self.map.burst and value == 0

    def burst(self) -> bytes:
        """All data, high bytes first."""
        fields = self._fields()
        self._fresh = 0
        return fields

    def _execute(self, address: int, value: int, t: float) -> None:
        if not self.accepts(address, t):
            return
        line = 3 * BITS / self.uart.baud  # the command itself was on the line
        if self.is_burst(address, value):
            if not self.streaming:
                self.uart.send(self._frame(), t + line + _STALL_S)
        elif address & 0x80:
            self.write(address & 0x7F, value, t)
        elif not self.streaming:
            word = self.read(address & 0x7E, t)
            self.uart.send(struct.pack(">BHB", address & 0x7E, word, _CR), t + line + _STALL_S)

    def read(self, address: int, t: float) -> int:
        """The word of a register in the window that is open."""
        key = self._window, address
        if key in self.map.data:
            index = self.map.data.index(key)
            self._fresh &= ~(0x8000 >> index)
            return int.from_bytes(self._value(index)[:2])
        value = self._word.get(key, 0)
        if key == self.map.diagnosis:
            self._word[key] = 0  # cleared by reading
        busy: dict[Key, int] = {
            self.map.test: _SELF_TEST if t < self._tested_at else 0,
            self.map.mode: _MODE_STAT if self._sampler is None else 0,
            self.map.command: _NOT_READY if t < self._ready_at else 0,
        }
        live: dict[Key, int] = {self.map.flag: self._flag, self.map.count: self._count}
        return live.get(key, value | busy.get(key, 0))

    def write(self, address: int, value: int, t: float) -> None:
        """Write one byte of a register in the window that is open."""
        if address == self.map.window:
            self._window = value & 1
            return
        key, high = (self._window, address & 0x7E), bool(address & 1)
        always = ((self.map.mode, True), (self.map.gpio, True), (self.map.command, False))  # GPIO_DATA, SOFT_RST
        if self._sampler is not None and (key, high) not in always:
            return
        mask, shift = self.map.reset.get(key, (0, 0))[1], 8 * high
        mask &= 0xFF << shift
        if mask:
            self._word[key] = self._word[key] & ~mask | value << shift & mask
        if (key, high) == (self.map.mode, True):
            self._change_mode(value & 3, t)
        elif (key, high) == (self.map.test, True) and value & 4:
            self._tested_at = t + self._self_test_s
        elif (key, high) == (self.map.command, False) and value & 0x80:
            self.restart(t)
            _log.info("soft reset")

    def _change_mode(self, command: int, t: float) -> None:
        if command == 2 and self._sampler is not None:
            self._sampler = None
            _log.info("configuration mode")
        elif command == 1 and self._sampler is None:
            decimation = self.map.rates.get(self._word[self.map.rate] >> 8, 2)
            taps = self._taps.get(self._word[self.map.filter] & 0x1F, 2)
            self._step = decimation if self._count_step is None else self._count_step
            if isinstance(self._signal, SampledSignal):
                self._sampler = RowSampler(self._signal, self._errors, t, self._words)
            else:
                self._sampler = Sampler(self._signal, self._errors, t, decimation, taps, self._oscillator, self._words)
            self._sampler.prepare()
            _log.info("sampling %g/s, %d taps, %s", TICK_HZ / decimation, taps, "auto" if self.streaming else "polled")
