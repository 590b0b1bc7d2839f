"""Spare inertial sensors: they stream beside the one in use, are compared with it, and one of them takes over.

A spare has no filter but `tilt`, which costs next to nothing: its pipeline is needed for the sensor monitor, the clock,
and the rotation into body axes. Without a spare nothing here runs.

A spare that sits otherwise than its mounting in the settings says has a relative mounting: the rotation to the axes of
the sensor in use. It is known once the body has turned or accelerated enough. A spare whose forces disagree for a
reason that is not known takes over with an unknown mounting: its attitude is not valid.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from imud.drivers.driver import ImuConfigured, ImuDriver

from ..configuration.settings import Initial, Settings
from ..estimators import registry
from ..pipeline import Filter, InertialPipeline
from ..sensor_errors.calibration import Calibration, correction
from ..sensor_errors.profiles import profile_of
from ..sensor_errors.stored_rotation import StoredRotation
from ..sensors.comparison import SensorComparison
from ..sensors.inertial import Inertial
from ..setup import choices
from .relative_mountings import Mounted, RelativeMountings

if TYPE_CHECKING:
    from .ports import Port


SPARE_ESTIMATOR = choices.NO_GYRO_ESTIMATOR  # their estimator


class Spares:
    """The spares that stream, and the comparison of all inertial sensors, by the paths of their ports."""

    def __init__(self, warn: Callable[[str], None], settings: Settings) -> None:
        """warn: called with what the user should know."""
        self._mountings = RelativeMountings(warn, settings.imu)
        self.sensors: dict[Port, Inertial] = {}
        self.takeover_s = math.inf  # when one of them takes over
        self._comparison = SensorComparison()
        self._compared: set[str] = set()
        self._unresolved: dict[str, str] = {}  # by path: which sensor went away while they disagreed
        self._known: dict[str, Calibration] = {}  # by path: of the spares, without their relative mountings
        self._is_given: dict[str, bool] = {}  # by path: of the spares, as `RelativeMountings.sigma`

    def add(
        self,
        port: "Port",
        driver: ImuDriver,
        configured: ImuConfigured,
        calibration: Calibration,
        settings: Settings,
        used: tuple["Port", Inertial],
        now_ns: int,
    ) -> None:
        """A spare streams. settings: with its profile and mounting."""
        path = port.spec.path
        self._unresolved = {name: was for name, was in self._unresolved.items() if path not in (name, was)}
        self._known[path] = calibration
        filter_ = Filter(registry.by_name(SPARE_ESTIMATOR), settings, Initial(), configured.rate_hz)
        filter_.calibrate(calibration)
        spare = Inertial(InertialPipeline(driver, driver.new_state(configured), filter_))
        spare.connect(port.line, driver, configured, now_ns)
        self.sensors[port] = spare
        self._mountings.recall(_mounted(port, spare), _mounted(*used), now_ns)
        filter_.calibrate(self._mountings.tried_on(calibration, path))
        named = {path, configured.identity.serial} & set(settings.imu.mounts)
        self._is_given[path] = bool(named) or calibration.mounting is not None
        self._compare(port, spare)

    def _compare(self, port: "Port", sensor: Inertial) -> None:
        path, profile = port.spec.path, profile_of(sensor.pipeline.filter.settings)
        sigma = self._mountings.sigma(path, self._is_given[path]) if port in self.sensors else 0.0
        self._comparison.join(path, profile, sensor.has_gyros, sigma)
        self._compared.add(path)

    def remove(self, port: "Port") -> None:
        """A sensor, spare or in use, streams no more, or becomes the one in use."""
        was_spare = self.sensors.pop(port, None) is not None
        is_reference = not was_spare and not self._mountings.is_unknown(port.spec.path)
        for path, verdict in self._comparison.verdicts.items():
            if path != port.spec.path and port.spec.path in verdict.text:
                self._unresolved[path] = port.spec.path
                if is_reference and "forces" in verdict.groups:
                    self._mountings.lose(path)
        if not was_spare:
            for path in [spare.spec.path for spare in self.sensors]:
                self._mountings.settle(path, port.spec.path, self._comparison.possible_rotation(path, port.spec.path))
        for path in list(self._compared) if not self.sensors else self._compared & {port.spec.path}:
            self._compared.remove(path)
            self._comparison.leave(path)

    def add_samples(self, port: "Port", sensor: Inertial, n: int) -> None:
        """A sensor, spare or in use, has n new samples."""
        if self.sensors:
            if port.spec.path not in self._compared:
                self._compare(port, sensor)
            self._comparison.add_samples(port.spec.path, sensor.pipeline.samples[:n])

    def update(self, used_port: "Port", used: Inertial) -> None:
        """Call several times a second: compares the sensors."""
        if self.sensors:
            every = {**self.sensors, used_port: used}
            self._comparison.update({port.spec.path for port, sensor in every.items() if sensor.reading_faults()})
            for port, spare in self.sensors.items():
                self._find_mounting(port, spare, used_port, used)

    def _find_mounting(self, port: "Port", spare: Inertial, used_port: "Port", used: Inertial) -> None:
        """Turn a spare's samples into the axes of the sensor in use, where that is why the two disagree."""
        path, reference, mountings = port.spec.path, used_port.spec.path, self._mountings
        agree = self._comparison.agree(path, reference)
        if mountings.is_unknown(reference):
            return
        if mountings.is_recalled(path):
            verdict = self._comparison.verdicts.get(path)
            if verdict and "forces" in verdict.groups and reference in verdict.text:
                mountings.contradict(path, reference)
                self._turn(port, spare)
            elif agree:
                mountings.confirm(path)
        elif not mountings.is_found(path):
            if agree:
                mountings.forget(path)
            elif (found := self._comparison.rotation(path, reference)) is not None:
                mountings.found(_mounted(port, spare), _mounted(used_port, used), found)
                self._turn(port, spare)

    def _turn(self, port: "Port", spare: Inertial) -> None:
        """Its samples are turned otherwise from now on: the comparison begins anew."""
        spare.pipeline.filter.calibrate(self._mountings.applied_to(self._known[port.spec.path], port.spec.path))
        self._compare(port, spare)

    def calibration(
        self,
        port: "Port",
        configured: ImuConfigured,
        known: Calibration,
        settings: Settings,
        now_ns: int,
    ) -> Calibration:
        """Of a sensor that comes into use, with its relative mounting, if it has one. settings: as for `add`."""
        turn = correction(known, settings.imu.mount_rpy_deg)["turn"].reshape(3, 3)
        identity = configured.identity
        self._mountings.recall_alone(Mounted(port.spec.path, identity.serial, configured.still_powered, turn), now_ns)
        return self._mountings.applied_to(known, port.spec.path)

    def to_store(self, used: "Port") -> list[StoredRotation]:
        """How the sensors that stream sit, for the next run."""
        return self._mountings.to_store({port.spec.path for port in (used, *self.sensors)})

    def findings(self, port: "Port") -> tuple[str, ...]:
        """How that sensor disagrees with others, or did with one that has gone, in words."""
        path = port.spec.path
        gone = self._unresolved.get(path)
        text = f"disagreed with {gone} until that went away: see imu.mounts" if gone else ""
        if port not in self.sensors and self._mountings.is_unknown(path):
            text = f"{text or 'how it sits is not known: see imu.mounts'}; until then its attitude is not valid"
        elif port not in self.sensors and self._mountings.is_partly_unknown(path):
            text = "no motion beside another sensor has shown how it is turned about the vertical: see imu.mounts"
            text = f"{text}; until then its heading is not valid"
        if (verdict := self._comparison.verdicts.get(path)) is not None:
            text = verdict.text
        return (f"inertial sensor on {path}: {text}",) if text else ()

    def disagrees(self, port: "Port") -> bool:
        """Whether that sensor disagrees with another one that streams."""
        return port.spec.path in self._comparison.verdicts

    def is_wrong(self, port: "Port") -> bool:
        """Whether it is known that this is the sensor that is wrong."""
        verdict = self._comparison.verdicts.get(port.spec.path)
        return verdict is not None and verdict.is_wrong

    def successor(self) -> "Port | None":
        """The spare that takes over best: not a wrong one, and the one of which others are spares."""
        return min(self.sensors, key=lambda p: (self.is_wrong(p), not self._is_reference(p)), default=None)

    def should_replace(self, port: "Port") -> bool:
        """Whether the successor of the sensor in use is to take over now: that is wrong, or how it sits is not known,
        and the sensor that it has replaced is back.
        """
        successor, mountings = self.successor(), self._mountings
        if successor is None or self.is_wrong(successor):
            return False
        is_unknown = mountings.is_unknown(port.spec.path) or mountings.is_partly_unknown(port.spec.path)
        return self.is_wrong(port) or (is_unknown and self._is_reference(successor))

    def _is_reference(self, port: "Port") -> bool:
        return self._mountings.is_reference(port.spec.path)


def _mounted(port: "Port", sensor: Inertial) -> Mounted:
    serial = port.configured.identity.serial if port.configured else ""
    still_powered = isinstance(port.configured, ImuConfigured) and port.configured.still_powered
    return Mounted(
        port.spec.path, serial, still_powered, sensor.pipeline.filter.correction["turn"].reshape(3, 3).copy()
    )
