"""Programs and modules of the machine that are clients of gpsd, and what they show of the synthetic vehicle.

What is not there skips the test that asks for it.
"""

import contextlib
import fcntl
import json
import math
import os
import pty
import select
import shutil
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pyte
import pytest
from gpsd_synthetic import LAT_DEG, LON_DEG, RADIUS_M
from processes import TIMEOUT_S

SYSTEM_PYTHON = "/usr/bin/python3"  # where Debian's python3-gps is
PY_GPS = """
import gps, json
session = gps.gps(host="127.0.0.1", port="{port}", mode=gps.WATCH_ENABLE | gps.WATCH_NEWSTYLE)
kinds = []
while len(kinds) < 9:
    if session.read() == -1:
        break
    if session.data:
        kinds.append(session.data["class"])
fix = session.fix
print(json.dumps([kinds, fix.mode, fix.latitude, fix.longitude, fix.altHAE, fix.speed]))
"""


def program(name: str) -> str:
    path = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/bin")
    if path is None:
        pytest.skip(f"{name} is not installed (Debian: gpsd, gpsd-clients)")
    return path


def run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=True).stdout


def on_the_circle(lat: float, lon: float) -> bool:
    """Within a decimetre of the synthetic vehicle's path; a second of arc of latitude is 30.9 m."""
    north = (lat - LAT_DEG) * 3600.0 * 30.887
    east = (lon - LON_DEG) * 3600.0 * 30.922 * math.cos(math.radians(LAT_DEG)) * 1.0018
    return math.hypot(north, east) == pytest.approx(RADIUS_M, abs=0.2)


def until(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < end, f"in vain: {what}"
        time.sleep(0.05)


@contextlib.contextmanager
def terminal(*command: str) -> Iterator[Callable[[], str]]:
    """A program in a pseudo-terminal; yields a function that reads its screen as a person would."""
    pid, fd = pty.fork()
    if pid == 0:
        os.environ.update(TERM="xterm", LINES="40", COLUMNS="130")
        os.execv(command[0], command)
    fcntl.ioctl(fd, termios.TIOCSWINSZ, struct.pack("4H", 40, 130, 0, 0))
    display = pyte.Screen(130, 40)
    stream = pyte.ByteStream(display)

    def screen() -> str:
        while select.select([fd], [], [], 0)[0]:
            try:
                stream.feed(os.read(fd, 65536))
            except OSError:  # the program has ended
                break
        return "\n".join(display.display)

    try:
        yield screen
    finally:
        os.kill(pid, 15)
        os.waitpid(pid, 0)
        os.close(fd)


def py_gps(address: str) -> list:
    probe = [SYSTEM_PYTHON, "-c", "import gps"]
    if not Path(SYSTEM_PYTHON).exists() or subprocess.run(probe, capture_output=True, check=False).returncode:
        pytest.skip("no Python module gps (Debian: python3-gps)")
    return json.loads(run(SYSTEM_PYTHON, "-c", PY_GPS.format(port=address.rpartition(":")[2])))
