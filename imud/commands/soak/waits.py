"""Who waited for a processor: the kernel counts for each process how long it was ready to run and did not.

Source: Linux, Documentation/scheduler/sched-stats.rst, /proc/PID/schedstat: time on a processor and time of waiting in
ns, number of times on a processor.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

KERNEL = "the kernel's workers"  # among them those that pass on the bytes of serial lines and pseudo-terminals


@dataclass
class Waits:
    """Of one process, or of all of the kernel's workers."""

    waited_s: float = 0.0
    runs: int = 0  # times on a processor

    @property
    def mean_ms(self) -> float:
        """Before each run."""
        return 1e3 * self.waited_s / self.runs if self.runs else 0.0


class ProcessorWaits:
    """Call `update` now and then: what processes waited in between is added up. proc: where the kernel's files are."""

    def __init__(self, processes: Mapping[str, int], proc: Path = Path("/proc")) -> None:
        """processes: by name the number of each."""
        self.waits = {name: Waits() for name in (*processes, KERNEL)}
        self._processes, self._proc = processes, proc
        self._last: dict[int, tuple[int, int]] = {}
        self.update()

    def update(self) -> None:
        """Add what has been waited since the last call. A worker that has ended since is left out."""
        last, self._last = self._last, {}
        numbers = {number: name for name, number in self._processes.items()}
        for number in self._workers():
            numbers[number] = KERNEL
        for number, name in numbers.items():
            try:
                _, waited_ns, runs = map(int, (self._proc / str(number) / "schedstat").read_text().split())
            except (OSError, ValueError):
                continue
            self._last[number] = waited_ns, runs
            if before := last.get(number):
                self.waits[name].waited_s += (waited_ns - before[0]) * 1e-9
                self.waits[name].runs += runs - before[1]

    def _workers(self) -> list[int]:
        found = []
        for path in self._proc.glob("[0-9]*/comm"):
            try:
                if path.read_text().startswith("kworker"):
                    found.append(int(path.parent.name))
            except OSError:
                continue
        return found
