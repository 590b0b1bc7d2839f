"""A user's own recording for an experiment: samples in body axes, fixes, and the settings that fit its sensor."""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imud.drivers.capture_messages import CONNECTIONS

from ..configuration.settings import Initial, Settings
from ..errors import BadDataError
from ..estimators.records import FIX
from ..math.arrays import Records
from ..recording.player import Handlers, Player
from ..recording.source import Recording, adapter, print_notes
from ..setup import config
from ..tables.fixes import fixes_of_file
from ..tables.inputs import is_recording, read_imu

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Recorded:
    """samples: array of SAMPLE; fixes: array of FIX on their clock; gyro_axes: which rates there are."""

    name: str
    samples: Records
    fixes: Records
    settings: Settings
    gyro_axes: tuple[bool, bool, bool] = (True, True, True)

    @property
    def rate_hz(self) -> float:
        return 1e9 / float(np.median(np.diff(self.samples["t_ns"])))

    @property
    def seconds(self) -> float:
        return float(self.samples["t_ns"][-1] - self.samples["t_ns"][0]) * 1e-9


def read(path: Path, gnss: Path | None, file: Path | None, overrides: Sequence[str]) -> Recorded:
    """A recording (MCAP), or a table of samples; gnss: fixes beside a table. file, overrides: as --config and --set.

    Raises ImudError for what cannot be read.
    """
    data = _mcap(path, file, overrides) if is_recording(path) else _tables(path, gnss, file, overrides)
    if len(data.samples) < 2 or data.seconds <= 0.0:
        raise BadDataError(f"{path}: {len(data.samples)} inertial samples in it")
    return data


def _tables(path: Path, gnss: Path | None, file: Path | None, overrides: Sequence[str]) -> Recorded:
    settings = config.load(file, overrides)
    samples, origin, _ = read_imu(path)
    fixes = np.zeros(0, FIX)
    if gnss is not None:

        def warn(problem: str) -> None:
            print(f"imud reproduce: {gnss}: {problem}", file=sys.stderr)

        fixes = fixes_of_file(gnss, origin, int(samples["t_ns"][0]), settings.gnss, warn)
    return Recorded(path.name, samples, fixes, settings)


def _mcap(path: Path, file: Path | None, overrides: Sequence[str]) -> Recorded:
    recording = Recording([path])
    adapt = adapter(file, overrides, "tilt")  # the cheapest estimator: only samples and fixes are wanted
    blocks: list[Records] = []
    fixes: list[Records] = [np.zeros(0, FIX)]
    axes = (True, True, True)
    handlers = Handlers(
        lambda samples, _: blocks.append(samples.copy()),
        fix=lambda fix: fixes.append(fix.copy()),
        warn=recording.notes.append,
    )
    player = Player(recording.settings(adapt), adapt, Initial(), handlers)
    for entry in recording.entries(Player.TOPICS):
        player.take(entry)
        if entry.topic == CONNECTIONS and (connection := entry.connection()).kind == "imu" and connection.streaming:
            axes = connection.imu().gyro_axes
    print_notes("reproduce", recording.notes)
    if not blocks:
        raise BadDataError(f"{path}: no samples of an inertial sensor in it")
    samples, known = np.concatenate(blocks), np.concatenate(fixes)
    begin_ns = math.floor(samples["t_ns"][0] / SECOND_NS) * SECOND_NS
    samples["t_ns"] -= begin_ns
    for name in ("t_ns", "arrival_ns"):
        known[name] -= begin_ns
    return Recorded(path.name, samples, known, player.filter.settings, axes)
