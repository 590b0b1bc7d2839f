"""A rate that is held, ramped smoothly and repeated for ever, with its exact integral and derivatives.

Every scenario is driven by one of these: the angle of a turntable, or the progress of a vehicle along its path.
"""

from collections.abc import Sequence

import numpy as np

from .ellipsoid import Array


class Timeline:
    """Piecewise rate: each segment is (seconds, rate at its end); the rate is 0 before time 0.

    A segment that changes the rate follows the quintic smoothstep, so the rate is C2 and its integral C3.
    lead: segments passed once; loop: segments repeated after them, which must end at the rate they began with.
    """

    def __init__(self, lead: Sequence[tuple[float, float]], loop: Sequence[tuple[float, float]]) -> None:
        segments = [*lead, *loop]
        self._length = np.array([seconds for seconds, _ in segments])
        self._rate = np.array([0.0, *(rate for _, rate in segments)])
        if self._rate[-1] != self._rate[len(lead)]:
            raise ValueError("a loop must end at the rate it began with")
        self._start = np.concatenate(([0.0], np.cumsum(self._length)))
        self._angle = np.concatenate(([0.0], np.cumsum(self._length * (self._rate[:-1] + self._rate[1:]) / 2.0)))
        self._lead_end, self._lead_angle = self._start[len(lead)], self._angle[len(lead)]
        self._loop_length = self._start[-1] - self._lead_end
        self._loop_angle = self._angle[-1] - self._lead_angle

    def at(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Integral, rate, and the rate's first and second derivative at times `t` (n,) in s."""
        turns = np.maximum(np.floor((t - self._lead_end) / self._loop_length), 0.0)
        t = np.clip(t - turns * self._loop_length, 0.0, self._start[-1])
        i = np.clip(np.searchsorted(self._start, t, side="right") - 1, 0, len(self._length) - 1)
        length, first, change = self._length[i], self._rate[i], self._rate[i + 1] - self._rate[i]
        since = t - self._start[i]
        x = since / length
        angle = self._angle[i] + first * since + change * length * x**4 * ((x - 3.0) * x + 2.5)
        rate = first + change * x**3 * ((6.0 * x - 15.0) * x + 10.0)
        slope = change / length * 30.0 * (x * (1.0 - x)) ** 2
        curve = change / length**2 * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
        return angle + turns * self._loop_angle, rate, slope, curve
