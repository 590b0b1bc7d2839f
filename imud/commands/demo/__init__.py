"""`imud demo`: an emulator and the daemon, joined by pseudo-terminals, and the estimate against the truth.

The demo itself is only a client: it reads the daemon's gpsd socket and the emulator's truth file, nothing else.
"""

import argparse
import contextlib
import importlib.util
import json
import math
import os
import select
import socket
import subprocess
import tempfile
import time
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from imud.firmware_sim.faults import spec

from ...errors import ImudError, UsageError
from ...outputs.addresses import PORT, parse_address
from ...setup import config
from .. import status, web
from ..arguments import above_zero, add_scenario, add_settings
from ..processes import daemon, emulator, process, subscribe
from .aids import DEVICES, WITHOUT_LINE, Aids
from .comparison import Comparison, Truth
from .screen import Display, summary

_SILENCE_S = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=above_zero, metavar="N", help="end after N seconds of data with a summary")
    add_scenario(parser)
    parser.add_argument("--faults", default="", metavar="SPEC", help="what goes wrong: see `imud sim --faults-help`")
    parser.add_argument(
        "--aiding",
        type=lambda text: text.split(","),
        default=[],
        metavar="NAME[,NAME..]",
        help=f"emulated sensors beside GNSS: {', '.join(DEVICES)}",
    )
    parser.add_argument("--web", action="store_true", help="show it live in a browser: see `imud web`")
    parser.add_argument("--no-gnss", action="store_true", help="the inertial sensor alone: attitude only")
    add_settings(parser)


def _estimates(client: socket.socket) -> Iterator[dict[str, Any]]:
    """EST messages as they come, an empty one for each quiet half second; ends when the daemon closes the line."""
    buffer = b""
    while True:
        if not select.select([client], [], [], 0.5)[0]:
            yield {}
            continue
        data = client.recv(65536)
        if not data:
            return
        *lines, buffer = (buffer + data).split(b"\n")
        for line in lines:
            message = json.loads(line)
            if message.get("class") == "EST":
                yield message


def run(args: argparse.Namespace) -> int:
    aids = Aids(args.aiding)
    devices = [*(["g350"] if args.no_gnss else ["g350", "nmea"]), *aids.devices]
    try:
        spec.parse(args.faults, devices)
    except spec.SpecError as error:
        raise UsageError(f"--faults: {error}") from error
    settings = config.load(args.config, args.set)  # report errors before anything starts
    if args.web:
        web.require()
    with tempfile.TemporaryDirectory(prefix="imud-demo-") as folder, contextlib.ExitStack() as stack:
        base = Path(folder)
        links = [base / name for name in devices if name not in WITHOUT_LINE]
        assignments, emulation = aids.options(base, settings.aiding.listen)
        truth_file, listen, log = base / "truth.csv", base / "gpsd.sock", base / "daemon.log"
        print("imud demo: starting the emulator and the daemon", flush=True)
        log_file = stack.enter_context(log.open("w"))
        if recordings := _recordings_folder() if args.web else None:
            assignments = [*assignments, f"record.folder={json.dumps(str(recordings))}"]
        options = [
            *(f"--port={link}{aids.driver(link.name)}" for link in links),
            *(f"--set={assignment}" for assignment in (*assignments, *args.set)),
            *((f"--config={args.config.absolute()}",) if args.config else ()),
            f"--listen={listen}",
        ]
        stack.enter_context(daemon(base, log, aids.environment(base), *options, stderr=log_file))
        client = stack.enter_context(subscribe(listen))
        drive = args.scenario, args.seed, args.faults, truth_file
        emulated = stack.enter_context(
            emulator(devices, links, *drive, *emulation, stdout=subprocess.PIPE, stderr=log_file)
        )
        _first_line(emulated, "the emulator", log)
        if args.web:
            page = process("web", "--listen=127.0.0.1:0", str(listen), stdout=subprocess.PIPE, stderr=log_file)
            _show_in_browser(stack.enter_context(page), log, recordings)
        code = _compare(client, truth_file, args.seconds, log)
        if aids.devices:
            print(aids.report(status.ask(parse_address(str(listen), PORT))))
        return code


def _recordings_folder() -> Path | None:
    """Where the page's record button may write: the current folder, if recording is installed."""
    here = Path.cwd()
    return here if importlib.util.find_spec("mcap") and os.access(here, os.W_OK) else None


def _first_line(started: subprocess.Popen[str], what: str, log: Path) -> str:
    """What a process prints once it runs, however long its start takes. Raises ImudError if it ends instead."""
    assert started.stdout is not None
    line = started.stdout.readline().strip()
    if not line:
        raise ImudError(f"demo: {what} did not start:\n{log.read_text()}")
    return line


def _show_in_browser(page: subprocess.Popen[str], log: Path, recordings: Path | None) -> None:
    """Print where the page is, and where it may record; open it where there is a screen."""
    url = _first_line(page, "the live page", log)
    print(f"imud demo: live page at {url}", flush=True)
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(url)
    if recordings:
        print(f"imud demo: its record button writes to {recordings}/imud-TIME.mcap", flush=True)


class LiveComparison:
    """The comparison so far: receives estimates, and compares each with the truth once that is written."""

    def __init__(self, truth_file: Path, display: Display | None = None) -> None:
        self.comparison, self.estimates = Comparison(), 0
        self.first_s = self.last_s = math.nan
        self._truth_file = truth_file
        self._truth: Truth | None = None
        self._pending: list[dict[str, Any]] = []
        self._display = display

    @property
    def elapsed_s(self) -> float:
        return self.last_s - self.first_s if self.estimates else 0.0

    def add(self, est: dict[str, Any]) -> None:
        self.last_s = est["t_mono_ns"] * 1e-9
        self.first_s = self.last_s if self.estimates == 0 else self.first_s
        self.estimates += 1
        self._pending.append(est)
        if self._truth is None and self._truth_file.exists() and self._truth_file.stat().st_size > 0:
            self._truth = Truth(self._truth_file)
        while self._truth and self._pending and self._truth.covers(self._pending[0]["t_mono_ns"] * 1e-9):
            old = self._pending.pop(0)
            if truth := self._truth.at(old["t_mono_ns"] * 1e-9):
                self.comparison.add(old, truth)
                if self._display:
                    self._display.show(old, truth, self.comparison, old["t_mono_ns"] * 1e-9 - self.first_s)


def _compare(client: socket.socket, truth_file: Path, seconds: float | None, log: Path) -> int:
    live = LiveComparison(truth_file, Display())
    received_s = time.monotonic()
    try:
        for est in _estimates(client):
            if est:
                received_s = time.monotonic()
                live.add(est)
            elif time.monotonic() - received_s > _SILENCE_S:
                raise ImudError(f"demo: no estimate for {_SILENCE_S:.0f} s; the daemon's log:\n{log.read_text()}")
            if seconds is not None and live.elapsed_s >= seconds:
                break
    except KeyboardInterrupt:
        print()
    print(summary(live.comparison, live.estimates, live.elapsed_s))
    if not live.comparison.errors["roll"].count:
        raise ImudError(f"demo: nothing could be compared; the daemon's log:\n{log.read_text()}")
    return 0
