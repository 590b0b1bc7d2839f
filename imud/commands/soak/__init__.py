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

from imud.firmware_sim.cli import SCENARIO_NAMES
from imud.firmware_sim.faults import spec

from ...errors import ImudError, UsageError
from ..arguments import above_zero, seed

if TYPE_CHECKING:
    from .received import Counts, EstimateReader, StreamReader
    from .table import Losses
    from .troubles import Troubles

FAULTS = "imu:unplug@40-43/150,reset@100/150;gnss:unplug@70-75/150,loss@120-130/150"
_DEVICES = ("g350", "nmea")
_STATUS_S, _ROW_S = 5.0, 60.0
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
    parser.add_argument(
        "--scenario",
        choices=SCENARIO_NAMES,
        default="car",
        metavar="NAME",
        help=f"{', '.join(SCENARIO_NAMES)} (default car)",
    )
    parser.add_argument("--seed", type=seed, default=1, metavar="N", help="of the sensors' errors (default: 1)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the daemon")


def run(args: argparse.Namespace) -> int:
    try:
        spec.parse(args.faults, _DEVICES)
    except spec.SpecError as error:
        raise UsageError(f"--faults: {error}") from error
    with tempfile.TemporaryDirectory(prefix="imud-soak-") as folder, contextlib.ExitStack() as stack:
        return _soak(args, Path(folder), stack)


def _soak(args: argparse.Namespace, base: Path, stack: contextlib.ExitStack) -> int:
    from ..demo.processes import daemon, emulator, subscribe
    from . import table
    from .received import EstimateReader, StreamReader, status_of, take_priority_of
    from .troubles import CONFIGURATION, StalledClients, Troubles, WallClock, require_ended_well
    from .waits import ProcessorWaits

    links = [base / name for name in _DEVICES]
    gpsd, stream, log = base / "gpsd.sock", base / "stream", base / "daemon.log"
    settings, truth_file, emulator_log = base / "soak.toml", base / "truth.csv", base / "emulator.log"
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
    logs = [stack.enter_context(path.open("w")) for path in (log, emulator_log)]
    session: dict[str, Any] = {"start_new_session": True}  # as a service: each has its share (sched(7), autogroup)
    served = stack.enter_context(daemon(base, log, environment, *options, stderr=logs[0], **session))
    reader = stack.enter_context(contextlib.closing(StreamReader(stream)))
    estimates = EstimateReader(stack.enter_context(subscribe(gpsd)), truth_file)
    drive = args.scenario, args.seed, args.faults, truth_file
    emulated = stack.enter_context(
        emulator(_DEVICES, links, *drive, stdout=subprocess.DEVNULL, stderr=logs[1], **session)
    )
    for pid in (emulated.pid, reader.pid):
        take_priority_of(served.pid, pid)
    clients = stack.enter_context(contextlib.closing(StalledClients(gpsd, stream)))
    troubles = Troubles(served, clients, clock, settings, min(args.minutes / _CALM_MINUTES, 1.0))
    print(table.HEAD, flush=True)
    memory: list[int] = []
    waits = ProcessorWaits({"daemon": served.pid, "emulator": emulated.pid, "client": reader.pid})
    row_s = _ROW_S
    with contextlib.suppress(KeyboardInterrupt):
        for elapsed_s in _turns(60.0 * args.minutes, reader, estimates, troubles):
            clients.flood()
            require_ended_well(served, log)
            status = status_of(gpsd)
            memory.append(status["memory_bytes"])
            waits.update()
            if elapsed_s >= row_s:
                row_s += _ROW_S
                print(table.row(elapsed_s, status, reader.counts()), flush=True)
    if memory:  # the rest of a minute, or a short run's only line
        print(table.row(elapsed_s, status, reader.counts()), flush=True)
    emulated.send_signal(signal.SIGTERM)
    emulated.wait(10.0)
    end_s = time.monotonic() + _SETTLE_S
    while time.monotonic() < end_s:
        _wait(estimates, 0.1)
    states = reader.counts()
    if not states.count:
        raise ImudError(f"soak: no state came; the daemon's log:\n{log.read_text()[-3000:]}")
    made = _losses(status_of(gpsd), states, emulator_log.read_text())
    print(table.summary(made, states, estimates.comparison, troubles.counts, memory, waits.waits))
    if states.longest_gap_s > _LONG_GAP_S:
        print("\nof the daemon's log, as the sensor was away for long:")
        print(*table.lines_of_port(log.read_text(), "g350"), sep="\n")
    return 1 if made.lost or made.internal_errors else 0


def _losses(status: dict[str, Any], states: "Counts", emulated: str) -> "Losses":
    """Who lost what. emulated: the emulator's log."""
    from . import table

    damaged, waited, written = (each.search(emulated) for each in (_DAMAGED, _WAITED, _WRITTEN))
    made = table.losses(status, states, int(damaged[1]) if damaged else 0, float(waited[1]) if waited else 0.0)
    return replace(made, emulator_late_ms=written[1]) if written else made


def _turns(seconds: float, reader: "StreamReader", estimates: "EstimateReader", troubles: "Troubles") -> Any:
    """Receive, and let the troubles happen; yields the time since the first state when a look at the status is due."""
    begin_s = time.monotonic()
    while not reader.counts().count and time.monotonic() - begin_s < _FIRST_STATE_S:
        _wait(estimates, 0.1)
    begin_s = time.monotonic()
    look_s = 0.0
    while (elapsed_s := time.monotonic() - begin_s) < seconds:
        troubles.on_time(elapsed_s)
        if elapsed_s >= look_s:
            look_s += _STATUS_S
            yield elapsed_s
        _wait(estimates, min(look_s, troubles.due_s, seconds) - elapsed_s)


def _wait(estimates: "EstimateReader", seconds: float) -> None:
    if select.select([estimates.fileno()], [], [], max(seconds, 0.0))[0]:
        estimates.read()
