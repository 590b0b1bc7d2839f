"""Epson M-G350-PD11, the device's side of its UART: flat registers, modes, commands, burst and auto frames.

Facts: the data sheet's scale factors; registers and commands as public host code drives them (design/protocols.md §1).
Where sources are silent the emulator does what is hardest on the host but still plausible, or offers a choice: a
command that is not exactly two bytes and CR is ignored, and so is everything but the NOT_READY poll during start-up.
"""

import logging
import math
import struct

from .noise import ImuErrors
from .sampling import TICK_HZ, Sampler, Signal
from .uart import BITS, Uart

START_UP_S = 0.8  # NOT_READY after power-on and soft reset
_SELF_TEST_S = 0.08
_STALL_S = 25e-6  # from the end of a command to its answer
_CR = 0x0D

FLAG, TEMP_OUT, ACCL_Z, GPIO, COUNT, BURST = 0x00, 0x02, 0x0E, 0x10, 0x12, 0x20
SIG_CTRL, MSC_CTRL, SMPL_CTRL, MODE_CTRL, UART_CTRL = 0x32, 0x34, 0x36, 0x38, 0x3A
DIAG_STAT, GLOB_CMD, COUNT_CTRL, PROD_ID, VERSION, SERIAL = 0x3C, 0x3E, 0x50, 0x6A, 0x72, 0x74

# word address -> (value after reset, bits that a write stores)
_REGISTERS = {
    GPIO: (0x0200, 0x0707),  # DATA b10-8, DIR b2-0
    SIG_CTRL: (0xFE00, 0xFE00),  # new-data flags enabled
    MSC_CTRL: (0x0006, 0x00E6),  # DRDY on, active high; EXT_SEL, EXT_POL
    SMPL_CTRL: (0x0100, 0x0F00),  # rate code
    MODE_CTRL: (0x0001, 0x00FF),  # filter code
    UART_CTRL: (0x0000, 0x0003),  # UART_AUTO b0, AUTO_START b1
    DIAG_STAT: (0x0000, 0x0000),
    COUNT_CTRL: (0x0000, 0x0001),  # COUNT in frames
}
_WRITABLE_WHILE_SAMPLING = (MODE_CTRL + 1, GPIO + 1, GLOB_CMD)  # MODE_CMD, GPIO_DATA, SOFT_RST
_ALL_NEW = 0xFE00  # FLAG b15-9: temperature, gyro x y z, accelerometer x y z
_MODE_STAT, _NOT_READY, _SELF_TEST = 0x0400, 0x0400, 0x0400  # b10 of MODE_CTRL, GLOB_CMD, MSC_CTRL
_UART_OVERRUN = 0x0008  # of DIAG_STAT

DECIMATION = {1: 2, 2: 4, 3: 8, 4: 16, 5: 32, 6: 64, 7: 128}  # rate code -> ticks per sample: 1000 to 15.625 /s
TAPS_G350 = {1: 2, 2: 4, 3: 8, 4: 16, 5: 32, 6: 64, 7: 128}  # filter code -> taps
TAPS_V340 = {2: 1, 3: 2, 4: 4, 5: 8, 6: 16, 7: 32}  # the sibling's table, should a unit have that one

_log = logging.getLogger("firmware_sim.g350")


class G350:
    """One unit, switched on at time 0."""

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
        """count_step: COUNT per output sample; None: it counts the internal 2 kHz ticks, as the siblings' does.

        identity: whether product name, version and serial number are there to read.
        oscillator: speed of the device's clock against true time.
        """
        self.uart = Uart(baud)
        self._signal, self._errors, self._oscillator = signal, errors, oscillator
        self._count_step, self._identity, self._taps = count_step, identity, taps
        self._sampler: Sampler | None = None
        self._count = self._step = 0
        self._reset(0.0)

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
            self._fresh = _ALL_NEW & self._word[SIG_CTRL]
            if not self._auto:
                continue
            if self.uart.backlog(due) > self._frame_size:
                self._word[DIAG_STAT] |= _UART_OVERRUN
            else:
                self.uart.send(self._frame(), due)

    def deadline(self) -> float:
        if self._sampler is None or not self._auto:
            return math.inf
        return self.uart.earliest(self._sampler.next_time, self._frame_size)

    def prepare(self) -> None:
        if self._sampler is not None:
            self._sampler.prepare()

    @property
    def _auto(self) -> bool:
        return self._sampler is not None and bool(self._word[UART_CTRL] & 1)

    @property
    def _frame_size(self) -> int:
        return 22 if self._word[COUNT_CTRL] & 1 else 20

    def _reset(self, t: float) -> None:
        self.uart.clear()
        self._word = {address: reset for address, (reset, _) in _REGISTERS.items()}
        if self._identity:
            names = [(PROD_ID, b"G350PD11"), (VERSION, b"\x13\x00"), (SERIAL, b"S0000042")]
            for address, text in names:  # low byte first: the first character is the low byte
                for i in range(0, len(text), 2):
                    self._word[address + i] = text[i] | text[i + 1] << 8
        self._command = bytearray()
        self._sampler = None
        self._sample = bytes(14)
        self._fresh = 0  # FLAG bits of data not yet read
        self._count = self._step = 0
        self._ready_at = t + START_UP_S
        self._tested_at = t

    def _execute(self, address: int, value: int, t: float) -> None:
        if t < self._ready_at and address != GLOB_CMD:
            return
        if address & 0x80:
            self._write(address & 0x7F, value, t)
        elif not self._auto:
            line = 3 * BITS / self.uart.baud  # the command itself was on the line
            self.uart.send(self._answer(address, value, t), t + line + _STALL_S)

    def _answer(self, address: int, value: int, t: float) -> bytes:
        if address == BURST and value == 0:
            return self._frame()
        address &= 0x7E
        return struct.pack(">BHB", address, self._read(address, t), _CR)

    def _frame(self) -> bytes:
        count = struct.pack(">H", self._count) if self._word[COUNT_CTRL] & 1 else b""
        head = struct.pack(">BH", BURST, self._flag())
        self._fresh = 0
        return head + self._sample + struct.pack(">H", self._word[GPIO]) + count + b"\r"

    def _flag(self) -> int:
        return self._fresh | (self._word[DIAG_STAT] != 0)

    def _read(self, address: int, t: float) -> int:
        if TEMP_OUT <= address <= ACCL_Z:
            self._fresh &= ~(0x8000 >> (address - TEMP_OUT) // 2)
            return int.from_bytes(self._sample[address - TEMP_OUT : address - TEMP_OUT + 2], "big")
        value = self._word.get(address, 0)
        if address == DIAG_STAT:
            self._word[DIAG_STAT] = 0  # cleared by reading
        busy: dict[int, int] = {
            MSC_CTRL: _SELF_TEST if t < self._tested_at else 0,
            MODE_CTRL: _MODE_STAT if self._sampler is None else 0,
            GLOB_CMD: _NOT_READY if t < self._ready_at else 0,
        }
        live: dict[int, int] = {FLAG: self._flag(), COUNT: self._count}
        return live.get(address, value | busy.get(address, 0))

    def _write(self, address: int, value: int, t: float) -> None:
        if self._sampler is not None and address not in _WRITABLE_WHILE_SAMPLING:
            return
        word, shift = address & 0x7E, 8 * (address & 1)
        mask = _REGISTERS.get(word, (0, 0))[1] & 0xFF << shift
        if mask:
            self._word[word] = self._word[word] & ~mask | value << shift & mask
        if address == MODE_CTRL + 1:
            self._change_mode(value & 3, t)
        elif address == MSC_CTRL + 1 and value & 4:
            self._tested_at = t + _SELF_TEST_S
        elif address == GLOB_CMD and value & 0x80:
            self._reset(t)
            _log.info("soft reset")

    def _change_mode(self, command: int, t: float) -> None:
        if command == 2 and self._sampler is not None:
            self._sampler = None
            _log.info("configuration mode")
        elif command == 1 and self._sampler is None:
            decimation = DECIMATION.get(self._word[SMPL_CTRL] >> 8, 2)
            taps = self._taps.get(self._word[MODE_CTRL] & 0xFF, 2)
            self._step = decimation if self._count_step is None else self._count_step
            self._sampler = Sampler(self._signal, self._errors, t, decimation, taps, self._oscillator)
            self._sampler.prepare()
            rate = TICK_HZ / decimation
            _log.info("sampling %g/s, %d taps, %s", rate, taps, "auto" if self._auto else "polled")
