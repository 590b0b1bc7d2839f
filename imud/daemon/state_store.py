"""Stores what the filter knows of the inertial sensor and of the motion, for the next run of the daemon.

The biases, which any later version can use while the sensor stays switched on; a checkpoint of the whole filter, with
which it goes on as after a gap in the samples; and how sensors sit against each other, where the settings are wrong.
"""

import _thread
import time
from collections.abc import Callable

from imud.drivers.driver import Identity, ImuConfigured

from ..configuration.settings import Settings
from ..errors import ImudError
from ..pipeline import Stored
from ..process.log import get_logger
from ..sensor_errors import stored_biases, stored_rotation
from ..sensor_errors.calibration import Calibration, correction, of
from ..sensor_errors.profiles import profile_of
from ..sensor_errors.stored_rotation import StoredRotation
from ..sensors.estimator_selection import AWAY_NS
from ..sensors.inertial import Inertial
from .checkpoint_file import CheckpointFiles

_CHECKPOINT_NS, _BIASES_NS = 1_000_000_000, 5_000_000_000  # time between two writes
_STALL_S = 0.5  # for which the end of the daemon waits for a write


class StateStore:
    """Writes in a thread of its own: a disk may stall for seconds."""

    def __init__(self) -> None:
        self._checkpoint_ns = self._biases_ns = 0  # when the next write is due
        self._files: CheckpointFiles | None = None  # of the sensor in use
        self._write: Callable[[], None] | None = None  # what the thread does next
        self._writing = _thread.allocate_lock()  # held from the request until the thread has written
        self._requested = _thread.allocate_lock()  # released to request it
        self._requested.acquire()
        self._has_thread = self._warned = False

    def load(self, configured: ImuConfigured, port: str, calibration: Calibration, settings: Settings) -> Stored:
        """What an earlier run knew of this very sensor on this port; biases only if it surely was not switched off.

        settings: with the sensor's own profile and mounting.
        """
        serial = configured.identity.serial
        self._files = CheckpointFiles(_sensor(configured), port)
        checkpoint = self._files.take(AWAY_NS)
        if not configured.still_powered or not serial:
            return Stored(None, checkpoint)
        corrected = correction(calibration, settings.imu.mount_rpy_deg)
        biases = stored_biases.load(serial, corrected, time.monotonic_ns(), profile_of(settings))
        return Stored(biases, checkpoint)

    def save_when_due(
        self, configured: ImuConfigured, sensor: Inertial, rotations: list[StoredRotation], now_ns: int
    ) -> None:
        """Call several times a second while the sensor streams that was loaded last: writes the state once a second."""
        if now_ns >= self._checkpoint_ns and not self._writing.locked():
            self._checkpoint_ns = now_ns + _CHECKPOINT_NS
            self._begin_save(configured, sensor, rotations, now_ns)

    def close(self, configured: ImuConfigured, sensor: Inertial, rotations: list[StoredRotation]) -> None:
        """Write the state at the end of the run."""
        if self._wait():
            self._begin_save(configured, sensor, rotations, time.monotonic_ns())
            self._wait()

    def _wait(self) -> bool:
        """Wait for the thread that writes; returns whether it has ended in time."""
        ended = self._writing.acquire(timeout=_STALL_S)
        if ended:
            self._writing.release()
        return ended

    def _begin_save(
        self, configured: ImuConfigured, sensor: Inertial, rotations: list[StoredRotation], now_ns: int
    ) -> None:
        if (files := self._files) is None or sensor.newest is None:
            return
        if not (biases := stored_biases.biases_of(sensor.newest)).is_plausible:
            return
        checkpoint = sensor.pipeline.filter.checkpoint()
        due = now_ns >= self._biases_ns and bool(configured.identity.serial)
        if due:
            self._biases_ns = now_ns + _BIASES_NS
        corrected = sensor.pipeline.filter.correction.copy() if due else None

        def write() -> None:
            if checkpoint:
                files.save(checkpoint)
            if corrected is not None:
                stored_biases.save(configured.identity.serial, corrected, now_ns, biases)
                for rotation in rotations:
                    stored_rotation.save(rotation, now_ns)

        self._writing.acquire()
        self._write = write
        try:
            if not self._has_thread:
                _thread.start_new_thread(self._write_on_request, ())  # `threading` would wait for its start
                self._has_thread = True
            self._requested.release()
        except RuntimeError as error:  # the limit of threads, or of memory
            self._writing.release()
            self._warn(error)

    def _write_on_request(self) -> None:
        while True:
            self._requested.acquire()
            try:
                if self._write:
                    self._write()
            except Exception as error:  # the disk's, mostly; with any other the thread must not end either
                self._warn(error)
            finally:
                self._writing.release()

    def _warn(self, error: Exception) -> None:
        if not self._warned:
            why = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.filename else error
            get_logger().warning(f"a part of the filter's state cannot be kept over a restart: {why}")
        self._warned = True


def calibration_of(identity: Identity) -> Calibration:
    """The stored calibration of this very sensor; an empty one if there is none that can be read."""
    try:
        found = of(identity)
    except ImudError as error:
        get_logger().warning(f"uncalibrated: {error}")
        return Calibration("")
    if parts := found.parts:
        get_logger().info("calibrated", sensor=found.serial, **parts)
    return found


def _sensor(configured: ImuConfigured) -> str:
    """Which sensor it is; those without a serial number are distinguished by their ports."""
    identity = configured.identity
    return f"{identity.driver} {identity.model} {identity.serial}"
