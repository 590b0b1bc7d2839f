"""An MCAP file of the messages that `imud ros2` publishes live, made of a recording that is replayed."""

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CannotCreateError
from ..math.arrays import Records
from ..outputs.gpsd_json import status_text
from ..pipeline import Filter
from ..recording.enu import Vector
from ..recording.player import Player
from ..recording.writer import Thinner
from ..sensors.inertial import Inertial
from .converter import Block, Converter, Message
from .definitions import STATIC, TOPICS, definition
from .messages import Diagnosis, Sigmas, filter_diagnosis

_TOGETHER = 1024  # rows that become messages at once
_DIAGNOSES_NS = 1_000_000_000  # from one to the next
_NAMES = {"imu": "inertial sensor", "gnss": "receiver"}
# rosbag2's numbers of the policies: keep the last 1, reliable, transient local; for subscribers that come later
_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_LATCHED = (
    f"- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline: {_FOREVER}\n  lifespan: {_FOREVER}\n"
    f"  liveliness: 1\n  liveliness_lease_duration: {_FOREVER}\n  avoid_ros_namespace_conventions: false\n"
)


class Bag:
    """The file of one recording."""

    def __init__(
        self, path: Path, rate_hz: float, offset_ns: int, player: Player, antenna_m: Vector, stack: ExitStack
    ) -> None:
        """rate_hz: of samples and solutions, 0: all; offset_ns: Unix time less the recording's; antenna_m: from the
        inertial sensor, FRD. Raises ImudError.
        """
        from .block_writer import BlockWriter

        try:
            file = stack.enter_context(path.open("wb"))
        except OSError as error:
            raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error
        self._writer: Any = BlockWriter(file)
        self._writer.start(profile="ros2", library="imud")
        stack.callback(self._finish)
        self._channels: dict[str, int] = {}
        self._converter = Converter()
        self._samples, self._solutions = Thinner(rate_hz), Thinner(rate_hz)
        self._offset_ns = offset_ns
        self._player, self._antenna_m = player, antenna_m
        self._filter: Filter | None = None
        self._waiting: list[tuple[Records, Records]] = []  # samples and solutions that are no messages yet
        self._rows = 0  # of them
        self._status = 0
        self._diagnosed_ns = -_DIAGNOSES_NS
        self.fixes = 0

    def step(self, samples: Records, solutions: Records) -> None:
        """Rows of SAMPLE and SOLUTION."""
        inertial = self._player.inertial
        assert inertial is not None
        if inertial.stream.filter is not self._filter:
            self._write_waiting()
            self._filter = inertial.stream.filter
            self._converter.sigmas = Sigmas(*inertial.sample_sigmas)
        kept = self._samples.kept(samples).copy(), self._solutions.kept(solutions).copy()
        self._waiting.append(kept)
        self._rows += len(kept[0])
        self._status = int(solutions["status"][-1])
        if self._rows >= _TOGETHER:
            self._write_waiting()
        self._diagnose()

    def _write_waiting(self) -> None:
        if self._rows:
            samples, solutions = (np.concatenate(blocks) for blocks in zip(*self._waiting, strict=True))
            self._add_blocks(self._converter.of_samples(samples, samples["t_ns"] + self._offset_ns))
            self._add_blocks(self._converter.of_solutions(solutions, solutions["t_ns"] + self._offset_ns))
        self._waiting.clear()
        self._rows = 0

    def _finish(self) -> None:
        self._write_waiting()
        self._writer.finish()

    def write_fix(self, fix: Records) -> None:
        """An array of one FIX."""
        self.fixes += 1
        unix_ns, reported = self._unix_ns(fix[0]), self._player.reported
        self._add(self._converter.of_fix(fix[0], unix_ns, reported.utc_ns(unix_ns) if reported else None))
        self._diagnose()

    def _unix_ns(self, row: np.void) -> int:
        return int(row["t_ns"]) + self._offset_ns

    def _diagnose(self) -> None:
        """Once a second, as the daemon would have said it then."""
        now_ns = self._player.now_ns
        if now_ns - self._diagnosed_ns < _DIAGNOSES_NS:
            return
        self._diagnosed_ns = now_ns
        parts = []
        if self._filter is not None:
            parts.append(filter_diagnosis(self._filter.estimator.name, status_text(self._status)))
        for said, sensor in self._player.sensors():
            said_of = {"path": said.path, "driver": said.driver, **sensor.properties(now_ns)}
            values = {name: value for name, value in said_of.items() if not isinstance(value, Mapping)}
            identity = said.imu().identity if isinstance(sensor, Inertial) else said.gnss().identity
            hardware = " ".join(filter(None, (identity.model or identity.driver, identity.serial)))
            parts.append(Diagnosis(_NAMES[said.kind], sensor.faults(now_ns), hardware, values))
            sensor.update(now_ns)
        self._add(self._converter.of_diagnoses(parts, now_ns + self._offset_ns))

    def _add_blocks(self, blocks: Iterable[Block]) -> None:
        for topic, unix_ns, data in blocks:
            self._begin(int(unix_ns[0]))
            self._writer.add_rows(self._channel_of(topic), unix_ns, data)

    def _begin(self, unix_ns: int) -> None:
        """The static transforms come first."""
        if not self._channels:
            self._write(self._converter.static(self._antenna_m, unix_ns))

    def _add(self, messages: Iterable[Message]) -> None:
        for message in messages:
            self._begin(message.unix_ns)
            self._write(message)

    def _write(self, message: Message) -> None:
        topic, unix_ns, data = message
        self._writer.add_message(self._channel_of(topic), unix_ns, data, unix_ns)

    def _channel_of(self, topic: str) -> int:
        if topic not in self._channels:
            self._channels[topic] = self._new_channel(topic)
        return self._channels[topic]

    def _new_channel(self, topic: str) -> int:
        kind = TOPICS[topic]
        schema = self._writer.register_schema(kind, "ros2msg", definition(kind).encode())
        profiles = {"offered_qos_profiles": _LATCHED if topic == STATIC else ""}
        return int(self._writer.register_channel(f"/{topic.lstrip('/')}", "cdr", schema, profiles))
