"""How fast commands work through a recording: whole, from file to file, as multiples of real time."""

import contextlib
import io
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ...errors import ImudError
from ...figures import available
from .. import main
from .emulated import write_recording
from .table import Section
from .throughput import timed
from .turns import Turns

_BYTES_A_DAY = 2e9
_SENTENCES = "a fifth of it is Python's, for the receiver: 15 sentences a second, and the checks of 5 fixes"
_PAGE = "two fifths of it make the page: figures, and their JSON"
_ROS2 = "a sample becomes five messages, 2 kB, mostly covariances: numpy makes them, zstd compresses them"
_RAW = "most of it are the noise of the samples and of their arrival times, which do not compress"


def recordings(seconds: int, rounds: int) -> Section:
    """A recording of an M-G350 and a receiver through the commands that a user waits for."""
    section = Section(f"A recording of {seconds} s at 1 kHz with a receiver, in one process, start apart")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = folder / "bench.mcap"
        write_recording(recording, seconds)
        commands: list[tuple[str, list[str], float, str]] = [
            ("replay to a CSV file, every sample", ["replay", "-o", "est.csv"], 300, _SENTENCES),
            ("export to CSV files", ["export", "--csv", "csv"], 100, ""),
            ("export to ROS 2", ["export", "--ros2", "ros.mcap"], 100, _ROS2),
            ("report", ["report", "-o", "report.html"], 200, _PAGE),
        ]
        for what, (command, option, output), least, reason in commands:
            if command == "report" and not available():
                section.add(f"{what}, against real time", np.nan, "x", least=least, note="plotly is not installed")
                continue
            arguments = [command, str(recording), option, str(folder / output)]
            turns = Turns(rounds, _timed_command(arguments))
            section.add(f"{what}, against real time", seconds / turns.median(0), "x", least=least, reason=reason)
        a_day = recording.stat().st_size / seconds * 86400.0
        section.add("size of a day at the default settings", a_day * 1e-9, "GB", most=_BYTES_A_DAY * 1e-9, reason=_RAW)
    return section


def _timed_command(arguments: Sequence[str]) -> Callable[[], float]:
    """Runs the command; the first run, which imports it, does not count. Raises ImudError."""

    def run() -> None:
        with contextlib.redirect_stderr(io.StringIO()) as printed:  # findings about a noiseless recording
            code = main(list(arguments))
        if code:
            raise ImudError(f"bench: imud {' '.join(arguments)} failed: {printed.getvalue().strip()}")

    run()
    return lambda: timed(run)
