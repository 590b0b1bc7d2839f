"""The processes of `imud demo`, `imud soak` and `imud bench`: the daemon, once it is ready, and the emulator."""

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import ImudError
from ..process.python import python_command

_RATE_HZ = 20
_END_S = 10.0  # after which a process that does not end is killed
_START_S = 3600.0  # the first start compiles the kernels, for minutes on a small or busy machine


@contextlib.contextmanager
def running_process(command: Sequence[str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A process of this command, ended with the block. options: of Popen."""
    started = subprocess.Popen(command, text=True, **options)
    try:
        yield started
    finally:
        started.send_signal(signal.SIGTERM)
        try:
            started.wait(_END_S)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()


def process(*arguments: str, **options: Any) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """`imud` with these arguments, ended with the block. options: of Popen."""
    return running_process(python_command("imud", *arguments), **options)


@contextlib.contextmanager
def daemon(
    base: Path, log: Path, environment: Mapping[str, str], *arguments: str, **options: Any
) -> Iterator[subprocess.Popen[str]]:
    """`imud run`, once it is ready. base: folder for its socket; log: where its stderr goes; options: of Popen.

    Raises ImudError if it ends instead.
    """
    path = str(base / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notifications:
        notifications.bind(path)
        with process("run", *arguments, env={**os.environ, "NOTIFY_SOCKET": path, **environment}, **options) as started:
            _wait_until_ready(notifications, started, log)
            yield started


def _wait_until_ready(notifications: socket.socket, daemon: subprocess.Popen[str], log: Path) -> None:
    """Wait for the daemon's READY=1, as a service manager does."""
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline:
        if daemon.poll() is not None:
            raise ImudError(f"the daemon ended with code {daemon.returncode}:\n{log.read_text()}")
        if select.select([notifications], [], [], 0.5)[0] and b"READY=1" in notifications.recv(4096):
            return
    raise ImudError(f"the daemon was not ready within {_START_S:.0f} s:\n{log.read_text()}")


def emulator(
    devices: Sequence[str],
    links: Sequence[Path],
    scenario: str,
    seed: int,
    faults: str,
    truth_file: Path,
    *others: str,
    **options: Any,
) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """`imud sim` of these devices at these links. others: arguments; options: of Popen."""
    chosen = ("--scenario", scenario, "--seed", str(seed), "--faults", faults, "--truth", str(truth_file))
    return process("sim", *devices, *chosen, *others, *(f"--link={link}" for link in links), **options)


def subscribe(path: Path) -> socket.socket:
    """A client of the daemon's gpsd socket that receives estimates."""
    client = socket.socket(socket.AF_UNIX)
    client.connect(str(path))
    watch = {"enable": True, "json": True, "rate": _RATE_HZ, "class": "EST"}
    client.sendall(b"?WATCH=" + json.dumps(watch).encode() + b"\n")
    return client
