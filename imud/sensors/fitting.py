"""Chooses the filter for the inertial sensor that was found, and decides whether its earlier filter goes on."""

import math
from collections.abc import Callable
from typing import Any

from drivers.driver import ImuConfigured, ImuDriver
from drivers.transport.line import Line

from ..configuration import choices
from ..configuration.settings import Initial, Settings
from ..pipeline import Filter, Stream
from ..sensor_errors.calibration import Calibration
from .inertial import Inertial

RATE_STEP = 0.1  # logarithmic: sensors within that are the same to a filter
_UNKNOWN = Initial()


class Fitting:
    """The inertial sensor and its filter, which outlive connections. warn: called with what the user should know."""

    def __init__(self, settings: Settings, warn: Callable[[str], None], initial: Initial = _UNKNOWN) -> None:
        self.choice = choices.estimators(settings)
        self.estimator = self.choice.wanted
        self.inertial: Inertial | None = None
        self._warn, self._initial = warn, initial
        self._serial = ""  # another sensor has other biases
        self._made_for: tuple[Any, ...] = ()

    def connect(
        self,
        line: Line,
        driver: ImuDriver,
        configured: ImuConfigured,
        calibration: Calibration,
        settings: Settings,
        now_ns: int,
    ) -> Inertial:
        """The sensor streams. Raises UsageError if it does not suffice for the estimator that the user asked for."""
        settings = choices.settings_for(settings, configured.identity)
        self.estimator, why = self.choice.fitting(configured)
        if why:
            self._warn(why)
        about_hz = round(math.log(configured.rate_hz) / RATE_STEP)  # a rate that was heard varies a little
        self._serial = configured.identity.serial or self._serial  # who does not tell is taken for the same
        made_for = (driver.name, self.estimator.name, settings.imu.profile, about_hz, self._serial)
        if self.inertial is None or made_for != self._made_for:
            filter_ = Filter(self.estimator, settings, self._initial, configured.rate_hz)
            stream = Stream(driver, driver.new_state(configured), filter_)
            stream.record["count"] = self.inertial.samples if self.inertial else 0
            self.inertial = Inertial(stream)
            self._made_for = made_for
        self.inertial.stream.filter.configure(settings)
        self.inertial.stream.filter.calibrate(calibration)
        self.inertial.connect(line, driver, configured, now_ns)
        return self.inertial
