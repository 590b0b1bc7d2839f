"""The inertial samples of a recording, every one, decoded from its bytes as the daemon did."""

import math
from pathlib import Path

import msgspec
import numpy as np

from imud.drivers.capture_messages import CONNECTIONS

from ..configuration.settings import Initial
from ..errors import BadDataError
from ..estimators.ins.aiding.magnetometer import SOURCE
from ..estimators.records import MEASUREMENT
from ..math.arrays import Records
from ..progress import Progress
from ..sensor_errors.calibration import Calibration, name_of
from ..tables.inputs import is_recording, read_imu
from .measurements import measurement_row
from .messages import AIDING
from .player import Handlers, Player
from .source import Recording, adapter, print_notes

_BLOCK = 1 << 16


class _Gathered:
    """Gathers rows that come a few at a time into blocks: small arrays would take more memory than their contents."""

    def __init__(self) -> None:
        self._blocks: list[Records] = []
        self._fill = _BLOCK

    def add(self, samples: Records, solutions: Records) -> None:
        """The next rows: less than a block."""
        room = min(len(samples), _BLOCK - self._fill)
        if room:
            self._blocks[-1][self._fill : self._fill + room] = samples[:room]
        if rest := len(samples) - room:
            self._blocks.append(np.empty(_BLOCK, samples.dtype))
            self._blocks[-1][:rest] = samples[room:]
        self._fill = rest or self._fill + room

    def all(self) -> Records:
        """Once, at the end."""
        rows = np.empty((len(self._blocks) - 1) * _BLOCK + self._fill, self._blocks[0].dtype)
        for k in range(len(self._blocks)):
            part = rows[k * _BLOCK : (k + 1) * _BLOCK]
            part[:] = self._blocks[k][: len(part)]
            self._blocks[k] = self._blocks[k][:0].copy()  # both need not be there as a whole
        return rows


def samples_of(path: Path) -> tuple[Records, int, int]:
    """Samples (array of SAMPLE, body axes), the origin in whole s, and the number of samples left out, which is 0.

    Raises UsageError, InputMissingError, BadDataError.
    """
    samples, _ = _samples(path, (), True)
    origin = math.floor(samples["t_ns"][0] * 1e-9)
    samples["t_ns"] -= origin * 1_000_000_000
    return samples, origin, 0


def read_samples(path: Path) -> tuple[Records, int, int]:
    """As `read_imu`, from a CSV file or a recording (MCAP), which differ in their first bytes."""
    return samples_of(path) if is_recording(path) else read_imu(path)


def own_samples_of(path: Path) -> tuple[Records, str]:
    """Samples in the sensor's own axes, uncorrected, and the name under which the sensor's calibration is kept.

    Raises as `samples_of`.
    """
    return _samples(path, ("imu.mount_rpy_deg=[0,0,0]",), False)


def fields_of(path: Path) -> tuple[Records, str]:
    """Readings of a magnetometer (array of MEASUREMENT), as they came, and the name as of `own_samples_of`.

    Raises UsageError, InputMissingError, BadDataError.
    """
    recording, names = Recording([path]), set[str]()
    rows = [np.zeros(0, MEASUREMENT)]
    for entry in recording.entries((CONNECTIONS, AIDING)):
        if entry.topic == AIDING:
            try:
                row = measurement_row(msgspec.json.decode(entry.data), (SOURCE,))
            except (msgspec.DecodeError, KeyError, TypeError, ValueError) as error:
                raise BadDataError(f"{path}: a message on {AIDING} cannot be understood: {error}") from error
            rows += [row] if row is not None else []
        elif (connection := entry.connection()).kind == "imu":
            names.add(name_of(connection.imu().identity))
    print_notes("", recording.notes)
    if len(names) > 1:
        raise BadDataError(f"{path}: several inertial sensors in it: {', '.join(sorted(names))}")
    return np.concatenate(rows), "".join(names)


def _samples(path: Path, overrides: tuple[str, ...], calibrated: bool) -> tuple[Records, str]:
    recording = Recording([path])
    adapt = adapter(None, overrides, "tilt")  # the cheapest estimator: only the samples are wanted
    gathered, names = _Gathered(), set[str]()
    notes, settings, progress = recording.notes, recording.settings(adapt), Progress(1000)
    handlers = Handlers(gathered.add, warn=notes.append)
    player = Player(settings, adapt, Initial(), handlers, None if calibrated else Calibration(""))
    for entry in recording.entries(Player.TOPICS):
        player.take(entry)
        if entry.topic == CONNECTIONS and (connection := entry.connection()).kind == "imu":
            names.add(name_of(connection.imu().identity))
        progress.at(1000 * recording.read_bytes // max(recording.bytes, 1))
    progress.at(1000)
    print_notes("", notes)
    if player.samples < 2:
        raise BadDataError("; ".join([f"{path}: {player.samples} inertial samples in it", *notes]))
    if len(names) > 1 and not calibrated:
        raise BadDataError(f"{path}: several inertial sensors in it: {', '.join(sorted(names))}")
    return gathered.all(), "".join(names)
