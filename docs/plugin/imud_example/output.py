"""An output: one line per second in a file: time, sequence number of the view, roll, pitch and yaw in degrees."""

from pathlib import Path

from imud.estimators.records import ATTITUDE_VALID
from imud.outputs.view import decode, euler

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
        """A line for the view, once its attitude is valid: before the sensor streams a view has no solution."""
        self.due_ns = now_ns + PERIOD_NS
        state = decode(view.solution)
        if state.status & ATTITUDE_VALID:
            roll, pitch, yaw = euler(state.q_nb)
            self._file.write(f"{view.t_mono_ns * 1e-9:.3f} {view.seq} {roll:.3f} {pitch:.3f} {yaw:.3f}\n")

    def close(self):
        """The daemon ends."""
        self._file.close()
