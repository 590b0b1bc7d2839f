"""The command before anything runs: what a check refuses, and streams that are closed or broken."""

import io
import subprocess
import sys
from pathlib import Path

import pytest
import structlog

from imud import log
from imud.__main__ import main


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--port", "/dev/x"], 0),
        (["--port", "sim:car", "--port", "sim:car:nmea"], 0),
        (["--port", "/dev/x", "--port", "/dev/x"], 64),
        (["--port", "/dev/x:toaster"], 64),
        (["--port", "/dev/x", "--estimator", "guess"], 64),
        (["--port", "/dev/x", "--listen", "0.0.0.0:0"], 78),
        (["--port", "/dev/x", "--listen", "127.0.0.1:99999"], 78),
        (["--port", "/dev/x", "--set", "imu.mount_rpy_deg=[inf,0,0]"], 78),
    ],
)
def test_a_check_refuses_what_the_daemon_would(arguments, code, capsys):
    assert main(["run", "--check", *arguments]) == code
    assert bool(capsys.readouterr().err) == bool(code)


@pytest.mark.parametrize("arguments", [["--scenario", "moon"], ["--seconds", "0"], ["--faults", "warp=1"]])
def test_a_demo_of_nothing_is_misuse_at_once(arguments, capsys):
    try:
        code = main(["demo", *arguments])
    except SystemExit as ended:
        code = ended.code
    assert code == 64
    assert repr(arguments[1]) in capsys.readouterr().err


def test_closed_streams_change_no_exit_code():
    command = [sys.executable, "-m", "imud", "run", "--check", "--port", "/dev/x:toaster"]
    closed = subprocess.run(["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *command], check=False)
    assert closed.returncode == 64


@pytest.mark.parametrize("arguments", [["reference"], ["probe", "/dev/null"]])  # much; little
def test_a_full_disk_is_an_error_of_input_and_output(arguments):
    with Path("/dev/full").open("wb") as full:
        command = [sys.executable, "-m", "imud", *arguments]
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == 74
    assert ended.stderr == "imud: [Errno 28] No space left on device\n"


class Broken(io.StringIO):
    def write(self, text):
        raise BrokenPipeError


def test_a_log_that_nobody_reads_does_no_harm(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Broken())
    log.configure()
    try:
        structlog.get_logger().warning("lost")
    finally:
        structlog.reset_defaults()
