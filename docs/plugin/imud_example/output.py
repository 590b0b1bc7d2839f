"""An output: one line per second in a file, with the time and the view's sequence number."""

from pathlib import Path

import numpy as np

from imud.estimators.records import SOLUTION

PERIOD_NS = 1_000_000_000


class Lines:
    """The output (`imud.outputs.plugin.Output`)."""

    def __init__(self, argument):
        """argument: the file. Raises ValueError without one, and OSError."""
        if not argument:
            raise ValueError("name a file, as lines:/tmp/attitude.txt")
        self._file = Path(argument).open("a", buffering=1)  # noqa: SIM115
        self.due_ns = 0

    def publish(self, view, now_ns):
        """A line for the view."""
        self.due_ns = now_ns + PERIOD_NS
        w, x, y, z = np.frombuffer(view.solution, SOLUTION)["q_nb"][0]
        self._file.write(f"{view.t_mono_ns * 1e-9:.3f} {view.seq} {w:.6f} {x:.6f} {y:.6f} {z:.6f}\n")

    def close(self):
        """The daemon ends."""
        self._file.close()
