"""An Epson sensor's side of an SPI bus, strict: a word that breaks a rule is ignored, answered with ones, and counted.

Rules (docs/protocols.md §1.6): mode 3, 16-bit words, high byte first; 20 us of rest after a word and 40 us from word
to word; 45 us after the burst command and 4 us between its words; 2 MHz at most, 1 MHz in a burst; not in UART auto
mode. A read is answered in the next word, and the flat dialect has no burst. Sans-IO: times are seconds, passed in.
"""

import math
from collections import Counter, deque

from .epson import EpsonSensor

MODE = 3
STALL_S, PERIOD_S = 20e-6, 40e-6
BURST_COMMAND_STALL_S, BURST_STALL_S = 45e-6, 4e-6
CLOCK_HZ, BURST_CLOCK_HZ = 2_000_000, 1_000_000
TOLERANCE_S = 1e-9  # of adding up times
ONES = b"\xff\xff"


class EpsonSpi:
    """The interface of one sensor. `violations` counts broken rules by name, `words` all words."""

    def __init__(self, sensor: EpsonSensor) -> None:
        self.sensor = sensor
        self.violations: Counter[str] = Counter()
        self.words = 0
        self._answer = bytes(2)  # to the last word, given with the next
        self._burst: deque[bytes] = deque()
        self._began = self._ended = -math.inf
        self._rest = STALL_S  # after the last word, needed before the next

    def transfer(self, data: bytes, t: float, clock_hz: int, mode: int) -> bytes:
        """Exchange words one right after another from time `t` on, chip select low throughout."""
        answer = b""
        for i in range(0, len(data), 2):
            begin = t + 8 * i / clock_hz
            end = begin + 16 / clock_hz
            answer += self._exchange(data[i : i + 2], begin, end, clock_hz, mode)
            self._began, self._ended = begin, end
        return answer[: len(data)]

    def _exchange(self, word: bytes, begin: float, end: float, clock_hz: int, mode: int) -> bytes:
        self.words += 1
        self.sensor.advance(end)
        in_burst = bool(self._burst) and word == bytes(2)
        if broken := self._broken(word, begin, clock_hz, mode, in_burst):
            self.violations[broken] += 1
            self._burst.clear()
            self._answer, self._rest = ONES, STALL_S
            return ONES
        if in_burst:
            self._rest = BURST_STALL_S if len(self._burst) > 1 else STALL_S
            return self._burst.popleft()
        answer, self._rest = self._answer, STALL_S
        self._burst.clear()
        self._answer = self._execute(word[0], word[1], end)
        return answer

    def _broken(self, word: bytes, begin: float, clock_hz: int, mode: int, in_burst: bool) -> str:
        """The first rule that is broken."""
        rules = {
            "length": len(word) == 2,
            "mode": mode == MODE,
            "clock": 0 < clock_hz <= (BURST_CLOCK_HZ if in_burst else CLOCK_HZ),
            "stall": begin - self._ended >= self._rest - TOLERANCE_S,
            "period": in_burst or begin - self._began >= PERIOD_S - TOLERANCE_S,
            "auto": not self.sensor.streaming or bool(word[0] & 0x80),
        }
        return next((rule for rule, kept in rules.items() if not kept), "")

    def _execute(self, address: int, value: int, t: float) -> bytes:
        """Carry a command out; returns the answer, which is sent with the next word."""
        if not self.sensor.accepts(address, t):
            return ONES
        if self.sensor.is_burst(address, value):
            data = self.sensor.burst()
            self._burst.extend(data[i : i + 2] for i in range(0, len(data), 2))
            self._rest = BURST_COMMAND_STALL_S
        elif address & 0x80:
            self.sensor.write(address & 0x7F, value, t)
        else:
            return self.sensor.read(address & 0x7E, t).to_bytes(2)
        return ONES
