"""From our records to all messages of a topic: the one place that `imud export --ros2` and `imud ros2` share."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..math.arrays import Indices, Records
from ..recording.enu import ANTENNA, BODY, IMU, Vector, body
from ..sensors.gnss import position_sigma
from . import messages
from .cdr import Cdr
from .definitions import STATIC
from .frames import IDENTITY, Frames
from .messages import Diagnosis, Sigmas


class Message(NamedTuple):
    """A message in CDR for a topic of TOPICS."""

    topic: str
    unix_ns: int
    data: bytes


class Block(NamedTuple):
    """n messages for a topic, and their times."""

    topic: str
    unix_ns: Indices
    messages: Cdr


def block_of(message: Message) -> Block:
    """The same as a block of one."""
    topic, unix_ns, data = message
    return Block(topic, np.array([unix_ns]), Cdr.of(data))


def _single(blocks: Iterator[Block]) -> Iterator[Message]:
    """Of blocks of one message each."""
    for topic, unix_ns, cdr in blocks:
        yield Message(topic, int(unix_ns[0]), cdr.only())


class Converter:
    """Keeps what messages need of the rows before. sigmas: of the inertial sensor, once it is known."""

    def __init__(self) -> None:
        self.sigmas = Sigmas()
        self._frames = Frames()

    def of_sample(self, sample: np.void, unix_ns: int) -> Iterator[Message]:
        """sample: a row of SAMPLE."""
        return _single(self.of_samples(np.array([sample]), np.array([unix_ns])))

    def of_solution(self, solution: np.void, unix_ns: int) -> Iterator[Message]:
        """solution: a row of SOLUTION, in order of time."""
        return _single(self.of_solutions(np.array([solution]), np.array([unix_ns])))

    def of_samples(self, samples: Records, unix_ns: Indices) -> Iterator[Block]:
        """samples: rows of SAMPLE."""
        yield Block("imu/data_raw", unix_ns, messages.imu_raw(samples, unix_ns, self.sigmas))

    def of_solutions(self, solutions: Records, unix_ns: Indices) -> Iterator[Block]:
        """solutions: rows of SOLUTION, in order of time, at least one."""
        yield Block("imu/data", unix_ns, messages.imu(solutions, unix_ns, self.sigmas))
        motion = self._frames.step(solutions)
        if (known := motion.is_known).any():
            transforms = motion.map_to_odom[known], motion.odom_to_body[known]
            yield Block("/tf", unix_ns[known], messages.motion(unix_ns[known], *transforms))
        if (placed := motion.is_placed).any():
            rows, at = (solutions, unix_ns) if placed.all() else (solutions[placed], unix_ns[placed])
            yield Block("odometry", at, messages.odometry(rows, at, motion.place[placed], self.sigmas.gyro))
            yield Block("fix/filtered", at, messages.filtered_fix(rows, at))

    def of_fix(self, fix: np.void, unix_ns: int, utc_ns: int | None) -> Iterator[Message]:
        """fix: a row of FIX; utc_ns: the same instant by the receiver's clock; None: not known."""
        return _single(self.of_fixes(np.array([fix]), np.array([unix_ns]), [utc_ns]))

    def of_fixes(self, fixes: Records, unix_ns: Indices, utc_ns: Sequence[int | None]) -> Iterator[Block]:
        """fixes: rows of FIX; utc_ns: the same instants by the receiver's clock; None: not known."""
        sigmas = np.array([position_sigma(fix) for fix in fixes])
        yield Block("fix", unix_ns, messages.receiver_fixes(fixes, unix_ns, sigmas))
        known = np.array([utc is not None for utc in utc_ns])
        if known.any():
            references = np.array([utc for utc in utc_ns if utc is not None])
            yield Block("time_reference", unix_ns[known], messages.time_references(unix_ns[known], references))

    def of_diagnoses(self, parts: Sequence[Diagnosis], unix_ns: int) -> Iterator[Message]:
        yield Message("/diagnostics", unix_ns, messages.diagnostics(unix_ns, parts))

    def static(self, antenna_m: Vector | None, unix_ns: int) -> Message:
        """antenna_m: from the inertial sensor, FRD; None: not known."""
        known = [(BODY, IMU, IDENTITY)]
        if antenna_m is not None:
            known.append((BODY, ANTENNA, (body(antenna_m), IDENTITY[1])))
        return Message(STATIC, unix_ns, messages.transforms(unix_ns, known))
