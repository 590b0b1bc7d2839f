"""The soak's table: a line for each minute, and at the end who lost what."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..demo.comparison import UNITS, Comparison
from .received import Counts
from .waits import Waits

HEAD = (
    f"{'min':>6}{'samples':>10}{'lost':>6}{'missing':>8}{'late p50':>10}{'p99':>8}{'max ms':>9}{'MB':>7}{'files':>6}"
    f"{'clients':>8}"
)


@dataclass(frozen=True)
class Losses:
    """Who lost which samples. delivered: by the sensor to the port, while the daemon had it open."""

    delivered: int
    damaged: int  # by injected faults of the line
    unread: int  # the port's buffer was full: the daemon came too late
    missing: int  # processed, but not received by the client of the stream
    internal_errors: int
    kernel_late_s: float  # most that bytes waited until the kernel had passed earlier ones on to the daemon's side
    emulator_late_ms: str = "unknown"  # of the emulator's writes: median / 99th percentile / most

    @property
    def lost(self) -> int:
        """Samples that the daemon or this machine lost."""
        return self.unread + self.missing


def losses(status: Mapping[str, Any], states: Counts, damaged: int, kernel_late_s: float) -> Losses:
    """From the daemon's last status and the messages that the emulator damaged on the inertial sensor's line.

    A damaged message may cost the one after it as well: what begins in the middle is no frame.
    """
    frames, lost = status.get("totals.frames", 0), status.get("totals.lost", 0)
    by_damage = min(lost, 2 * damaged)
    errors = status.get("internal_errors.count", 0)
    return Losses(frames + lost, by_damage, lost - by_damage, states.missing, errors, kernel_late_s)


def row(elapsed_s: float, status: Mapping[str, Any], states: Counts) -> str:
    """One interval."""
    p50, p99, longest = (1e3 * late for late in states.recent_s)
    return (
        f"{elapsed_s / 60.0:6.1f}{status.get('totals.samples', 0):10}{status.get('totals.lost', 0):6}{states.missing:8}"
        f"{p50:10.2f}{p99:8.2f}{longest:9.1f}{status['memory_bytes'] / 1e6:7.1f}{status['open_files']:6}"
        f"{status['outputs.gpsd.clients'] + status['outputs.stream.clients']:8}"
    )


def summary(
    made: Losses,
    states: Counts,
    comparison: Comparison,
    troubles: Mapping[str, int],
    memory: list[int],
    waits: Mapping[str, Waits],
) -> str:
    """The end: who lost what; lateness; memory; troubles; estimate against truth."""
    p50, p99, longest = (1e3 * late for late in states.late_s)
    lines = [
        "",
        f"{'delivered by the sensor':42}{made.delivered:10}",
        f"{'  damaged on the line by injected faults':42}{made.damaged:10}",
        f"{'  lost in the port, read too late':42}{made.unread:10}",
        f"{'  processed, but not received by a client':42}{made.missing:10}  in {states.gaps} gaps",
        f"{'longest gap between states':42}{states.longest_gap_s:10.3f} s",
        f"{'lateness, median / 99th percentile / most':42}{p50:10.2f} / {p99:.2f} / {longest:.1f} ms",
        f"{'  of it, most that the kernel held bytes back':42}{1e3 * made.kernel_late_s:8.1f} ms",
        f"{'  of it, the emulator wrote late':42}{made.emulator_late_ms:>10} ms",
        *(
            f"{f'  waiting for a processor, {name}':48}{each.mean_ms:7.3f} ms a run, {each.waited_s:.1f} s in all"
            for name, each in waits.items()
        ),
        f"{'memory, after a tenth / at the end':42}{memory[len(memory) // 10] / 1e6:10.1f} / {memory[-1] / 1e6:.1f} MB",
        f"{'internal errors':42}{made.internal_errors:10}",
        f"{'troubles':42}{', '.join(f'{count} {name}' for name, count in troubles.items())}",
        f"{'estimate against truth, RMS':30}{'error':>12}{'claimed 1σ':>12}",
    ]
    for name, errors in comparison.errors.items():
        if errors.count:
            inside = "" if errors.rms <= 2.0 * errors.claimed_rms else "  outside"
            lines.append(f"  {name:28}{errors.rms:12.3f}{errors.claimed_rms:12.3f}  {UNITS[name]}{inside}")
    verdict = f"{made.lost} samples LOST" if made.lost else "nothing that was delivered is lost"
    return "\n".join([*lines, verdict])


def lines_of_port(log: str, name: str) -> list[str]:
    """The lines of the daemon's log that are of one port."""
    return [line for line in log.splitlines() if f"/{name}" in line]
