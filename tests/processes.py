"""Emulator and daemon as processes of their own, and a client of the daemon's socket, for the end-to-end tests."""

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from pathlib import Path

from imud.commands.processes import running_process

START_S = 900.0  # kernels may have to be compiled first, on a busy machine
# before a command: permissions hold for it even if we are root, as in a container
OBEYING = ("setpriv", "--bounding-set=-all", "--inh-caps=-all") if os.geteuid() == 0 else ()
TIMEOUT_S = 120.0  # like all limits here: against hanging, not to be measured by


def process(*arguments: str, **options) -> contextlib.AbstractContextManager[subprocess.Popen]:
    """`python -m …`, ended with the block."""
    return running_process([sys.executable, "-m", *arguments], **options)


@contextlib.contextmanager
def emulator(*arguments: str, links: list[Path]) -> Iterator[subprocess.Popen]:
    """`imud sim` with its pseudo-terminals linked and ready."""
    linked = [item for link in links for item in ("--link", str(link))]
    with process("imud.firmware_sim", *arguments, *linked, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        for _ in links:
            assert running.stdout.readline(), running.stderr.read()
        yield running


class Daemon:
    """A running daemon: its process, its log and a client of its socket."""

    def __init__(self, running: subprocess.Popen, folder: Path) -> None:
        self.process, self._folder = running, folder
        self.client: socket.socket | None = None
        self._buffer = b""

    @property
    def log(self) -> str:
        return (self._folder / "daemon.log").read_text()

    def connect(self) -> None:
        self.client = socket.socket(socket.AF_UNIX)
        self.client.connect(str(self._folder / "gpsd.sock"))
        self.client.sendall(b'?WATCH={"enable":true,"json":true,"rate":20}\n')

    def messages(self, seconds: float) -> Iterator[dict]:
        """Messages as they come, for at most so long."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0:
            if not select.select([self.client], [], [], left)[0]:
                return
            data = self.client.recv(65536)
            assert data, self.log
            *lines, self._buffer = (self._buffer + data).split(b"\n")
            yield from map(json.loads, lines)

    def until(self, accept, seconds: float = TIMEOUT_S) -> dict:
        """The first message that `accept` takes."""
        last = {}
        for message in self.messages(seconds):
            last[message["class"]] = message
            if accept(message):
                return message
        raise AssertionError(f"not seen within {seconds} s; last {last}; the daemon said:\n{self.log}")

    def comes_at(self, rate_hz: float, share: float) -> None:
        """Wait until states are numbered and stamped at that rate, within a share, for two seconds."""
        seen: list[tuple[int, int]] = []

        def reached(message: dict) -> bool:
            if message["class"] != "EST":
                return False
            seen.append((message["seq"], message["t_mono_ns"]))
            while len(seen) > 2 and seen[-1][1] - seen[1][1] > 2_000_000_000:
                del seen[0]
            (first, begin_ns), (last, end_ns) = seen[0], seen[-1]
            if end_ns - begin_ns <= 2_000_000_000:
                return False
            return abs((last - first) / (end_ns - begin_ns) * 1e9 / rate_hz - 1.0) < share

        self.until(reached)

    def says(self, text: str, seconds: float = TIMEOUT_S) -> None:
        """Wait until the log holds `text`."""
        deadline = time.monotonic() + seconds
        while text not in self.log:
            assert self.process.poll() is None, self.log
            assert time.monotonic() < deadline, f"{text!r} not logged:\n{self.log}"
            time.sleep(0.05)


@contextlib.contextmanager
def daemon(folder: Path, *arguments: str) -> Iterator[Daemon]:
    """`imud run` with its socket in `folder`, connected."""
    with (folder / "daemon.log").open("w") as log:
        own = {"XDG_RUNTIME_DIR": str(folder / "run"), "NO_COLOR": "1"}
        env = {"XDG_STATE_HOME": str(folder / "state"), **os.environ, **own}
        command = ("imud", "run", *arguments, "--listen", str(folder / "gpsd.sock"))
        with process(*command, stderr=log, env=env) as running:
            started = Daemon(running, folder)
            started.says(" ready ", START_S)
            started.connect()
            with started.client:
                yield started


@contextlib.contextmanager
def silent_tty() -> Iterator[tuple[int, str]]:
    """A pseudo-terminal that says nothing: its master and the slave's path."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        yield master, os.ttyname(slave)
    finally:
        os.close(master)
        os.close(slave)


def is_settled(message):
    """Whether it is an estimate of attitude and gyro bias."""
    return message["class"] == "EST" and "aligning" not in message["state"] and message.get("sbgx_dps", 1.0) < 0.1
