"""An MCAP file of the messages that `imud ros2` publishes live, made of a recording that is replayed."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from imud.drivers.sample import SAMPLE

from ..errors import CannotCreateError
from ..estimators.records import FIX, SOLUTION
from ..math.arrays import Records
from ..outputs.gpsd_json import status_text
from ..pipeline import Filter
from ..recording.enu import Vector
from ..recording.player import Player
from ..recording.thinner import Thinner
from ..sensors.inertial import Inertial
from .block_writer import BlockWriter, Rows
from .converter import Block, Converter, block_of
from .definitions import STATIC, TOPICS, definition
from .messages import Diagnosis, Sigmas, filter_diagnosis

_TOGETHER = 2048  # rows, some 4 MB of messages: a chunk
_DIAGNOSES_NS = 1_000_000_000  # from one to the next
_NAMES = {"imu": "inertial sensor", "gnss": "receiver"}
# rosbag2's numbers of the policies: keep the last 1, reliable, transient local; for subscribers that come later
_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_LATCHED = (
    f"- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline: {_FOREVER}\n  lifespan: {_FOREVER}\n"
    f"  liveliness: 1\n  liveliness_lease_duration: {_FOREVER}\n  avoid_ros_namespace_conventions: false\n"
)


@dataclass
class _Waiting:
    """What is no message yet, as the bytes of its rows, and diagnoses, whose messages differ in size.

    rows: how many of all.
    """

    samples: bytearray = field(default_factory=bytearray)
    solutions: bytearray = field(default_factory=bytearray)
    fixes: bytearray = field(default_factory=bytearray)
    utc_ns: list[int | None] = field(default_factory=list)  # of the fixes, by the receiver
    diagnoses: list[Block] = field(default_factory=list)
    rows: int = 0


class Bag:
    """The file of one recording."""

    def __init__(
        self, path: Path, rate_hz: float, offset_ns: int, player: Player, antenna_m: Vector, stack: ExitStack
    ) -> None:
        """rate_hz: of samples and solutions, 0: all; offset_ns: Unix time less the recording's; antenna_m: from the
        inertial sensor, FRD. Raises ImudError.
        """
        try:
            file = stack.enter_context(path.open("wb"))
        except OSError as error:
            raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error
        self._writer = BlockWriter(file, "ros2")
        stack.callback(self._finish)
        self._channels: dict[str, int] = {}
        self._converter = Converter()
        self._samples, self._solutions = Thinner(rate_hz), Thinner(rate_hz)
        self._offset_ns = offset_ns
        self._player, self._antenna_m = player, antenna_m
        self._filter: Filter | None = None
        self._waiting = _Waiting()
        self._status = 0
        self._diagnosed_ns = -_DIAGNOSES_NS
        self.fixes = 0

    def step(self, samples: Records, solutions: Records) -> None:
        """Rows of SAMPLE and SOLUTION."""
        inertial = self._player.inertial
        assert inertial is not None
        if inertial.pipeline.filter is not self._filter:
            self._write_waiting()
            self._filter = inertial.pipeline.filter
            self._converter.sigmas = Sigmas(*inertial.sample_sigmas)
        kept = self._samples.kept(samples)
        self._waiting.samples += kept.tobytes()
        self._waiting.solutions += self._solutions.kept(solutions).tobytes()
        self._waiting.rows += len(kept)
        self._status = int(solutions["status"][-1])
        self._diagnose()

    def _write_waiting(self) -> None:
        """As one chunk."""
        waiting, self._waiting = self._waiting, _Waiting()
        if not waiting.rows:
            return
        blocks = list(waiting.diagnoses)
        if waiting.samples:
            samples, solutions = np.frombuffer(waiting.samples, SAMPLE), np.frombuffer(waiting.solutions, SOLUTION)
            blocks += self._converter.of_samples(samples, samples["t_ns"] + self._offset_ns)
            blocks += self._converter.of_solutions(solutions, solutions["t_ns"] + self._offset_ns)
        if waiting.fixes:
            fixes = np.frombuffer(waiting.fixes, FIX)
            blocks += self._converter.of_fixes(fixes, fixes["t_ns"] + self._offset_ns, waiting.utc_ns)
        if not self._channels:
            first_ns = min(int(block.unix_ns[0]) for block in blocks)
            blocks.insert(0, block_of(self._converter.static(self._antenna_m, first_ns)))
        self._writer.write_chunk([Rows(self._channel_of(topic), times, data) for topic, times, data in blocks])

    def _finish(self) -> None:
        self._write_waiting()
        self._writer.finish()

    def write_fix(self, fix: Records) -> None:
        """An array of one FIX."""
        self.fixes += 1
        unix_ns, reported = int(fix[0]["t_ns"]) + self._offset_ns, self._player.reported
        self._waiting.fixes += fix.tobytes()
        self._waiting.utc_ns.append(reported.utc_ns(unix_ns) if reported else None)
        self._waiting.rows += 1
        self._diagnose()

    def _diagnose(self) -> None:
        """Once a second, as the daemon would have said it then."""
        if self._waiting.rows >= _TOGETHER:
            self._write_waiting()
        now_ns = self._player.now_ns
        if now_ns - self._diagnosed_ns < _DIAGNOSES_NS:
            return
        self._diagnosed_ns = now_ns
        parts = []
        if self._filter is not None:
            parts.append(filter_diagnosis(self._filter.estimator.name, status_text(self._status)))
        for connection, sensor in sorted(self._player.sensors(), key=lambda pair: list(_NAMES).index(pair[0].kind)):
            properties = {"path": connection.path, "driver": connection.driver, **sensor.properties(now_ns)}
            values = {name: value for name, value in properties.items() if not isinstance(value, Mapping)}
            identity = connection.imu().identity if isinstance(sensor, Inertial) else connection.gnss().identity
            hardware = " ".join(filter(None, (identity.model or identity.driver, identity.serial)))
            parts.append(Diagnosis(_NAMES[connection.kind], sensor.faults(now_ns), hardware, values))
            sensor.update(now_ns)
        messages = self._converter.of_diagnoses(parts, now_ns + self._offset_ns)
        self._waiting.diagnoses += map(block_of, messages)
        self._waiting.rows += 1

    def _channel_of(self, topic: str) -> int:
        if topic not in self._channels:
            self._channels[topic] = self._new_channel(topic)
        return self._channels[topic]

    def _new_channel(self, topic: str) -> int:
        kind = TOPICS[topic]
        schema = kind, "ros2msg", definition(kind).encode()
        profiles = {"offered_qos_profiles": _LATCHED if topic == STATIC else ""}
        return self._writer.add_channel(f"/{topic.lstrip('/')}", "cdr", schema, profiles)
