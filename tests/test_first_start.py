"""A first start compiles for a minute or two. Clients are served meanwhile; however it ends, nothing is left behind."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from processes import PATIENCE_S, silent_tty

# instead of compiling, the child waits for a file; a silent line needs no kernel
WAITING = """
import sys, time
from pathlib import Path
from imud.process import runtime
runtime.prepare()
from imud import compilation
done = Path(sys.argv.pop(1))
def warm(*_):
    while not done.exists():
        time.sleep(0.02)
compilation.warm_decoders, compilation.warm = lambda *_: None, warm
from imud.__main__ import main
sys.exit(main())
"""


class Starting:
    """A daemon that compiles until `done` exists."""

    def __init__(self, folder, port, **environment):
        self.address, self.done, self._log = str(folder / "gpsd.sock"), folder / "done", folder / "log"
        command = (sys.executable, "-c", WAITING, str(self.done), "run", "--port", port, "--listen", self.address)
        self.notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.notices.bind(str(folder / "notify"))
        self.notices.settimeout(PATIENCE_S)
        environment = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify"), "NO_COLOR": "1"} | environment
        with self._log.open("w") as log:
            self.process = subprocess.Popen(command, stderr=log, env=environment)

    @property
    def log(self):
        return self._log.read_text()

    def notified(self, text):
        """Wait for a datagram with this text; returns those until then."""
        heard = [self.notices.recv(4096).decode()]
        while text not in heard[-1]:
            heard.append(self.notices.recv(4096).decode())
        return heard

    def client(self):
        """One that watches, and its lines as they come."""
        sock = socket.socket(socket.AF_UNIX)
        sock.settimeout(PATIENCE_S)
        sock.connect(self.address)
        sock.sendall(b'?WATCH={"enable":true,"json":true}\n')
        return map(json.loads, sock.makefile("rb"))

    def children(self):
        """The ids of its child processes."""
        return list(map(int, Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()))


def is_alive(process):
    """Whether there is a process with this id, and not only its exit code, which nobody has fetched yet."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.fixture
def start(tmp_path):
    """Starts a daemon on a silent line, with an empty cache, and waits until it compiles."""
    with contextlib.ExitStack() as stack:
        port = stack.enter_context(silent_tty())[1]

        def begin(**environment):
            environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")} | environment
            starting = Starting(tmp_path, f"{port}:epson@460800", **environment)
            stack.callback(starting.done.touch)  # or a child that was left behind would wait for ever
            stack.callback(starting.notices.close)
            stack.callback(starting.process.wait)
            stack.callback(starting.process.kill)
            starting.notified("STATUS=compiling")
            return starting

        yield begin


def test_clients_are_served_meanwhile(start):
    starting = start()
    client = starting.client()
    assert [next(client)["class"] for _ in range(4)] == ["VERSION", "DEVICES", "WATCH", "TPV"]
    command = (sys.executable, "-m", "imud", "status", starting.address)
    status = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "compiling for this machine" in status and "not tried yet" in status
    starting.done.touch()
    assert not any("looking for" in notice for notice in starting.notified("READY=1"))
    starting.notified("looking for")
    assert "stood still" not in starting.log
    assert next(client)["class"] == "TPV"
    assert starting.log.index(" compiling ") < starting.log.index(" ready ") < starting.log.index("looking for")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_whatever_ends_it_leaves_nothing_behind(start, number, code):
    starting = start()
    client = starting.client()
    next(client)
    (child,) = starting.children()
    starting.process.send_signal(number)
    assert starting.process.wait(PATIENCE_S) == code
    assert "Traceback" not in starting.log
    deadline = time.monotonic() + PATIENCE_S
    while is_alive(child):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    with pytest.raises(OSError), socket.socket(socket.AF_UNIX) as late:
        late.connect(starting.address)


def test_so_it_is_where_no_kernels_can_be_kept(start, tmp_path):
    passing = tmp_path / "tmp"
    passing.mkdir()
    starting = start(NUMBA_CACHE_DIR="", XDG_CACHE_HOME="/dev/null/x", TMPDIR=str(passing))
    assert next(starting.client())["class"] == "VERSION"
    assert list(passing.iterdir())
    starting.done.touch()
    starting.notified("READY=1")
    assert not list(passing.iterdir())
    assert "every start compiles anew" in starting.log and "/dev/null/x/imud" in starting.log
