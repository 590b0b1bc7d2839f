"""From bytes to solutions in two compiled calls: the driver's decoder; then clock, judge of health and estimator.

The second is composed for each estimator from one template, so that there are drivers plus estimators to compile and
to keep in memory, not drivers times estimators. Live and replay step with the same code, whatever the chunks in which
the bytes came.
"""

import dataclasses
import math
import types
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.driver import ImuConfigured
from drivers.sample import SAMPLE

from .calibration import Calibration, correct, correction
from .clock import new_clock, stamp
from .estimators import Estimator
from .estimators.records import INNOVATION, SOLUTION
from .health import examine, new_health
from .kernels.jit import kernel
from .profiles import profile_of
from .settings import Initial, Settings

Floats = NDArray[np.float64]
Records = NDArray[np.void]
UNREAD = 1024  # innovations that wait to be asked for
BATCH = 256  # samples one call may yield; more stay in the buffer for the next call


def _advance(
    samples: Any, n: int, arrival_ns: int, clock: Any, health: Any, errors: Any, parameters: Any, state: Any, out: Any
) -> None:
    for k in range(n):
        samples[k].t_ns = stamp(clock[0], samples[k].tick, arrival_ns)
        examine(health[0], samples[k])
        correct(samples[k], errors[0])
        step(parameters[0], state[0], samples[k], out[k])  # type: ignore[name-defined]  # noqa: F821


def _run(health: Any, samples: Any, errors: Any, parameters: Any, state: Any, out: Any) -> None:
    for k in range(len(samples)):
        examine(health[0], samples[k])
        correct(samples[k], errors[0])
        step(parameters[0], state[0], samples[k], out[k])  # type: ignore[name-defined]  # noqa: F821


def _update(parameters: Any, state: Any, fix: Any, innovations: Any) -> int:
    n: int = update(parameters[0], state[0], fix[0], innovations)  # type: ignore[name-defined]  # noqa: F821
    return n


def _told(state: Any, innovations: Any) -> int:
    n: int = told(state[0], innovations)  # type: ignore[name-defined]  # noqa: F821
    return n


_composed: dict[str, Callable[..., Any]] = {}


def _compose(template: Callable[..., Any], name: str, **parts: Any) -> Callable[..., Any]:
    """The template with its free names bound to kernels, under a name of its own so that numba caches it apart."""
    if name in _composed:
        return _composed[name]
    bound = types.FunctionType(template.__code__, {**globals(), **parts}, name)
    bound.__qualname__ = name
    _composed[name] = kernel(bound)
    return _composed[name]


class Filter:
    """An estimator with its records, fed with samples and fixes. Not thread-safe."""

    def __init__(self, estimator: Estimator, settings: Settings, initial: Initial, rate_hz: float) -> None:
        self.estimator = estimator
        self._rate_hz = rate_hz
        self.parameters = estimator.configure(settings, rate_hz)
        self.state = estimator.start(self.parameters, initial)
        self._mount_rpy_deg = settings.imu.mount_rpy_deg
        self.calibrate(Calibration(""))
        self._profile = profile_of(settings)
        self.health = new_health(self._profile, rate_hz)
        stem = estimator.name.replace("-", "_")
        self._run = _compose(_run, f"run_{stem}", step=estimator.step)
        self._advance = _compose(_advance, f"advance_{stem}", step=estimator.step)
        takes_fixes = estimator.update is not None
        self._update = _compose(_update, f"update_{stem}", update=estimator.update) if takes_fixes else None
        self._told = _compose(_told, f"told_{stem}", told=estimator.told) if estimator.told else None
        self._innovations = np.zeros(UNREAD + 16, INNOVATION)

    def calibrate(self, calibration: Calibration) -> None:
        """Take these errors out of the samples from now on."""
        self.correction = correction(calibration, self._mount_rpy_deg)

    def watch_over(self, sensor: ImuConfigured) -> None:
        """Judge the health of this sensor from now on, by its own ranges where it knows them."""
        ranges = {
            name: value for name in ("gyro_range", "accel_range") if math.isfinite(value := getattr(sensor, name))
        }
        self.health = new_health(dataclasses.replace(self._profile, **ranges), sensor.rate_hz)

    def configure(self, settings: Settings) -> None:
        """Go on with other settings and the same knowledge."""
        self.parameters = self.estimator.configure(settings, self._rate_hz)

    def run(self, samples: Records, out: Records) -> None:
        """Step through `samples` (SAMPLE, turned to body axes in place), one solution each into `out` (SOLUTION)."""
        self._run(self.health, samples, self.correction, self.parameters, self.state, out)

    def advance(self, samples: Records, n: int, arrival_ns: int, clock: Records, out: Records) -> None:
        """The same with the first n of samples that still lack their time: they came at `arrival_ns`."""
        self._advance(samples, n, arrival_ns, clock, self.health, self.correction, self.parameters, self.state, out)

    def update(self, fix: Records) -> Records:
        """Take a fix (array of one FIX); returns what was `told` until then and its own innovations, valid likewise."""
        n = len(self.told())
        if self._update is not None:
            n += self._update(self.parameters, self.state, fix, self._innovations[n:])
        return self._innovations[:n]

    def told(self) -> Records:
        """The innovations (INNOVATION) of the samples since it was asked last, valid until the next call."""
        n = 0 if self._told is None else self._told(self.state, self._innovations[:UNREAD])
        return self._innovations[:n]


class Stream:
    """Bytes of one inertial sensor to solutions of one filter. Owns the preallocated buffers; not thread-safe."""

    def __init__(self, decode: Callable[..., int], decoder: Records, filter_: Filter) -> None:
        self.filter = filter_
        self.decoder = decoder
        self.rx = np.zeros(65536, np.uint8)
        self.samples = np.zeros(BATCH, SAMPLE)
        self.solutions = np.zeros(BATCH, SOLUTION)
        self.clock = new_clock(1e6, 0.0)
        self.fill = 0
        self._decode = decode

    def restart(self, decoder: Records, configured: ImuConfigured) -> None:
        """A new connection to the sensor: forget half frames and the clock's fit, keep the filter's knowledge."""
        self.decoder, self.fill = decoder, 0
        self.clock = new_clock(configured.period_ns, configured.delay_ns)
        self.filter.watch_over(configured)

    def ingest(self, received: int, arrival_ns: int) -> int:
        """Decode, stamp and step what was written to rx[fill:fill + received]; returns how many solutions are new."""
        n = int(self._decode(self.rx, self.fill + received, self.decoder, self.samples))
        self.fill = int(self.decoder["leftover"][0])
        if n:
            self.filter.advance(self.samples, n, arrival_ns, self.clock, self.solutions)
        return n
