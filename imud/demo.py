"""`imud demo`: an emulator and the daemon, joined by pseudo-terminals, and the estimate against the truth.

The demo itself is only a client: it reads the daemon's gpsd socket and the emulator's truth file, nothing else.
"""

import argparse
import contextlib
import json
import math
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from firmware_sim.cli import SCENARIO_NAMES
from firmware_sim.faults import spec

from . import web
from .errors import ImudError, UsageError

_RATE_HZ = 20
_START_S = 300.0  # the first start compiles the kernels
_FRAME_S = 0.2
_SILENCE_S = 30.0
_METRES_PER_DEG = 111_320.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=_span, metavar="N", help="end after N seconds of data with a summary")
    parser.add_argument(
        "--scenario",
        choices=SCENARIO_NAMES,
        default="car",
        metavar="NAME",
        help=f"what the emulated vehicle does: {', '.join(SCENARIO_NAMES)} (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the emulated sensors' errors (default: %(default)s)")
    parser.add_argument("--faults", default="", metavar="SPEC", help="what goes wrong: see `imud sim --help`")
    parser.add_argument("--web", action="store_true", help="show it live in a browser: see `imud web`")
    parser.add_argument("--no-gnss", action="store_true", help="the inertial sensor alone: attitude only")


def _span(text: str) -> float:
    seconds = float(text)
    if not 0.0 < seconds < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}: more than 0 is needed")
    return seconds


@dataclass
class Errors:
    """Of one quantity: the squares of its errors, and those of the standard deviations that were claimed for them."""

    total: float = 0.0
    claimed: float = 0.0
    count: int = 0
    last: float = math.nan

    def add(self, error: float, *sigmas: float) -> None:
        self.last = error
        self.total += error * error
        self.claimed += sum(sigma * sigma for sigma in sigmas)
        self.count += 1

    @property
    def rms(self) -> float:
        return math.sqrt(self.total / self.count) if self.count else math.nan

    @property
    def claimed_rms(self) -> float:
        return math.sqrt(self.claimed / self.count) if self.count else math.nan


@dataclass
class Comparison:
    """Estimate against truth, quantity by quantity; what the daemon does not claim to know is not compared."""

    errors: dict[str, Errors] = field(
        default_factory=lambda: {name: Errors() for name in ("roll", "pitch", "heading", "position", "velocity")}
    )

    def add(self, est: dict[str, Any], truth: dict[str, float]) -> None:
        state = est.get("state", "")
        if "aligning" not in state:
            for name in ("roll", "pitch"):
                self.errors[name].add(_turn(est[f"{name}_deg"] - truth[f"{name}_deg"]), est[f"s{name}_deg"])
        if "heading" in state:
            self.errors["heading"].add(_turn(est["yaw_deg"] - truth["yaw_deg"]), est["syaw_deg"])
        if "position" in state:
            north = (est["lat_deg"] - truth["lat_deg"]) * _METRES_PER_DEG
            east = (est["lon_deg"] - truth["lon_deg"]) * _METRES_PER_DEG * math.cos(math.radians(truth["lat_deg"]))
            self.errors["position"].add(math.hypot(north, east), est["sn_m"], est["se_m"])
            velocities = ([d[f"v{axis}_mps"] for axis in "ned"] for d in (est, truth))
            self.errors["velocity"].add(math.dist(*velocities), *(est[f"sv{axis}_mps"] for axis in "ned"))


def _turn(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0


class Truth:
    """The emulator's truth file, read as it grows; gives the truth at a time by interpolation."""

    def __init__(self, path: Path) -> None:
        self._file = path.open()
        self._names = self._file.readline().strip().split(",")
        self._rows: list[list[float]] = []
        self._rest = ""

    def reaches(self, t_s: float) -> bool:
        """True when the truth at monotonic time t_s is written."""
        *lines, self._rest = (self._rest + self._file.read()).split("\n")
        self._rows += [[float(cell) for cell in line.split(",")] for line in lines if line]
        return bool(self._rows) and self._rows[-1][0] >= t_s

    def at(self, t_s: float) -> dict[str, float] | None:
        """The truth at t_s, which it must reach; None before its beginning. Forgets what is older."""
        while len(self._rows) > 2 and self._rows[1][0] < t_s:
            del self._rows[0]
        (t0, *before), (t1, *after) = self._rows[0], self._rows[min(1, len(self._rows) - 1)]
        if not t0 <= t_s <= t1 or t0 == t1:
            return None
        share = (t_s - t0) / (t1 - t0)
        return {
            name: a + share * (_turn(b - a) if name in ("roll_deg", "yaw_deg") else b - a)
            for name, a, b in zip(self._names[1:], before, after, strict=True)
        }


@contextlib.contextmanager
def _process(*arguments: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """An imud process that ends with the block."""
    process = subprocess.Popen([sys.executable, "-m", "imud", *arguments], text=True, **options)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_until_ready(notices: socket.socket, daemon: subprocess.Popen[str], log: Path) -> None:
    """Wait for the daemon's READY=1, as a service manager does."""
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline:
        if daemon.poll() is not None:
            raise ImudError(f"demo: the daemon ended with code {daemon.returncode}:\n{log.read_text()}")
        if select.select([notices], [], [], 0.5)[0] and b"READY=1" in notices.recv(4096):
            return
    raise ImudError(f"demo: the daemon was not ready within {_START_S:.0f} s:\n{log.read_text()}")


def _subscribe(path: Path) -> socket.socket:
    client = socket.socket(socket.AF_UNIX)
    client.connect(str(path))
    watch = {"enable": True, "json": True, "rate": _RATE_HZ, "class": "EST"}
    client.sendall(b"?WATCH=" + json.dumps(watch).encode() + b"\n")
    return client


def _estimates(client: socket.socket) -> Iterator[dict[str, Any]]:
    """EST messages as they come; an empty one for every quiet half second. Ends when the daemon closes the line."""
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


_ROWS = (
    ("roll", "roll_deg", "sroll_deg", 2, "deg"),
    ("pitch", "pitch_deg", "spitch_deg", 2, "deg"),
    ("heading", "yaw_deg", "syaw_deg", 2, "deg"),
    ("north", "vn_mps", "svn_mps", 2, "m/s"),
    ("east", "ve_mps", "sve_mps", 2, "m/s"),
    ("down", "vd_mps", "svd_mps", 2, "m/s"),
    ("latitude", "lat_deg", "sn_m", 6, "deg, σ in m"),
    ("longitude", "lon_deg", "se_m", 6, "deg, σ in m"),
)


def _screen(est: dict[str, Any], truth: dict[str, float], elapsed_s: float) -> str:
    """The live table."""
    lines = [f"{elapsed_s:7.1f} s   {est.get('state', '')}", f"{'':10}{'truth':>14}{'estimate':>14}{'±1σ':>10}"]
    for name, key, sigma, decimals, unit in _ROWS:
        value, spread = f"{est[key]:.{decimals}f}" if key in est else "-", f"{est[sigma]:.2f}" if sigma in est else "-"
        lines.append(f"{name:10}{truth[key]:14.{decimals}f}{value:>14}{spread:>10}  {unit}")
    return "\n".join(lines)


class Display:
    """The table, redrawn in place on a terminal; one line per second elsewhere."""

    def __init__(self) -> None:
        self._terminal = sys.stdout.isatty()
        self._due = 0.0
        self._drawn = 0

    def show(self, est: dict[str, Any], truth: dict[str, float], comparison: Comparison, elapsed_s: float) -> None:
        if elapsed_s < self._due:
            return
        self._due = elapsed_s + (_FRAME_S if self._terminal else 1.0)
        if self._terminal:
            text = _screen(est, truth, elapsed_s)
            print(f"\x1b[{self._drawn}A" * bool(self._drawn) + text.replace("\n", "\x1b[K\n") + "\x1b[K", flush=True)
            self._drawn = text.count("\n") + 1
        else:
            now = "  ".join(f"{name} {errors.last:+.2f}" for name, errors in comparison.errors.items() if errors.count)
            print(f"{elapsed_s:6.1f} s  {est.get('state', '')}: error {now}", flush=True)


_UNITS = {"roll": "deg", "pitch": "deg", "heading": "deg", "position": "m, horizontal", "velocity": "m/s"}


def _summary(comparison: Comparison, estimates: int, elapsed_s: float) -> str:
    lines = [
        f"\n{estimates} estimates in {elapsed_s:.1f} s. RMS error against the truth, while claimed valid:",
        f"  {'':10}{'error':>9}{'claimed 1σ':>12}",
    ]
    for name, errors in comparison.errors.items():
        known = f"{errors.rms:9.3f}{errors.claimed_rms:12.3f}  {_UNITS[name]}" if errors.count else f"{'-':>9}{'-':>12}"
        lines.append(f"  {name:10}{known}")
    return "\n".join(lines)


def run(args: argparse.Namespace) -> int:
    devices = ["g350"] if args.no_gnss else ["g350", "nmea"]
    try:
        spec.parse(args.faults, devices)
    except spec.SpecError as error:
        raise UsageError(f"--faults: {error}") from error
    if args.web:
        web.require()
    with tempfile.TemporaryDirectory(prefix="imud-demo-") as folder, contextlib.ExitStack() as stack:
        base = Path(folder)
        links = [base / name for name in devices]
        truth_file, listen, log = base / "truth.csv", base / "gpsd.sock", base / "daemon.log"
        print(
            "imud demo: starting the emulator and the daemon (a first start compiles for a minute or two)", flush=True
        )
        log_file = stack.enter_context(log.open("w"))
        notices = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        notices.bind(str(base / "notify"))
        daemon = stack.enter_context(
            _process(
                *("run", *(f"--port={link}" for link in links), f"--listen={listen}"),
                stderr=log_file,
                env={**os.environ, "NOTIFY_SOCKET": str(base / "notify")},
            )
        )
        _wait_until_ready(notices, daemon, log)
        client = stack.enter_context(_subscribe(listen))
        stack.enter_context(
            _process(
                *("sim", *devices, "--scenario", args.scenario, "--seed", str(args.seed), "--truth", str(truth_file)),
                *("--faults", args.faults),
                *(item for link in links for item in ("--link", str(link))),
                stdout=subprocess.DEVNULL,
                stderr=log_file,
            )
        )
        if args.web:
            page = ("web", "--listen=127.0.0.1:0", str(listen))
            page_process = stack.enter_context(_process(*page, stdout=subprocess.PIPE, stderr=log_file))
            _show_in_browser(page_process, log)
        return _compare(client, truth_file, args.seconds, log)


def _show_in_browser(page: subprocess.Popen[str], log: Path) -> None:
    """Print where the page is; open it where there is a screen."""
    assert page.stdout is not None
    url = page.stdout.readline().strip()
    if not url:
        raise ImudError(f"demo: the live page did not start:\n{log.read_text()}")
    print(f"imud demo: live page at {url}", flush=True)
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(url)


class Finding:
    """What became of the comparison: feeds on estimates, pairs each with the truth once that is written."""

    def __init__(self, truth_file: Path) -> None:
        self.comparison, self.estimates = Comparison(), 0
        self.first_s = self.last_s = math.nan
        self._truth_file = truth_file
        self._truth: Truth | None = None
        self._pending: list[dict[str, Any]] = []
        self._display = Display()

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
        while self._truth and self._pending and self._truth.reaches(self._pending[0]["t_mono_ns"] * 1e-9):
            old = self._pending.pop(0)
            if truth := self._truth.at(old["t_mono_ns"] * 1e-9):
                self.comparison.add(old, truth)
                self._display.show(old, truth, self.comparison, old["t_mono_ns"] * 1e-9 - self.first_s)


def _compare(client: socket.socket, truth_file: Path, seconds: float | None, log: Path) -> int:
    finding = Finding(truth_file)
    heard = time.monotonic()
    try:
        for est in _estimates(client):
            if est:
                heard = time.monotonic()
                finding.add(est)
            elif time.monotonic() - heard > _SILENCE_S:
                raise ImudError(f"demo: no estimate for {_SILENCE_S:.0f} s; the daemon says:\n{log.read_text()}")
            if seconds is not None and finding.elapsed_s >= seconds:
                break
    except KeyboardInterrupt:
        print()
    print(_summary(finding.comparison, finding.estimates, finding.elapsed_s))
    if not finding.comparison.errors["roll"].count:
        raise ImudError(f"demo: nothing could be compared; the daemon says:\n{log.read_text()}")
    return 0
