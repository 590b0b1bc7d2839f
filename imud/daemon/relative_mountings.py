"""How inertial sensors sit against the one in use, where that is not as the settings say; also from an earlier run.

What an earlier run has stored is checked as soon as both sensors stream: it is dropped if their forces disagree when
turned by it. Until they agree it counts as unknown, unless both have certainly been left alone (`StoredRotation`).

The first sensor in use sits as its settings say: it defines the body. A spare that agrees with it may still sit a
little otherwise, and be turned about the vertical by any angle until motion shows that it is not. So when the sensor in
use goes away, each spare keeps what their comparison has not excluded, with its covariance (`settle`).
"""

import time
from collections.abc import Callable, Collection
from typing import NamedTuple

import msgspec
import numpy as np

from ..configuration.settings import Imu
from ..math.arrays import Floats
from ..math.rotation import UNKNOWN_ANGLE
from ..sensor_errors import stored_rotation
from ..sensor_errors.calibration import (
    MAX_MOUNTING_SIGMA_DEG,
    NOTHING,
    UNKNOWN_MOUNTING,
    Calibration,
    RelativeMounting,
    correction,
    mounting_of,
    relative_mounting_of,
)
from ..sensor_errors.stored_rotation import StoredRotation, nine
from ..sensors.comparison import MOUNTING
from ..sensors.relative_rotation import Rotation, better_known


class Mounted(NamedTuple):
    """A sensor that streams, and the rotation [3, 3] from its axes to the vehicle's that its samples have now."""

    path: str
    serial: str
    still_powered: bool
    turn: Floats


class RelativeMountings:
    """Of sensors by the paths of their ports: a mounting, none, or `UNKNOWN_MOUNTING`. Not thread-safe."""

    def __init__(self, warn: Callable[[str], None], imu: Imu) -> None:
        """warn: called with what the user should know. imu: the settings of the mountings."""
        self._warn = warn
        self._settings = {"": imu.mount_rpy_deg, **imu.mounts}
        self._mountings: dict[str, RelativeMounting] = {}
        self._settled: dict[str, Rotation] = {}  # of spares whose samples have that mounting: when the one in use went
        self._references: set[str] = set()  # were in use with the mounting in the settings, of which others are spares
        self._rotations: dict[str, StoredRotation] = {}  # as they are stored
        self._recalled: dict[str, RelativeMounting] = {}  # of an earlier run: no motion in this one has shown them
        self._announcements: dict[str, str] = {}  # what to say once they count as known

    def forget(self, path: str) -> None:
        """The sensor may sit otherwise now, or it sits as the settings say."""
        for each in (self._mountings, self._settled, self._rotations, self._recalled, self._announcements):
            each.pop(path, None)

    def is_unknown(self, path: str) -> bool:
        """Whether the sensor is known not to sit as the settings say, but not how it sits."""
        return self._mountings.get(path) is UNKNOWN_MOUNTING

    def is_found(self, path: str) -> bool:
        """Whether it is known how the sensor sits, otherwise than the settings say."""
        return path in self._mountings and not self.is_unknown(path)

    def is_partly_unknown(self, path: str) -> bool:
        """Whether the sensor has no valid heading, as nothing has shown how it is turned about the vertical."""
        settled = self._settled.get(path)
        return settled is not None and settled.sigma > np.radians(MAX_MOUNTING_SIGMA_DEG)

    def is_reference(self, path: str) -> bool:
        """Whether the sensor was in use before others, with the mounting in the settings."""
        return path in self._references

    def sigma(self, path: str, is_given: bool) -> float:
        """Of the mounting of a spare, rad, before it is compared with the sensor in use.

        is_given: its mounting is known beforehand: the settings name the sensor, or it was calibrated.
        """
        if found := self._recalled.get(path, self._mountings.get(path)):
            return float(np.radians(min(found.sigma_deg, np.degrees(UNKNOWN_ANGLE))))
        return MOUNTING if is_given else UNKNOWN_ANGLE

    def settle(self, path: str, used: str, rotation: Rotation | None) -> None:
        """The sensor in use goes away; rotation: from the spare's samples to it, as far as they agree."""
        if used not in self._settled and not self.is_found(used):
            self._references.add(used)
        if rotation is None or path in self._references or self.is_unknown(path) or self.is_unknown(used):
            return
        in_use = self._rotation_of(used)
        covariance = rotation.covariance + (0.0 if in_use is None else in_use.covariance)
        self._settled[path] = better_known(self._settled.get(path), Rotation(rotation.matrix, covariance))

    def _rotation_of(self, path: str) -> Rotation | None:
        """From the axes that the settings give to those of the body."""
        mounting, settled = self._mountings.get(path), self._settled.get(path)
        known = None
        if mounting is not None:
            turn = correction(Calibration("", relative_mounting=mounting), NOTHING)["turn"].reshape(3, 3)
            known = Rotation(turn, np.radians(np.radians(mounting.covariance_deg2)))
        if settled is None:
            return known
        return settled if known is None else settled._replace(matrix=settled.matrix @ known.matrix)

    def lose(self, path: str) -> None:
        """The sensor disagreed with the one that was the reference, which is gone."""
        self._mountings.setdefault(path, UNKNOWN_MOUNTING)

    def applied_to(self, calibration: Calibration, path: str) -> Calibration:
        """With the relative mounting of the sensor, if it has one."""
        settled = self._rotation_of(path) if path in self._settled else None
        known = self._mountings.get(path) if settled is None else relative_mounting_of(*settled)
        return _with(calibration, known)

    def tried_on(self, calibration: Calibration, path: str) -> Calibration:
        """The same for the comparison: also with a mounting of an earlier run that counts as unknown yet."""
        return _with(calibration, self._recalled.get(path))

    def found(self, spare: Mounted, used: Mounted, rotation: Rotation) -> None:
        """Both sensors' motion has shown the rotation from the spare's samples, as they are now, to those in use."""
        self.forget(spare.path)
        self._mountings[spare.path] = relative_mounting_of(*rotation)
        if spare.serial and used.serial and spare.serial != used.serial:
            turn, body = nine(used.turn.T @ rotation.matrix @ spare.turn), nine(used.turn)
            self._rotations[spare.path] = StoredRotation(
                spare.serial, used.serial, turn, body, float(np.degrees(rotation.sigma)), time.time(), self._settings
            )
        self._warn(_announcement(spare, used.path, rotation.matrix))

    def recall(self, spare: Mounted, used: Mounted, now_ns: int) -> None:
        """The sensor becomes a spare of another one: what did an earlier run find of the two?"""
        self.forget(spare.path)
        stored = stored_rotation.between(spare.serial, used.serial)
        matrix = used.turn @ stored.matrix @ spare.turn.T if stored else np.eye(3)
        if stored and _is_strange(matrix):
            self._recall(spare, used.path, stored, matrix)
            if stored.is_recent(now_ns) and spare.still_powered and used.still_powered:
                self.confirm(spare.path)

    def recall_alone(self, sensor: Mounted, now_ns: int) -> None:
        """The sensor comes into use: did it sit otherwise than the same settings said, seconds ago?"""
        if sensor.path in self._mountings or not sensor.still_powered:
            return
        stored = stored_rotation.load(sensor.serial)
        if stored and stored.is_recent(now_ns) and stored.mountings == self._settings:
            matrix = np.array(stored.body).reshape(3, 3) @ stored.matrix @ sensor.turn.T
            if _is_strange(matrix):
                self._recall(sensor, f"sensor {stored.other}", stored, matrix)
                self.confirm(sensor.path)

    def _recall(self, sensor: Mounted, reference: str, stored: StoredRotation, matrix: Floats) -> None:
        path, sigma = sensor.path, float(np.radians(stored.sigma_deg_at(time.time())))
        self._mountings[path] = UNKNOWN_MOUNTING
        self._rotations[path], self._recalled[path] = stored, relative_mounting_of(matrix, sigma**2 * np.eye(3))
        self._announcements[path] = _announcement(sensor, reference, matrix, ", as an earlier run of the daemon found")

    def is_recalled(self, path: str) -> bool:
        """Whether what an earlier run found of the sensor turns its samples in the comparison."""
        return path in self._recalled

    def confirm(self, path: str) -> None:
        """What an earlier run found holds: the sensors agree, or nothing can have moved them."""
        self._mountings[path] = self._recalled[path]
        if text := self._announcements.pop(path, ""):
            self._warn(text)

    def contradict(self, path: str, used: str) -> None:
        """What an earlier run found does not hold: it is dropped, and how the sensor sits is not known."""
        stored_rotation.remove(self._rotations[path])
        self.forget(path)
        self._mountings[path] = UNKNOWN_MOUNTING
        self._warn(
            f"inertial sensor on {path}: its forces contradict the mounting against {used} that an earlier run of the "
            "daemon found; that is dropped"
        )

    def to_store(self, paths: Collection[str]) -> list[StoredRotation]:
        """What the next run should know, of the sensors on these paths, which stream."""
        return [each for path, each in self._rotations.items() if path in paths and self.is_found(path)]


def _is_strange(matrix: Floats) -> bool:
    """Whether a relative rotation [3, 3] is more than the errors of two mountings."""
    return Rotation(matrix, np.zeros((3, 3))).angle > 2.0 * MOUNTING


def _with(calibration: Calibration, relative: RelativeMounting | None) -> Calibration:
    return calibration if relative is None else msgspec.structs.replace(calibration, relative_mounting=relative)


def _announcement(sensor: Mounted, reference: str, matrix: Floats, source: str = "") -> str:
    whole = mounting_of(matrix @ sensor.turn, (0.0, 0.0, 0.0))
    rpy = ", ".join(f"{angle:.1f}" for angle in whole.rpy_deg)
    return (
        f"inertial sensor on {sensor.path} sits otherwise than the settings say: against {reference} its mounting is "
        f"[{rpy}] deg (roll, pitch, yaw){source}, which is used from now on; set it as imu.mounts"
    )
