"""Chooses the filter for the inertial sensor that was found, and decides whether its earlier filter goes on."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from imud.drivers.driver import ImuConfigured, ImuDriver
from imud.drivers.sample import POWER_ON, RECONNECTED
from imud.drivers.transport.line import Line

from ..configuration.settings import Initial, Settings
from ..pipeline import NOTHING_STORED, Filter, InertialPipeline, Stored
from ..sensor_errors.calibration import Calibration
from ..setup import choices, config
from .inertial import Inertial

RATE_STEP = 0.1  # logarithmic: sensors within that are the same to a filter
AWAY_NS = 30_000_000_000  # after which an estimate says nothing more of the body: the filter begins anew
_UNKNOWN = Initial()


class EstimatorSelection:
    """The inertial sensor and its filter, which outlive connections. warn: called with what the user should know."""

    def __init__(self, settings: Settings, warn: Callable[[str], None], initial: Initial = _UNKNOWN) -> None:
        self.choice = choices.estimators(settings)
        self.estimator = self.choice.wanted
        self.inertial: Inertial | None = None
        self._warn, self._initial = warn, initial
        self._at_start = True
        self._serial, self._port = "", 0  # another sensor has other biases
        self.resumed = False  # the filter goes on from an earlier run of the program
        self._made_for: tuple[Any, ...] = ()

    def connect(
        self,
        line: Line,
        driver: ImuDriver,
        configured: ImuConfigured,
        calibration: Calibration,
        settings: Settings,
        now_ns: int,
        port: int = 0,
        stored: Stored = NOTHING_STORED,
    ) -> Inertial:
        """The sensor streams on the port of that number. Its earlier filter goes on if it is the same sensor and was
        not away for long, with its biases reopened if it may have been switched off. A new filter begins with what
        an earlier run has `stored`. Raises UsageError if the sensor does not suffice for the estimator that the user
        asked for.
        """
        if why := choices.unknown_profile(settings, configured.identity):
            self._warn(why)
        settings = choices.settings_for(settings, configured.identity, port)
        self.estimator, why = self.choice.estimator_for(configured)
        if why:
            self._warn(why)
        serial = configured.identity.serial
        about_hz = round(math.log(configured.rate_hz) / RATE_STEP)  # a rate that was heard varies a little
        made_for = (driver.name, self.estimator.name, settings.imu.profile, settings.imu.mount_rpy_deg, about_hz)
        same = made_for == self._made_for and self._is_same(serial, port)
        no_twin = bool(serial) and (self.inertial is None or (same and bool(self._serial)))
        self._serial, self._port = serial, port
        inertial = self.inertial if same and self.estimator.survives_power_on else None
        if inertial is not None and now_ns - inertial.last_data_ns <= AWAY_NS and not inertial.is_ahead(now_ns):
            inertial.pipeline.filter.configure(settings)
            inertial.pipeline.filter.calibrate(calibration)
        else:
            is_given = self._initial != _UNKNOWN  # newer than what an earlier run has stored
            inertial = self._begin(driver, configured, settings)
            self._initial, self._made_for = _UNKNOWN, made_for
            inertial.pipeline.filter.calibrate(calibration)
            self.resumed = inertial.pipeline.filter.restore(replace(stored, checkpoint=b"") if is_given else stored)
        self.inertial = inertial
        again = self.resumed or inertial.newest is not None
        flags = RECONNECTED if configured.still_powered and no_twin else POWER_ON
        inertial.connect(line, driver, configured, now_ns, flags if again else 0)
        return inertial

    def _begin(self, driver: ImuDriver, configured: ImuConfigured, settings: Settings) -> Inertial:
        """The sensor with a new filter; the counts go on."""
        filter_ = Filter(self.estimator, settings, self._start(settings), configured.rate_hz)
        pipeline = InertialPipeline(driver, driver.new_state(configured), filter_)
        pipeline.record["count"] = self.inertial.samples if self.inertial else 0
        return Inertial(pipeline, self.inertial.totals() if self.inertial else None)

    def _start(self, settings: Settings) -> Initial:
        """What is known of the start, at the start only. What an earlier run has stored is newer than the settings."""
        if not self._at_start:
            return _UNKNOWN
        self._at_start = False
        return self._initial.over(config.initial_of(settings))

    def _is_same(self, serial: str, port: int) -> bool:
        """Whether it is the sensor before: by its serial number, or if one of them reports none, by the port."""
        return serial == self._serial if serial and self._serial else port == self._port
