"""`imud soak`: for minutes, emulated devices and the daemon, with everything that goes wrong in a long run.

The sensor is unplugged and restarts, the receiver loses its fix, clients stall, the disk of the recording is full, the
configuration is read again, the wall clock jumps. The table shows what the sensor delivered and who lost it. Exit code
1 if anything that was delivered is lost.
"""

import argparse
import contextlib
import json
import re
import select
import signal
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imud.firmware_sim.faults import spec

from ...errors import ImudError, UsageError
from ...outputs.addresses import PORT, parse_address
from .. import status
from ..arguments import above_zero, add_scenario

if TYPE_CHECKING:
    from .received import Counts, EstimateReader, StreamReader
    from .table import Losses
    from .troubles import Troubles

FAULTS = "imu:unplug@40-43/150,reset@100/150;gnss:unplug@70-75/150,loss@120-130/150"
_DEVICES = ("g350", "nmea")
_STATUS_S, _ROW_S = 5.0, 60.0
_TIMEOUT_S = 10.0  # of the status
_CALM_MINUTES = 3.0  # a shorter run has its troubles in quicker succession
_FIRST_STATE_S = 60.0
_LONG_GAP_S = 8.0  # a sensor that is unplugged for 3 s streams within 6 s
_SETTLE_S = 2.0  # after the end, for what is under way
_DAMAGED = re.compile(r"g350: \d+ messages sent, (\d+) of them damaged")
_WRITTEN = re.compile(r"g350: written late by ([\d./ ]+) ms")
_WAITED = re.compile(r"g350: bytes waited for the kernel for up to ([\d.]+) s")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--minutes", type=above_zero, default=10.0, metavar="N", help="how long (default: 10)")
    parser.add_argument(
        "--faults",
        default=FAULTS,
        metavar="SPEC",
        help="of the devices: see `imud sim --faults-help` (default: unplugs, restarts, no fix)",
    )
    add_scenario(parser)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the daemon")


def run(args: argparse.Namespace) -> int:
    try:
        spec.parse(args.faults, _DEVICES)
    except spec.SpecError as error:
        raise UsageError(f"--faults: {error}") from error
    with tempfile.TemporaryDirectory(prefix="imud-soak-") as folder, contextlib.ExitStack() as stack:
        soak = _Soak(args, Path(folder), stack)
        soak.watch(60.0 * args.minutes)
        return soak.end()


class _Soak:
    """The daemon, the emulator and the clients of one run."""

    def __init__(self, args: argparse.Namespace, base: Path, stack: contextlib.ExitStack) -> None:
        """Start them. base: the folder for their sockets, logs and settings."""
        from ..processes import daemon, emulator, subscribe
        from .received import EstimateReader, StreamReader, take_priority_of
        from .troubles import CONFIGURATION, StalledClients, Troubles, WallClock
        from .waits import ProcessorWaits

        links = [base / name for name in _DEVICES]
        gpsd, stream, truth_file, settings = (base / name for name in ("gpsd", "stream", "truth.csv", "soak.toml"))
        self._address = parse_address(str(gpsd), PORT)
        self._daemon_log, self._emulator_log = base / "daemon.log", base / "emulator.log"
        settings.write_text(CONFIGURATION.format(10))
        chosen = [f"stream.listen={json.dumps(str(stream))}", f"record.path={json.dumps(str(base / 'soak.mcap'))}"]
        chosen += ["record.budget_mb=500", "record.file_mb=100", *args.set]
        clock = WallClock(base)
        print(f"imud soak: {args.minutes:g} min, faults {args.faults or 'none'}", flush=True)
        if clock.missing:
            print(f"imud soak: no clock steps: {clock.missing}", flush=True)
        environment = {"XDG_RUNTIME_DIR": str(base), "XDG_STATE_HOME": str(base), **clock.environment}
        options = [*(f"--port={link}" for link in links), *(f"--set={assignment}" for assignment in chosen)]
        options += [f"--listen={gpsd}", f"--config={settings}"]
        logs = [stack.enter_context(path.open("w")) for path in (self._daemon_log, self._emulator_log)]
        session: dict[str, Any] = {"start_new_session": True}  # as a service: each its share (sched(7), autogroup)
        self._daemon = stack.enter_context(
            daemon(base, self._daemon_log, environment, *options, stderr=logs[0], **session)
        )
        self._reader = stack.enter_context(contextlib.closing(StreamReader(stream)))
        self._estimates = EstimateReader(stack.enter_context(subscribe(gpsd)), truth_file)
        drive = args.scenario, args.seed, args.faults, truth_file
        self._emulator = stack.enter_context(
            emulator(_DEVICES, links, *drive, stdout=subprocess.DEVNULL, stderr=logs[1], **session)
        )
        pids = {"daemon": self._daemon.pid, "emulator": self._emulator.pid, "client": self._reader.pid}
        for name in ("emulator", "client"):
            take_priority_of(pids["daemon"], pids[name])
        self._clients = stack.enter_context(contextlib.closing(StalledClients(gpsd, stream)))
        pace = min(args.minutes / _CALM_MINUTES, 1.0)
        self._troubles = Troubles(self._daemon, self._clients, clock, settings, pace)
        self._waits = ProcessorWaits(pids)
        self._memory: list[int] = []

    def watch(self, seconds: float) -> None:
        """Let it run, with its troubles, and print a row a minute."""
        from . import table
        from .troubles import require_ended_well

        print(table.HEAD, flush=True)
        row_s = _ROW_S
        with contextlib.suppress(KeyboardInterrupt):
            for elapsed_s in _turns(seconds, self._reader, self._estimates, self._troubles):
                self._clients.flood()
                require_ended_well(self._daemon, self._daemon_log)
                answer = status.ask(self._address, _TIMEOUT_S)
                self._memory.append(answer["memory_bytes"])
                self._waits.update()
                if elapsed_s >= row_s:
                    row_s += _ROW_S
                    print(table.row(elapsed_s, answer, self._reader.counts()), flush=True)
        if self._memory:  # the rest of a minute, or a short run's only line
            print(table.row(elapsed_s, answer, self._reader.counts()), flush=True)

    def end(self) -> int:
        """End the emulator, and print who has lost what; the exit code. Raises ImudError."""
        from . import table

        self._emulator.send_signal(signal.SIGTERM)
        self._emulator.wait(10.0)
        end_s = time.monotonic() + _SETTLE_S
        while time.monotonic() < end_s:
            _wait(self._estimates, 0.1)
        states, log = self._reader.counts(), self._daemon_log.read_text()
        if not states.count:
            raise ImudError(f"soak: no state came; the daemon's log:\n{log[-3000:]}")
        made = _losses(status.ask(self._address, _TIMEOUT_S), states, self._emulator_log.read_text())
        counts = self._troubles.counts
        print(table.summary(made, states, self._estimates.comparison, counts, self._memory, self._waits.waits))
        if states.longest_gap_s > _LONG_GAP_S:
            print("\nof the daemon's log, as the sensor was away for long:")
            print(*table.lines_of_port(log, "g350"), sep="\n")
        return 1 if made.lost or made.internal_errors else 0


def _losses(answer: dict[str, Any], states: "Counts", emulated: str) -> "Losses":
    """Who lost what. answer: the daemon's last status; emulated: the emulator's log."""
    from . import table

    damaged, waited, written = (each.search(emulated) for each in (_DAMAGED, _WAITED, _WRITTEN))
    made = table.losses(answer, states, int(damaged[1]) if damaged else 0, float(waited[1]) if waited else 0.0)
    return replace(made, emulator_late_ms=written[1]) if written else made


def _turns(seconds: float, reader: "StreamReader", estimates: "EstimateReader", troubles: "Troubles") -> Any:
    """Receive, and let the troubles happen; yields the time since the first state when the status is due."""
    begin_s = time.monotonic()
    while not reader.counts().count and time.monotonic() - begin_s < _FIRST_STATE_S:
        _wait(estimates, 0.1)
    begin_s = time.monotonic()
    status_due_s = 0.0
    while (elapsed_s := time.monotonic() - begin_s) < seconds:
        troubles.on_time(elapsed_s)
        if elapsed_s >= status_due_s:
            status_due_s += _STATUS_S
            yield elapsed_s
        _wait(estimates, min(status_due_s, troubles.due_s, seconds) - elapsed_s)


def _wait(estimates: "EstimateReader", seconds: float) -> None:
    if select.select([estimates.fileno()], [], [], max(seconds, 0.0))[0]:
        estimates.read()
