"""From motion to the numbers an Epson sensor puts out: internal sampling at 2 kHz, moving average, decimation, words.

Works ahead in blocks, so that a sample costs a slice of bytes.
"""

from dataclasses import dataclass

import numpy as np

from .ellipsoid import Array
from .noise import DEG, MILLI_G, ImuErrors, SampledSignal, Signal

TICK_HZ = 2000.0  # internal sampling; the averaging filter's taps count these
_BLOCK_TICKS = 200


@dataclass(frozen=True)
class Words:
    """How a model turns values into two's complement words."""

    gyro_lsb: float  # rad/s, of 16-bit words
    accel_lsb: float  # m/s^2
    temperature_lsb: float  # degC
    temperature_raw_25: int  # the word at 25 degC
    size: int = 2  # bytes; words of 4 are 65536 times finer

    def encode(self, temperature_c: float, imu: Array) -> bytes:
        """The words of rows of rates and forces (n, 6), each behind that of the temperature, high bytes first."""
        values = np.empty((len(imu), 7))
        values[:, 0] = temperature_c - 25.0
        values[:, 1:] = imu
        finer, limit = 1 << (8 * self.size - 16), 1 << (8 * self.size - 1)
        lsb = np.array([self.temperature_lsb, *[self.gyro_lsb] * 3, *[self.accel_lsb] * 3])
        words = np.rint(values / lsb * finer)
        words[:, 0] += self.temperature_raw_25 * finer
        return bytes(np.clip(words, -limit, limit - 1).astype(f">i{self.size}").tobytes())


M_G350_WORDS = Words(0.0125 * DEG, 0.125 * MILLI_G, 0.0042725, -15214)  # data sheet, "Sensitivity"


class Sampler:
    """One run of the sensor from time `start` on: the mean of the last `taps` ticks, every `decimation` ticks.

    oscillator: speed of the device's clock against true time.
    """

    def __init__(
        self,
        signal: Signal,
        errors: ImuErrors,
        start: float,
        decimation: int,
        taps: int,
        oscillator: float = 1.0,
        words: Words = M_G350_WORDS,
    ) -> None:
        self._signal, self._errors, self._tick_s = signal, errors, 1.0 / (TICK_HZ * oscillator)
        self._start, self._decimation, self._taps, self._words = start, decimation, taps, words
        self._row = 7 * words.size
        self._tick = 0  # last tick computed
        self._given = 0  # rows handed out
        self._rows, self._at = b"", 0
        self._history = self._ticks(1 - taps, taps - 1)

    @property
    def next_time(self) -> float:
        """When the next row is ready, s; infinite where the signal has ended."""
        t = self._start + (self._given + 1) * self._decimation * self._tick_s
        return t if t <= self._signal.end else np.inf

    def row(self) -> bytes:
        """The next output sample: temperature, gyro x y z, accelerometer x y z, high bytes first."""
        self.prepare()
        row = self._rows[self._at : self._at + self._row]
        self._at += self._row
        self._given += 1
        return row

    def prepare(self) -> None:
        """Compute the next block now, if the last is used up: there is time between two samples."""
        if self._at >= len(self._rows):
            self._refill()

    def _ticks(self, first: int, n: int) -> Array:
        """Measured values of ticks first+1 .. first+n, (n, 6)."""
        if n == 0:
            return np.zeros((0, 6))
        times: Array = self._start + self._tick_s * np.arange(first + 1, first + n + 1, dtype=np.float64)
        return self._errors.measure(self._signal, times)

    def _refill(self) -> None:
        rows = max(1, _BLOCK_TICKS // self._decimation)
        ticks = rows * self._decimation
        values = np.vstack([self._history, self._ticks(self._tick, ticks)])
        self._tick += ticks
        self._history = values[len(values) - (self._taps - 1) :]
        total = np.vstack([np.zeros(6), np.cumsum(values, axis=0)])
        last = np.arange(self._decimation, ticks + 1, self._decimation) + self._taps - 1
        mean = (total[last] - total[last - self._taps]) / self._taps
        temperature = self._errors.temperature(self._start + self._tick * self._tick_s)
        self._rows, self._at = self._words.encode(temperature, mean), 0


class RowSampler:
    """As `Sampler`, of recorded samples: each as it is and when it was, whatever rate and filter the host has set."""

    def __init__(self, signal: SampledSignal, errors: ImuErrors, start: float, words: Words) -> None:
        self._signal, self._errors, self._words = signal, errors, words
        self.next_time = signal.after(start)

    def row(self) -> bytes:
        """See `Sampler`."""
        t = self.next_time
        self.next_time = self._signal.after(t)
        return self._words.encode(self._errors.temperature(t), self._errors.measure(self._signal, np.array([t])))

    def prepare(self) -> None:
        """Nothing to compute ahead."""
