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

import msgspec

from imud.drivers.driver import ImuConfigured, ImuDriver

from ..configuration.settings import Initial, Settings
from ..estimators import registry
from ..pipeline import Filter, InertialPipeline
from ..sensor_errors.calibration import UNKNOWN_MOUNTING, Calibration, Mounting, mounting_of
from ..sensor_errors.profiles import profile_of
from ..sensors.comparison import SensorComparison
from ..sensors.inertial import Inertial
from ..setup import choices

if TYPE_CHECKING:
    from .ports import Port


OF_SPARES = choices.WITHOUT_GYROS  # their estimator


class Spares:
    """The spares that stream, and the comparison of all inertial sensors, by the paths of their ports."""

    def __init__(self, warn: Callable[[str], None]) -> None:
        """warn: called with what the user should know."""
        self._warn = warn
        self.sensors: dict[Port, Inertial] = {}
        self.takeover_s = math.inf  # when one of them takes over
        self._comparison = SensorComparison()
        self._compared: set[str] = set()
        self._unresolved: dict[str, str] = {}  # by path: which sensor went away while they disagreed
        self._known: dict[str, Calibration] = {}  # by path: of the spares, without their relative mountings
        self._relative: dict[str, Mounting] = {}  # by path: relative mountings

    def add(
        self,
        port: "Port",
        number: int,
        driver: ImuDriver,
        configured: ImuConfigured,
        calibration: Calibration,
        settings: Settings,
        now_ns: int,
    ) -> None:
        """A spare streams on the port of that number."""
        path = port.spec.path
        self._unresolved = {name: was for name, was in self._unresolved.items() if path not in (name, was)}
        self._relative.pop(path, None)
        self._known[path] = calibration
        own = choices.settings_for(settings, configured.identity, number)
        filter_ = Filter(registry.by_name(OF_SPARES), own, Initial(), configured.rate_hz)
        filter_.calibrate(calibration)
        spare = Inertial(InertialPipeline(driver, driver.new_state(configured), filter_))
        spare.connect(port.line, driver, configured, now_ns)
        self.sensors[port] = spare
        self._compare(port, spare)

    def _compare(self, port: "Port", sensor: Inertial) -> None:
        self._comparison.join(port.spec.path, profile_of(sensor.stream.filter.settings), sensor.has_gyros)
        self._compared.add(port.spec.path)

    def remove(self, port: "Port") -> None:
        """A sensor, spare or in use, streams no more, or becomes the one in use."""
        was_spare = self.sensors.pop(port, None) is not None
        is_reference = not was_spare and self._relative.get(port.spec.path) is not UNKNOWN_MOUNTING
        for path, verdict in self._comparison.verdicts.items():
            if path != port.spec.path and port.spec.path in verdict.text:
                self._unresolved[path] = port.spec.path
                if is_reference and "forces" in verdict.groups:
                    self._relative.setdefault(path, UNKNOWN_MOUNTING)
        for path in list(self._compared) if not self.sensors else self._compared & {port.spec.path}:
            self._compared.remove(path)
            self._comparison.leave(path)

    def add_samples(self, port: "Port", sensor: Inertial, n: int) -> None:
        """A sensor, spare or in use, has n new samples."""
        if self.sensors:
            if port.spec.path not in self._compared:
                self._compare(port, sensor)
            self._comparison.add_samples(port.spec.path, sensor.stream.samples[:n])

    def update(self, used_port: "Port", used: Inertial, now_ns: int) -> None:
        """Call several times a second: compares the sensors."""
        if self.sensors:
            every = {**self.sensors, used_port: used}
            self._comparison.update({port.spec.path for port, sensor in every.items() if sensor.faults(now_ns)})
            for port, spare in self.sensors.items():
                self._find_mounting(port, spare, used_port.spec.path)

    def _find_mounting(self, port: "Port", spare: Inertial, used: str) -> None:
        """Turn a spare's samples into the axes of the sensor in use, where that is why the two disagree."""
        path = port.spec.path
        if self._relative.get(used) is UNKNOWN_MOUNTING:
            return
        unknown = self._relative.get(path, UNKNOWN_MOUNTING) is UNKNOWN_MOUNTING
        if unknown and self._comparison.agree(path, used):
            self._relative.pop(path, None)
        elif unknown and (found := self._comparison.rotation(path, used)) is not None:
            self._relative[path] = mounting_of(found.matrix, (found.sigma, found.sigma, found.sigma))
            spare.stream.filter.calibrate(self.calibration(port, self._known[path]))
            self._compare(port, spare)
            whole = mounting_of(spare.stream.filter.correction["turn"].reshape(3, 3), (0.0, 0.0, 0.0))
            rpy = ", ".join(f"{angle:.1f}" for angle in whole.rpy_deg)
            self._warn(
                f"inertial sensor on {path} sits otherwise than the settings say: against {used} its mounting is "
                f"[{rpy}] deg (roll, pitch, yaw), which is used from now on; set it as imu.mounts"
            )

    def calibration(self, port: "Port", known: Calibration) -> Calibration:
        """With the relative mounting of the sensor on that port, if it has one."""
        relative = self._relative.get(port.spec.path)
        return known if relative is None else msgspec.structs.replace(known, relative_mounting=relative)

    def findings(self, port: "Port") -> tuple[str, ...]:
        """How that sensor disagrees with others, or did with one that has gone, in words."""
        path = port.spec.path
        gone = self._unresolved.get(path)
        text = f"disagreed with {gone} until that went away: see imu.mounts" if gone else ""
        if gone and self._relative.get(path) is UNKNOWN_MOUNTING:
            text += "; until then its attitude is not valid"
        if (verdict := self._comparison.verdicts.get(path)) is not None:
            text = verdict.text
        return (f"inertial sensor on {path}: {text}",) if text else ()

    def is_wrong(self, port: "Port") -> bool:
        """Whether it is known that this is the sensor that is wrong."""
        verdict = self._comparison.verdicts.get(port.spec.path)
        return verdict is not None and verdict.is_wrong

    def successor(self) -> "Port | None":
        """The spare that takes over best."""
        return min(self.sensors, key=self.is_wrong, default=None)
