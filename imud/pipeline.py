"""From bytes to solutions in one compiled call: what it works on, and who keeps that.

Live and replay step with the same code (`stages`), whatever the chunks in which the bytes came.
"""

import dataclasses
import functools
import math
from typing import Any

import numpy as np

from imud.drivers.driver import ImuConfigured, ImuDriver
from imud.drivers.sample import MOUNTING_UNKNOWN, SAMPLE

from .clocks.counter import new_clock
from .compile.hashing import digest_of
from .compile.jit import interpreted
from .configuration.settings import Initial, Settings
from .estimators import Estimator
from .estimators.filter_states import ATTITUDE_BLOCK, FILTER_STATES
from .estimators.records import FIX, INNOVATION, MAGNETOMETER_SOURCE, MEASUREMENT, PENDING_MAX, SOLUTION
from .math.arrays import Floats, Records
from .math.rotation import dcm_of_quat
from .sensor_errors.calibration import Calibration, corrected_fields, correction
from .sensor_errors.mounting_error import added_covariance
from .sensor_errors.profiles import profile_of, ranges_of
from .sensor_errors.stored_biases import Biases
from .sensor_monitor.health import new_health
from .stages import BATCH, BYTE, INERTIAL_PIPELINE, RX, Stages, decoding, ingest

PER_MEASUREMENT_MAX = 16  # innovations of one fix or measurement, at most
_NO_SAMPLE, _NO_SOLUTION, _NO_FIX, _NO_MEASUREMENT, _NO_INDEX, _BEFORE_FIRST = (
    np.zeros(n, kind)
    for n, kind in ((0, SAMPLE), (0, SOLUTION), (0, FIX), (0, MEASUREMENT), (0, np.int64), (1, np.int64))
)


_RESTARTED = (
    "the filter was started anew (so far: {}), as a variance was negative or not a number, by an error of imud: please "
    "report it, with a recording"
)


@dataclasses.dataclass(frozen=True)
class Stored:
    """What an earlier run of the program has left of a sensor's filter."""

    biases: Biases | None = None
    checkpoint: bytes = b""


NOTHING_STORED = Stored()


def innovation_buffer(count: int) -> Records:
    """Rows (INNOVATION) for what `Filter.feed` makes of `count` fixes and measurements."""
    return np.zeros(PENDING_MAX + PER_MEASUREMENT_MAX * count, INNOVATION)


@functools.lru_cache(maxsize=4)
def _checkpoint_digest(name: str, kind: np.dtype[Any], parameters: bytes, correction: bytes) -> bytes:
    """Kept, as numpy takes a millisecond to write down a dtype, and the daemon needs it once a second."""
    return digest_of(name.encode(), str(kind).encode(), parameters, correction).encode()


class Filter:
    """An estimator with its records, fed with samples and fixes. Not thread-safe.

    The records never move in memory: streams refer to them by address.
    """

    def __init__(self, estimator: Estimator, settings: Settings, initial: Initial, rate_hz: float) -> None:
        self.estimator, self.settings, self.rate_hz = estimator, settings, rate_hz
        self.parameters = estimator.configure(settings, rate_hz)
        self.state = estimator.start(self.parameters, initial)
        self._keep_beginning()
        self._mounts = settings.imu.mount_rpy_deg, settings.aiding.magnetometer_mount_rpy_deg
        self.correction = correction(Calibration(""), *self._mounts)
        self._set_sensor_axes()
        self._profile, self._given_ranges = profile_of(settings), ranges_of(settings)
        self.health = new_health(self._profile, rate_hz)
        self.stages = Stages(estimator)
        self._innovations = innovation_buffer(1)
        self.restarts = 0  # of a state that was not valid

    def _keep_beginning(self) -> None:
        """Of a filter whose run can be repeated with a record of its errors: the state before the first sample."""
        self.beginning = self.state.copy() if self.is_recorded else None

    @property
    def is_recorded(self) -> bool:
        """Whether the estimator can record what becomes of its errors, for `smoothing`."""
        return "history" in (self.state.dtype.names or ())

    def advancing(self) -> int:
        """Address of the compiled estimator's half of `ingest`; compiles it if need be."""
        return self.stages.advancing(self.parameters, self.state)

    def calibrate(self, calibration: Calibration) -> None:
        """From now on, correct the samples by this calibration."""
        self.correction[:] = correction(calibration, *self._mounts)
        self._set_sensor_axes()

    def _set_sensor_axes(self) -> None:
        """An estimator may know the axes of the sensor, which flags of samples are about."""
        if "sensor_axes" in (self.parameters.dtype.names or ()):
            self.parameters["sensor_axes"] = self.correction["turn"]

    def restore_biases(self, biases: Biases) -> None:
        """Begin with these biases; before the first sample."""
        if self.estimator.restore_biases is not None:
            self.estimator.restore_biases(self.state, biases)
            self._keep_beginning()

    def checkpoint(self) -> bytes:
        """What a filter with the same settings and calibration can `restore`; empty: this estimator has none."""
        if self.estimator.checkpoint is None:
            return b""
        saved = self.estimator.checkpoint(self.state)
        return self._digest(saved.dtype) + saved.tobytes()

    def restore(self, stored: Stored) -> bool:
        """Begin with what an earlier run has stored; before the first sample. Returns whether its estimate goes on.

        A checkpoint of another version, other settings or another calibration is ignored; then only its biases are
        used.
        """
        if stored.checkpoint and self.estimator.checkpoint is not None and self.estimator.resume is not None:
            kind = self.estimator.checkpoint(self.state).dtype
            digest = self._digest(kind)
            if stored.checkpoint[: len(digest)] == digest and len(stored.checkpoint) == len(digest) + kind.itemsize:
                before = self.state.copy()
                self.estimator.resume(self.state, np.frombuffer(stored.checkpoint, kind, offset=len(digest)))
                if self._is_valid():
                    self._keep_beginning()
                    return True
                self.state[:] = before
        if stored.biases is not None:
            self.restore_biases(stored.biases)
        return False

    def _digest(self, kind: np.dtype[Any]) -> bytes:
        """Of all on which the meaning of a checkpoint of this dtype depends."""
        return _checkpoint_digest(self.estimator.name, kind, self.parameters.tobytes(), self.correction.tobytes())

    def watch_over(self, sensor: ImuConfigured) -> None:
        """From now on, monitor this sensor, by the ranges that the user gives, else by those that it reports."""
        ranges = {
            name: value for name in ("gyro_range", "accel_range") if math.isfinite(value := getattr(sensor, name))
        }
        profile = dataclasses.replace(self._profile, **(ranges | self._given_ranges))
        self.health[:] = new_health(profile, sensor.rate_hz, is_device=True, gyro_axes=sensor.gyro_axes)

    def configure(self, settings: Settings) -> None:
        """Take other settings; the state stays."""
        self.settings = settings
        self.parameters[:] = self.estimator.configure(settings, self.rate_hz)
        self._set_sensor_axes()

    def feed(
        self,
        samples: Records,
        out: Records,
        fixes: Records,
        fix_before: Records,
        innovations: Records,
        measurements: Records = _NO_MEASUREMENT,
        measurement_before: Records = _NO_INDEX,
    ) -> Records:
        """Step through `samples` (SAMPLE, turned to body axes in place), one solution each into `out` (SOLUTION).

        Fix i of `fixes` (FIX) is fused before sample fix_before[i] (int64, ascending), measurement i of `measurements`
        (MEASUREMENT) before sample measurement_before[i], and before the fixes there; one that is `needing_place` must
        be before sample 0. Fills `innovations`, an `innovation_buffer`: for each those pending until then, and its own.
        Returns the filled part. After fixes, a state that is not valid is started anew. Raises as `aid`.
        """
        if len(measurements):
            measurements = self._prepared(measurements)
        n = self.stages.feed(
            self.health,
            samples,
            self.correction,
            self.parameters,
            self.state,
            out,
            fixes,
            fix_before,
            measurements,
            measurement_before,
            innovations,
        )
        if len(fixes) and not self._is_valid():
            self.state[:] = self.estimator.start(self.parameters, Initial())
            self.restarts += 1
        return innovations[:n]

    def _is_valid(self) -> bool:
        return self.estimator.is_valid is None or self.estimator.is_valid(self.state)

    def run(self, samples: Records, out: Records) -> None:
        """Step through `samples` (SAMPLE, turned to body axes in place), one solution each into `out` (SOLUTION)."""
        self.feed(samples, out, _NO_FIX, _BEFORE_FIRST, self._innovations)

    def update(self, fix: Records) -> Records:
        """Take a fix (array of one FIX); returns those pending until then and its own, valid until the next call."""
        if self.estimator.update is None:
            return self.pending_innovations()
        return self.feed(_NO_SAMPLE, _NO_SOLUTION, fix, _BEFORE_FIRST, self._innovations)

    def aid(self, measurements: Records) -> Records:
        """Take measurements (MEASUREMENT) of aiding sources; returns their innovations, valid until the next call.

        Readings of a magnetometer that is used get the earth's field written to them, once the place is known. Raises
        ValueError when the estimator takes none, UsageError without the package that has the model of that field.
        """
        measurements, innovations = self._prepared(measurements), innovation_buffer(len(measurements))
        assert self.stages.aid is not None, "_prepared raises"
        return innovations[: self.stages.aid(self.parameters, self.state, measurements, innovations)]

    def needing_place(self, measurements: Records) -> Any:
        """Mask of the measurements that are prepared from the place estimated when they come."""
        used = self.settings.aiding.magnetometer
        return (measurements["kind"] == MAGNETOMETER_SOURCE) & used

    def _prepared(self, measurements: Records) -> Records:
        """The measurements as the estimator takes them."""
        if self.stages.aid is None:
            raise ValueError(f"the estimator {self.estimator.name} takes no measurements but fixes")
        if self.needing_place(measurements).any():
            self._set_earth_field(measurements)
            return self._in_body_axes(measurements)
        return measurements

    def _set_earth_field(self, measurements: Records) -> None:
        from .estimators.earth_field import set_earth_field

        if self.estimator.place is not None and (place := self.estimator.place(self.state)) is not None:
            set_earth_field(measurements, place, self.settings.aiding.magnetic_year)

    def _in_body_axes(self, measurements: Records) -> Records:
        """A copy with readings of a magnetometer calibrated, and in body axes; what is recorded is not."""
        measurements = measurements.copy()
        of_magnetometer = measurements["kind"] == MAGNETOMETER_SOURCE
        fields = measurements["value"][of_magnetometer, :3]
        measurements["value"][of_magnetometer, :3] = corrected_fields(fields, self.correction)
        unknown = of_magnetometer & ~np.isfinite(measurements["sigma"][:, 0])
        measurements["sigma"][unknown, 0] = self.correction["field_sigma"]
        return measurements

    def pending_innovations(self) -> Records:
        """The innovations (INNOVATION) of the samples since the last call of this; valid until the next one."""
        if self.estimator.pending_innovations is None:
            return self._innovations[:0]
        return self._innovations[: self.stages.pending_innovations(self.state, self._innovations)]

    def filter_states(self) -> Records:
        """What the estimator has found beside its newest solution: a row of FILTER_STATES, or none."""
        read = self.estimator.filter_states
        rows = np.zeros(0, FILTER_STATES) if read is None else read(self.state)
        if len(rows) and self.estimator.attitude is not None:
            rows["covariance"][:, ATTITUDE_BLOCK] += self._mounting_covariance(self.estimator.attitude(self.state))
        return rows

    def _mounting_covariance(self, q_nb: Floats) -> Floats:
        """Of a rotation in navigation axes, as `stages.add_mounting` takes it."""
        if self.correction["flags"][0] & MOUNTING_UNKNOWN:
            return np.eye(3) * math.pi**2
        w, x, y, z = q_nb.tolist()
        turn = interpreted(dcm_of_quat)((w, x, y, z))
        error = self.correction.view(np.recarray)[0].mounting_error
        n00, n01, n02, n11, n12, n22 = interpreted(added_covariance)(error, turn)
        return np.array([[n00, n01, n02], [n01, n11, n12], [n02, n12, n22]])

    def findings(self) -> tuple[str, ...]:
        """What the estimator has found that contradicts the settings, in words."""
        read = self.estimator.findings
        found = () if read is None else read(self.parameters, self.state)
        return (*found, _RESTARTED.format(self.restarts)) if self.restarts else found


class InertialPipeline:
    """Bytes of one inertial sensor to solutions of one filter. Owns the preallocated buffers; not thread-safe.

    `record` (array of one INERTIAL_PIPELINE) is the view that compiled code has of it.
    """

    def __init__(self, driver: ImuDriver, decoder: Records, filter_: Filter) -> None:
        self.filter = filter_
        self.decode, self.decoder = driver.decode, decoder
        self.rx = np.zeros(RX, BYTE)
        self.samples = np.zeros(BATCH, SAMPLE)
        self.solutions = np.zeros(BATCH, SOLUTION)
        self.clock = new_clock(1e6, 0.0)
        self.record = np.zeros(1, INERTIAL_PIPELINE)
        self.record["decode"], self.record["advance"] = decoding(driver, decoder), filter_.advancing()
        self.record["at"], self.record["newest"] = self.record.ctypes.data, -1
        for owner, names in ((self, _OWN_RECORDS), (filter_, _FILTER_RECORDS)):
            for name in names:
                self.record[name] = getattr(owner, name).ctypes.data

    def restart(self, decoder: Records, configured: ImuConfigured, first_flags: int) -> None:
        """Begin a new connection to the sensor: forget half frames and the clock's fit, keep the filter's state.

        first_flags: of the next sample, POWER_ON or RECONNECTED; 0: the filter has seen no sample before.
        """
        self.decoder[:] = decoder
        self.clock[:] = new_clock(configured.period_ns, configured.delay_ns)
        self.record["fill"], self.record["first_flags"] = 0, first_flags
        self.filter.watch_over(configured)

    @property
    def fill(self) -> int:
        """Index in rx at which the next bytes belong."""
        return int(self.record["fill"][0])

    def ingest(self, received: int, arrival_ns: int) -> int:
        """Decode, stamp and step what was written to rx[fill:fill + received]; returns how many solutions are new."""
        return ingest(self.record, received, arrival_ns)


_OWN_RECORDS = ("rx", "decoder", "samples", "clock", "solutions")
_FILTER_RECORDS = ("health", "correction", "parameters", "state")
