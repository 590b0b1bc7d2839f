"""A recording of imud (MCAP) as arrays."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..configuration.settings import Initial, Settings
from ..errors import BadDataError
from ..estimators.records import FIX, INNOVATION, SOLUTION
from ..math.arrays import Floats, Records
from .solution import Solution

SECOND = 1_000_000_000


@dataclass(frozen=True)
class Recording:
    """What an inertial sensor and a receiver delivered, on the host's clock, and the estimates that imud makes of it.

    imu: the columns t (s), gyro ([n, 3] rad/s), accel ([n, 3] m/s^2), temperature (degC), body axes, calibrated. gnss:
    the columns of `gnss.csv`. Both are taken by `imud.navigate`. notes: what is wrong with the recording.
    """

    imu: dict[str, Floats]
    gnss: dict[str, Floats]
    estimates: Solution
    settings: Settings
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        columns = "; ".join(f"{name}: {', '.join(getattr(self, name))}" for name in ("imu", "gnss"))
        return f"<Recording: {columns}; estimates: {self.estimates!r}; notes: {list(self.notes)}>"


def read(paths: Any) -> Recording:
    """Read a recording: a path, or the paths of its parts. The samples are decoded from the recorded bytes, and go
    through the filter with the settings of the recording.

        recording = imud.read("drive.mcap")
        solution = imud.navigate(recording.imu, recording.gnss)

    Raises UsageError (the package mcap is missing), InputMissingError, BadDataError.
    """
    from ..recording.player import Handlers, Player
    from ..recording.source import Recording as Source
    from ..recording.source import adapter

    source = Source([Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths])
    adapt: Callable[[Any], Settings] = adapter(None, (), None)
    settings = source.settings(adapt)
    samples: list[Records] = []
    solutions: list[Records] = []
    fixes: list[Records] = []
    innovations: list[Records] = [np.zeros(0, INNOVATION)]

    def step(new_samples: Records, new_solutions: Records) -> None:
        samples.append(new_samples.copy())
        solutions.append(new_solutions.copy())

    def note(_: Records, new: Records) -> None:
        innovations.append(new.copy())

    handlers = Handlers(step, note, lambda fix: fixes.append(fix.copy()), note, source.notes.append)
    player = Player(settings, adapt, Initial(), handlers)
    for entry in source:
        player.take(entry)
    if not samples:
        raise BadDataError(f"{source.path}: no samples of an inertial sensor in it")
    rows = np.concatenate(samples)
    origin = math.floor(rows["t_ns"][0] / SECOND)
    estimates = np.concatenate(solutions)
    noted = np.concatenate(innovations)
    for array in (estimates, noted):
        array["t_ns"] -= origin * SECOND
    return Recording(
        imu=_imu(rows),
        gnss=_gnss(np.concatenate([np.zeros(0, FIX), *fixes])),
        estimates=Solution(estimates.view(SOLUTION), noted, origin),
        settings=settings,
        notes=tuple(source.notes),
    )


def _imu(samples: Records) -> dict[str, Floats]:
    return {
        "t": samples["t_ns"] / SECOND,
        "gyro": samples["w"].copy(),
        "accel": samples["f"].copy(),
        "temperature": samples["temperature"].copy(),
    }


def _gnss(fixes: Records) -> dict[str, Floats]:
    columns = {
        "t_s": fixes["t_ns"] / SECOND,
        "lat_deg": np.degrees(fixes["lat"]),
        "lon_deg": np.degrees(fixes["lon"]),
        "height_m": fixes["height"],
        "arrival_s": fixes["arrival_ns"] / SECOND,
    }
    columns |= {name: fixes["sigma"][:, i] for i, name in enumerate(("sn_m", "se_m", "sd_m"))}
    columns |= {name: fixes["v"][:, i] for i, name in enumerate(("vn_mps", "ve_mps", "vd_mps"))}
    columns |= {name: fixes["sigma_v"][:, i] for i, name in enumerate(("svn_mps", "sve_mps", "svd_mps"))}
    columns |= {"hdop": fixes["hdop"], "speed_mps": fixes["speed"], "course_deg": np.degrees(fixes["course"])}
    return columns | {"quality": fixes["quality"].astype(float), "satellites": fixes["satellites"].astype(float)}
