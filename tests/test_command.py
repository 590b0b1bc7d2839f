"""The command before anything runs: what a check refuses, and streams that are closed or broken."""

import ast
import errno
import io
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import structlog
from processes import TIMEOUT_S, process

from imud.commands import COMMANDS, main
from imud.process import log

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--port", "/dev/x"], 0),
        (["--port", "sim:car", "--port", "sim:car:nmea"], 0),
        (["--port", "/dev/x", "--port", "/dev/x"], 64),
        (["--port", "/dev/x:toaster"], 64),
        (["--port", "sim:car:toaster"], 64),
        (["--port", "sim:cars"], 64),
        (["--port", "/dev/x", "--rtcm", "base"], 78),
        (["--port", "/dev/x", "--set", 'outputs=["guess:/tmp/x"]'], 78),
        (["--port", "/dev/x", "--estimator", "guess"], 64),
        (["--port", "/dev/x", "--listen", "0.0.0.0:0"], 78),
        (["--port", "/dev/x", "--listen", "127.0.0.1:99999"], 78),
        (["--port", "/dev/x", "--set", "nmea.udp=127.0.0.1:10110", "--set", "aiding.listen=127.0.0.1:2950"], 0),
        (["--port", "/dev/x", "--set", "nmea.udp=192.0.2.1:10110"], 78),
        (["--port", "/dev/x", "--set", "nmea.udp=192.0.2.1:10110", "--set", "nmea.allow_remote=true"], 0),
        (["--port", "/dev/x", "--set", "nmea.udp=/tmp/x"], 78),
        (["--port", "/dev/x", "--set", "aiding.listen=0.0.0.0:2950"], 78),
        (["--port", "/dev/x", "--set", "imu.mount_rpy_deg=[inf,0,0]"], 78),
    ],
)
def test_a_check_refuses_what_the_daemon_would(arguments, code, capsys):
    assert main(["run", "--check", *arguments]) == code
    said = capsys.readouterr()
    assert bool(said.err) == bool(code)
    assert said.out == ("" if code else "the configuration is valid\n")


@pytest.mark.parametrize("twice", ["tty", "by-id"])
def test_a_device_that_is_named_twice_is_refused_also_by_its_link(twice, tmp_path, capsys):
    port, link = tmp_path / "tty", tmp_path / "by-id"
    link.symlink_to(port)
    assert main(["run", "--check", "--port", str(port), "--port", str(tmp_path / twice)]) == 64
    err = capsys.readouterr().err
    assert f"port {port} is named twice" in err and (str(link) in err) == (twice == "by-id")


def test_a_check_names_each_wrong_setting_at_once(capsys):
    wrong = {"gpsd.listen": "127.0.0.1:99999", "stream.listen": "/" + 120 * "x", "nmea.udp": "nowhere"}
    wrong |= {"aiding.listen": "0.0.0.0:2950", "gnss.rtcm": "base", "record.folder": "/nonexistent"}
    settings = [word for path, text in wrong.items() for word in ("--set", f"{path}={text}")]
    assert main(["run", "--check", "--port", "/dev/x:toaster", *settings]) == 78
    _, *lines = capsys.readouterr().err.splitlines()
    assert [sum(path in line for line in lines) for path in ("toaster", *wrong)] == [1] * 7
    assert len(lines) == 7


@pytest.mark.parametrize(("name", "waiting", "code"), [("absent", "--no-wait", 69), ("", "--wait", 74)])
def test_an_invalid_port_is_reported_before_anything_is_compiled(name, waiting, code, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("imud.daemon.loop.Daemon._prepare_kernels", lambda daemon: pytest.fail("compiled"))
    port, listen = tmp_path / name, tmp_path / "gpsd.sock"
    assert main(["run", "--port", str(port), waiting, "--listen", str(listen)]) == code
    assert str(port) in capsys.readouterr().err


def test_a_hang_up_while_the_daemon_starts_has_it_read_the_configuration_again(tmp_path):
    file, listen = tmp_path / "imud.toml", tmp_path / "gpsd.sock"
    os.mkfifo(file)
    command = ("imud", "run", "--config", file, "--port", tmp_path / "absent", "--listen", listen)
    with process(*command, stderr=subprocess.PIPE) as started:
        with file.open("w") as config:  # it has begun to read
            started.send_signal(signal.SIGHUP)
            config.write("[gpsd]\nrate_hz = 5\n")
        assert any("the configuration stays as it was" in line for line in started.stderr)  # a pipe is read once
        started.send_signal(signal.SIGTERM)
        assert started.wait(TIMEOUT_S) == 0


def test_a_table_in_the_place_of_a_recording_is_told_its_option(tmp_path, capsys):
    table = tmp_path / "imu.csv"
    table.write_text("t_s,gx_radps\n")
    assert main(["replay", str(table), "-o", str(tmp_path / "est.csv")]) == 64
    assert (
        capsys.readouterr().err
        == f"imud: replay: {table} is a table: --imu {table} if it has samples, --gnss if fixes\n"
    )


@pytest.mark.parametrize("option", ["--imu", "--gnss"])
def test_a_recording_in_the_place_of_a_table_is_named_as_one(option, tmp_path, capsys):
    recording, table = tmp_path / "drive.mcap", tmp_path / "imu.csv"
    recording.write_bytes(b"\x89MCAP0\r\n")
    table.write_text("t_s,gx_radps\n")
    tables = {"--imu": table} | {option: recording}
    assert main(["replay", *(str(word) for pair in tables.items() for word in pair), "-o", "est.csv"]) == 64
    assert capsys.readouterr().err == f"imud: replay: {recording} is a recording: name it without --imu and --gnss\n"


def test_a_package_that_is_missing_is_named_with_the_extra_that_brings_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "imud.drivers.capture", None)
    monkeypatch.setattr("imud.commands._EXTRAS", {"imud.drivers.capture": "record"})
    monkeypatch.delitem(sys.modules, "imud.recording.player", raising=False)
    assert main(["export", "x.mcap", "--csv", "out"]) == 64
    assert "pip install 'imud[record]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "code"),
    [("--scenario", "moon", 64), ("--seconds", "0", 64), ("--faults", "warp=1", 64), ("--set", "estimator=moon", 78)],
)
def test_a_demo_of_nothing_is_refused_at_once(option, value, code, capsys):
    try:
        ended = main(["demo", option, value])
    except SystemExit as misuse:
        ended = misuse.code
    assert ended == code
    assert repr(value.removeprefix("estimator=")) in capsys.readouterr().err


def test_help_fits_one_screen(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    for arguments in ([], *([command] for command in COMMANDS)):
        with pytest.raises(SystemExit):
            main([*arguments, "--help"])
        lines = capsys.readouterr().out.count("\n")
        assert lines < 54, f"`imud {' '.join(arguments)} --help` has {lines} lines: shorten a text that wraps"


def test_the_commands_in_a_help_can_be_copied(monkeypatch, capsys):
    """However narrow the terminal: their lines are not wrapped."""
    monkeypatch.setenv("COLUMNS", "60")
    with pytest.raises(SystemExit):
        main(["sim", "--help"])
    shown = capsys.readouterr().out.partition("Epson on SPI:\n")[2].replace("\\\n", "")
    *variables, program, port, spi, option, setting = shlex.split(shown)
    assert [variable.partition("=")[0] for variable in variables] == ["PYTHONPATH", "IMUD_SIM"]
    assert (Path(variables[0].partition("=")[2]) / "spidev.py").exists()
    assert variables[1].endswith("g350 --scenario car")
    assert [program, port, spi, option] == ["imud", "--port", "spi:0.0", "--set"]
    assert setting == "spi.data_ready=gpiochip0:24"


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
    assert ended.stderr == "imud: output: No space left on device\n"


def test_too_few_descriptors_are_not_called_an_error_of_the_output(monkeypatch, capsys):
    def run(*_):
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr("imud.commands.reference.run", run)
    monkeypatch.setattr(os, "open", run)
    assert main(["reference"]) == 74
    assert capsys.readouterr().err == "imud: the limit of descriptors for a process (ulimit -n): Too many open files\n"


def test_of_a_full_disk_the_file_is_named(tmp_path, monkeypatch, capsys):
    """The write's own error names none."""

    def write(args):
        raise OSError(errno.ENOSPC, "Error writing bytes to file. Detail: [errno 28] No space left on device")

    real, full = os.statvfs, tmp_path / "full"
    full.mkdir()
    no_room = os.statvfs_result((4096, 4096, 10, 0, 0, 10, 10, 10, 0, 255))
    monkeypatch.setattr(os, "statvfs", lambda path: no_room if full.samefile(path) else real(path))
    monkeypatch.setattr("imud.commands.export.run", write)
    monkeypatch.setattr("imud.commands._close_output", lambda: None)  # it would be the output of the tests
    recording = str(Path(__file__).parent / "corpus" / "recordings" / "json.mcap")
    assert main(["export", recording, "--gpx", str(tmp_path / "track.gpx"), "--csv", str(full / "tables")]) == 74
    assert capsys.readouterr().err == f"imud: {full / 'tables'}: No space left on device\n"


class Broken(io.StringIO):
    def write(self, text):
        raise BrokenPipeError


def test_a_log_without_a_reader_does_no_harm(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Broken())
    log.configure()
    try:
        structlog.get_logger().warning("lost")
    finally:
        structlog.reset_defaults()


@pytest.mark.parametrize("program", ["imud", "firmware_sim"])
def test_nothing_heavy_is_loaded_before_signals_are_met(program):
    module = ast.parse((ROOT / program / "__main__.py").read_text())
    imported = {alias.name for node in module.body if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in module.body if isinstance(node, ast.ImportFrom)}
    assert imported <= {"argparse", "os", "signal", "sys", "types", "typing"}


def catches(pid: int, number: int) -> bool:
    status = Path(f"/proc/{pid}/status").read_text()
    (caught,) = (int(line.split()[1], 16) for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(caught >> (number - 1) & 1)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("imud", "run", "--port", "/dev/absent"), 0),
        (("imud", "--port", "sim:car"), 0),
        (("imud", "replay", "/absent"), 143),
        (("firmware_sim", "g350"), 0),
    ],
)
def test_a_start_can_be_ended_at_once(arguments, code, tmp_path):
    with (tmp_path / "log").open("w") as log, process(*arguments, stdout=log, stderr=log) as running:
        while not catches(running.pid, signal.SIGTERM):
            assert running.poll() is None
            time.sleep(0.001)
        running.send_signal(signal.SIGTERM)
        assert running.wait(TIMEOUT_S) == code
    assert "Traceback" not in (tmp_path / "log").read_text()
