"""From bytes to solutions in one compiled call: the driver's decoder; then clock, judge of health and estimator.

A template for each of the two halves is composed with every driver and every estimator that is used; `ingest` calls the
halves by their addresses in the stream's record. So drivers plus estimators are compiled, not drivers times estimators.
Live and replay step with the same code, whatever the chunks in which the bytes came.
"""

import dataclasses
import math
import types
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.driver import ImuConfigured, ImuDriver
from drivers.entry import entry
from drivers.sample import SAMPLE

from .clocks.counter import CLOCK, new_clock, stamp
from .configuration.settings import Initial, Settings
from .estimators import Estimator
from .estimators.records import FIX, INNOVATION, SOLUTION
from .kernels.jit import inlined, kernel
from .kernels.system import call, records
from .sensor_errors.calibration import CORRECTION, Calibration, correct, correction
from .sensor_errors.profiles import profile_of
from .sensors.health import HEALTH, examine, new_health

Floats = NDArray[np.float64]
Records = NDArray[np.void]
UNREAD, OF_A_FIX = 1024, 16  # innovations, at most: of samples since `told` was last called; of one fix
BATCH = 1024  # samples one call may yield: more than a reading can hold of the shortest frames, lines of 6 bytes
RX = 65536  # bytes
BYTE = np.dtype(np.uint8)

STREAM = np.dtype(
    [
        ("at", "<i8"),  # addresses: of this record itself,
        ("decode", "<i8"),  # of the functions that `_decode` and `_advance` become,
        ("advance", "<i8"),
        ("rx", "<i8"),  # and of what they work on
        ("decoder", "<i8"),
        ("samples", "<i8"),
        ("clock", "<i8"),
        ("health", "<i8"),
        ("correction", "<i8"),
        ("parameters", "<i8"),
        ("state", "<i8"),
        ("solutions", "<i8"),
        ("fill", "<i8"),  # bytes in rx that belong to no whole frame yet
        ("count", "<i8"),  # samples since the start
        ("newest", "<i8"),  # row of the newest solution; -1: none yet
        ("heard_ns", "<i8"),  # when it came
    ],
    align=True,
)


_NO_SAMPLE, _NO_SOLUTION, _NO_FIX, _AT_ONCE = (
    np.zeros(n, kind) for n, kind in ((0, SAMPLE), (0, SOLUTION), (0, FIX), (1, np.int64))
)


def room_for(fixes: int) -> Records:
    """Room for the innovations that `Filter.feed` makes of so many fixes."""
    return np.zeros(UNREAD + OF_A_FIX * fixes, INNOVATION)


def _decode(stream: int, received: int) -> int:
    s = records(stream, 1, STREAM)[0]
    state = records(s.decoder, 1, DECODER)  # type: ignore[name-defined]  # noqa: F821
    n: int = decode(  # type: ignore[name-defined]  # noqa: F821
        records(s.rx, RX, BYTE), s.fill + received, state, records(s.samples, BATCH, SAMPLE)
    )
    s.fill = state[0].leftover
    return n


def _advance(stream: int, n: int, arrival_ns: int) -> int:
    s = records(stream, 1, STREAM)[0]
    advance(  # type: ignore[name-defined]  # noqa: F821
        records(s.samples, BATCH, SAMPLE),
        n,
        arrival_ns,
        records(s.clock, 1, CLOCK),
        records(s.health, 1, HEALTH),
        records(s.correction, 1, CORRECTION),
        records(s.parameters, 1, PARAMETERS),  # type: ignore[name-defined]  # noqa: F821
        records(s.state, 1, STATE),  # type: ignore[name-defined]  # noqa: F821
        records(s.solutions, BATCH, SOLUTION),
    )
    return n


def _each(
    samples: Any, n: int, arrival_ns: int, clock: Any, health: Any, errors: Any, parameters: Any, state: Any, out: Any
) -> None:
    for k in range(n):
        samples[k].t_ns = stamp(clock[0], samples[k].tick, arrival_ns)
        examine(health[0], samples[k])
        correct(samples[k], errors[0])
        step(parameters[0], state[0], samples[k], out[k])  # type: ignore[name-defined]  # noqa: F821


@entry
def ingest(stream: Records, received: int, arrival_ns: int) -> int:
    """Decode, stamp and step what was written to rx[fill:fill + received]; returns how many solutions are new."""
    s = stream[0]
    n = call(s.decode, (s.at, received))
    if n:
        call(s.advance, (s.at, n, arrival_ns))
        s.count += n
        s.newest = n - 1
        s.heard_ns = arrival_ns
    return int(n)


def _feed(
    health: Any,
    samples: Any,
    errors: Any,
    parameters: Any,
    state: Any,
    out: Any,
    fixes: Any,
    places: Any,
    innovations: Any,
) -> int:
    n = fed = 0
    for k in range(len(samples) + 1):
        while fed < len(fixes) and places[fed] <= k:
            n += told(state[0], innovations[n:])  # type: ignore[name-defined]  # noqa: F821
            n += update(parameters[0], state[0], fixes[fed], innovations[n:])  # type: ignore[name-defined]  # noqa: F821
            fed += 1
        if k < len(samples):
            examine(health[0], samples[k])
            correct(samples[k], errors[0])
            step(parameters[0], state[0], samples[k], out[k])  # type: ignore[name-defined]  # noqa: F821
    return n


def _told(state: Any, innovations: Any) -> int:
    n: int = told(state[0], innovations)  # type: ignore[name-defined]  # noqa: F821
    return n


@kernel
def _takes_none(parameters: Any, state: Any, fix: Any, innovations: Any) -> int:
    """The `update` of an estimator that takes no fixes."""
    return 0


@kernel
def _tells_none(state: Any, innovations: Any) -> int:
    """The `told` of an estimator whose steps make no innovations."""
    return 0


_composed: dict[str, Any] = {}


def _compose(how: Callable[..., Any], template: Callable[..., Any], name: str, **parts: Any) -> Any:
    """The template with its free names bound to `parts`, under a name of its own, by which its code is cached."""
    if name not in _composed:
        bound = types.FunctionType(template.__code__, {**globals(), **parts}, name)
        bound.__qualname__ = name
        _composed[name] = how(bound)
    return _composed[name]


def decoding(driver: ImuDriver, decoder: Records) -> int:
    """Address of the compiled driver's half of `ingest`; compiles it if need be."""
    parts = {"decode": driver.decode, "DECODER": decoder.dtype}
    return int(_compose(entry, _decode, f"decode_{driver.name}", **parts).address)


class Filter:
    """An estimator with its records, fed with samples and fixes. Not thread-safe.

    The records never move in memory: streams refer to them by address.
    """

    def __init__(self, estimator: Estimator, settings: Settings, initial: Initial, rate_hz: float) -> None:
        self.estimator = estimator
        self._rate_hz = rate_hz
        self.parameters = estimator.configure(settings, rate_hz)
        self.state = estimator.start(self.parameters, initial)
        self._mount_rpy_deg = settings.imu.mount_rpy_deg
        self.correction = correction(Calibration(""), self._mount_rpy_deg)
        self._profile = profile_of(settings)
        self.health = new_health(self._profile, rate_hz)
        self._stem = estimator.name.replace("-", "_")
        step, told, update = estimator.step, estimator.told or _tells_none, estimator.update or _takes_none
        self.each = _compose(inlined, _each, f"each_{self._stem}", step=step)
        self._feed = _compose(entry, _feed, f"feed_{self._stem}", step=step, told=told, update=update)
        self._told = _compose(entry, _told, f"told_{self._stem}", told=told)
        self._innovations = room_for(1)

    def advancing(self) -> int:
        """Address of the compiled estimator's half of `ingest`; compiles it if need be."""
        parts = {"advance": self.each, "PARAMETERS": self.parameters.dtype, "STATE": self.state.dtype}
        return int(_compose(entry, _advance, f"advance_{self._stem}", **parts).address)

    def calibrate(self, calibration: Calibration) -> None:
        """From now on, correct the samples by this calibration."""
        self.correction[:] = correction(calibration, self._mount_rpy_deg)

    def watch_over(self, sensor: ImuConfigured) -> None:
        """From now on, judge the health of this sensor, by its own ranges where it tells them."""
        ranges = {
            name: value for name in ("gyro_range", "accel_range") if math.isfinite(value := getattr(sensor, name))
        }
        self.health[:] = new_health(dataclasses.replace(self._profile, **ranges), sensor.rate_hz)

    def configure(self, settings: Settings) -> None:
        """Take other settings; the state stays."""
        self.parameters[:] = self.estimator.configure(settings, self._rate_hz)

    def feed(self, samples: Records, out: Records, fixes: Records, places: Records, innovations: Records) -> Records:
        """Step through `samples` (SAMPLE, turned to body axes in place), one solution each into `out` (SOLUTION).

        Fix i of `fixes` (FIX) goes in before sample places[i] (int64, ascending). Fills `innovations`, which must have
        `room_for` these fixes: for each fix what was `told` until then, and its own. Returns the filled part.
        """
        n = self._feed(
            self.health, samples, self.correction, self.parameters, self.state, out, fixes, places, innovations
        )
        return innovations[:n]

    def run(self, samples: Records, out: Records) -> None:
        """Step through `samples` (SAMPLE, turned to body axes in place), one solution each into `out` (SOLUTION)."""
        self.feed(samples, out, _NO_FIX, _AT_ONCE, self._innovations)

    def update(self, fix: Records) -> Records:
        """Take a fix (array of one FIX); returns what was `told` until then and its own, valid until the next call."""
        if self.estimator.update is None:
            return self.told()
        return self.feed(_NO_SAMPLE, _NO_SOLUTION, fix, _AT_ONCE, self._innovations)

    def told(self) -> Records:
        """The innovations (INNOVATION) of the samples since the last call of this; valid until the next one."""
        n = 0 if self.estimator.told is None else self._told(self.state, self._innovations)
        return self._innovations[:n]


class Stream:
    """Bytes of one inertial sensor to solutions of one filter. Owns the preallocated buffers; not thread-safe.

    `record` (array of one STREAM) is the view that compiled code has of it.
    """

    def __init__(self, driver: ImuDriver, decoder: Records, filter_: Filter) -> None:
        self.filter = filter_
        self.decode, self.decoder = driver.decode, decoder
        self.rx = np.zeros(RX, BYTE)
        self.samples = np.zeros(BATCH, SAMPLE)
        self.solutions = np.zeros(BATCH, SOLUTION)
        self.clock = new_clock(1e6, 0.0)
        self.record = np.zeros(1, STREAM)
        self.record["decode"], self.record["advance"] = decoding(driver, decoder), filter_.advancing()
        self.record["at"], self.record["newest"] = self.record.ctypes.data, -1
        for owner, names in ((self, _OURS), (filter_, _THE_FILTERS)):
            for name in names:
                self.record[name] = getattr(owner, name).ctypes.data

    def restart(self, decoder: Records, configured: ImuConfigured) -> None:
        """Begin a new connection to the sensor: forget half frames and the clock's fit, keep the filter's state."""
        self.decoder[:] = decoder
        self.clock[:] = new_clock(configured.period_ns, configured.delay_ns)
        self.record["fill"] = 0
        self.filter.watch_over(configured)

    @property
    def fill(self) -> int:
        """Index in rx at which the next bytes belong."""
        return int(self.record["fill"][0])

    def ingest(self, received: int, arrival_ns: int) -> int:
        """Decode, stamp and step what was written to rx[fill:fill + received]; returns how many solutions are new."""
        return ingest(self.record, received, arrival_ns)


_OURS = ("rx", "decoder", "samples", "clock", "solutions")
_THE_FILTERS = ("health", "correction", "parameters", "state")
