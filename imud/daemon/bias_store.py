"""Keeps what the filter finds of the inertial sensor's biases, for a daemon that is started again in a moment."""

import threading
from typing import Any

from drivers.driver import ImuConfigured

from ..configuration.settings import Settings
from ..process.log import get_logger
from ..sensor_errors import stored_biases
from ..sensor_errors.calibration import Calibration, correction
from ..sensor_errors.profiles import profile_of
from ..sensor_errors.stored_biases import Biases
from ..sensors.inertial import Inertial
from ..setup import choices

_PERIOD_NS = 5_000_000_000


class BiasStore:
    """Writes in a thread: a disk may stall for seconds."""

    def __init__(self) -> None:
        self._due_ns = 0
        self._writer: threading.Thread | None = None
        self._warned = False

    def load(
        self, configured: ImuConfigured, calibration: Calibration, settings: Settings, now_ns: int
    ) -> Biases | None:
        """The biases that an earlier run found of this very sensor; None if it may have been switched off since."""
        serial = configured.identity.serial
        if not configured.still_powered or not serial:
            return None
        own = choices.settings_for(settings, configured.identity)
        return stored_biases.load(serial, correction(calibration, own.imu.mount_rpy_deg), now_ns, profile_of(own))

    def save_when_due(self, serial: str, sensor: Inertial, now_ns: int) -> None:
        """Call now and then: writes what is known of the biases of the sensor `serial`, every few seconds."""
        busy = self._writer is not None and self._writer.is_alive()
        if not serial or sensor.newest is None or busy or now_ns < self._due_ns:
            return
        self._due_ns = now_ns + _PERIOD_NS
        biases = stored_biases.biases_of(sensor.newest)
        if biases.is_plausible:
            arguments = serial, sensor.stream.filter.correction.copy(), now_ns, biases
            self._writer = threading.Thread(target=self._save, args=arguments, daemon=True)
            self._writer.start()

    def _save(self, *arguments: Any) -> None:
        try:
            stored_biases.save(*arguments)
        except OSError as error:
            if not self._warned:
                get_logger().warning(f"biases cannot be kept over a restart: {error}")
            self._warned = True
