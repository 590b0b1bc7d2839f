"""From our records to all messages of a topic: the one place that `imud export --ros2` and `imud ros2` share."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..recording.enu import ANTENNA, BODY, IMU, MAP, ODOM, Vector, body
from ..sensors.gnss import position_sigma
from . import messages
from .definitions import STATIC
from .frames import IDENTITY, Frames
from .messages import Diagnosis, Sigmas


class Message(NamedTuple):
    """A message in CDR for a topic of TOPICS."""

    topic: str
    unix_ns: int
    data: bytes


class Converter:
    """Keeps what messages need of the rows before. sigmas: of the inertial sensor, once it is known."""

    def __init__(self) -> None:
        self.sigmas = Sigmas()
        self._frames = Frames()

    def of_sample(self, sample: np.void, unix_ns: int) -> Iterator[Message]:
        """sample: a row of SAMPLE."""
        yield Message("imu/data_raw", unix_ns, messages.imu_raw(sample, unix_ns, self.sigmas))

    def of_solution(self, solution: np.void, unix_ns: int) -> Iterator[Message]:
        """solution: a row of SOLUTION, in order of time."""
        yield Message("imu/data", unix_ns, messages.imu(solution, unix_ns, self.sigmas))
        if self._frames.step(solution):
            known = (MAP, ODOM, self._frames.map_to_odom), (ODOM, BODY, self._frames.odom_to_body)
            yield Message("/tf", unix_ns, messages.transforms(unix_ns, known))
        if (place := self._frames.place) is not None:
            yield Message("odometry", unix_ns, messages.odometry(solution, unix_ns, place, self.sigmas.gyro))
            yield Message("fix/filtered", unix_ns, messages.filtered_fix(solution, unix_ns))

    def of_fix(self, fix: np.void, unix_ns: int, utc_ns: int | None) -> Iterator[Message]:
        """fix: a row of FIX; utc_ns: the same instant by the receiver's clock; None: not known."""
        yield Message("fix", unix_ns, messages.receiver_fix(fix, unix_ns, position_sigma(fix)))
        if utc_ns is not None:
            yield Message("time_reference", unix_ns, messages.time_reference(unix_ns, utc_ns))

    def of_diagnoses(self, parts: Sequence[Diagnosis], unix_ns: int) -> Iterator[Message]:
        yield Message("/diagnostics", unix_ns, messages.diagnostics(unix_ns, parts))

    def static(self, antenna_m: Vector | None, unix_ns: int) -> Message:
        """antenna_m: from the inertial sensor, FRD; None: not known."""
        known = [(BODY, IMU, IDENTITY)]
        if antenna_m is not None:
            known.append((BODY, ANTENNA, (body(antenna_m), IDENTITY[1])))
        return Message(STATIC, unix_ns, messages.transforms(unix_ns, known))
