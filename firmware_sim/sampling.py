"""From motion to the numbers an M-G350 puts out: internal sampling at 2 kHz, moving average, decimation, 16-bit words.

Works ahead in blocks, so that a sample costs a slice of bytes.
"""

from typing import Protocol

import numpy as np

from .ellipsoid import Array
from .noise import DEG, MILLI_G, ImuErrors

TICK_HZ = 2000.0  # internal sampling; the averaging filter's taps count these
_LSB = np.repeat([0.0125 * DEG, 0.125 * MILLI_G], 3)  # data sheet, "Sensitivity"
_TEMPERATURE_LSB, _TEMPERATURE_RAW_25 = 0.0042725, -15214  # degC, data sheet "Temperature sensor"
_BLOCK_TICKS = 200
_ROW = 14  # bytes: temperature, gyro x y z, accelerometer x y z


class Signal(Protocol):
    """Where the true rates and forces come from."""

    @property
    def end(self) -> float:
        """Time in s after which there is nothing, or infinity."""
        ...

    def imu(self, t: Array) -> Array:
        """w_ib_b in rad/s and f_b in m/s^2, (n, 6), at times `t` (n,) in s."""
        ...


class Sampler:
    """One run of the sensor from time `start` on: the mean of the last `taps` ticks, every `decimation` ticks.

    oscillator: speed of the device's clock against true time.
    """

    def __init__(
        self, signal: Signal, errors: ImuErrors, start: float, decimation: int, taps: int, oscillator: float = 1.0
    ) -> None:
        self._signal, self._errors, self._tick_s = signal, errors, 1.0 / (TICK_HZ * oscillator)
        self._start, self._decimation, self._taps = start, decimation, taps
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
        """The next output sample: temperature, gyro x y z, accelerometer x y z, two bytes each, high byte first."""
        self.prepare()
        row = self._rows[self._at : self._at + _ROW]
        self._at += _ROW
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
        return self._errors.corrupt(self._signal.imu(times))

    def _refill(self) -> None:
        rows = max(1, _BLOCK_TICKS // self._decimation)
        ticks = rows * self._decimation
        values = np.vstack([self._history, self._ticks(self._tick, ticks)])
        self._tick += ticks
        self._history = values[len(values) - (self._taps - 1) :]
        total = np.vstack([np.zeros(6), np.cumsum(values, axis=0)])
        last = np.arange(self._decimation, ticks + 1, self._decimation) + self._taps - 1
        mean = (total[last] - total[last - self._taps]) / self._taps
        words = np.empty((rows, 7), dtype=">i2")
        celsius = self._errors.temperature(self._start + self._tick * self._tick_s)
        words[:, 0] = round((celsius - 25.0) / _TEMPERATURE_LSB) + _TEMPERATURE_RAW_25
        words[:, 1:] = np.rint(mean / _LSB)
        self._rows, self._at = words.tobytes(), 0
