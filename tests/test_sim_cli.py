"""The emulator's command line: how it ends, its links, misuse; and that it shares no code with what it tests."""

import ast
import signal
import sys
from pathlib import Path

import pytest
from sim_ports import ROOT, emulator, run, write_recording


@pytest.mark.parametrize("number, code", [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_it_ends_cleanly_and_takes_its_links_along(tmp_path, number, code):
    links = [tmp_path / "imu", tmp_path / "gps"]
    with emulator("g350", "nmea", "--link", links[0], "--link", links[1]) as (process, _):
        assert all(link.is_symlink() for link in links)
        process.send_signal(number)
        assert process.wait(60) == code
        assert "Traceback" not in process.stderr.read()
    assert list(tmp_path.iterdir()) == []


def test_seconds_end_it():
    done = run("nmea", "--seconds", "0.2")
    assert done.returncode == 0 and done.stdout.startswith("nmea /dev/pts/")


def test_an_old_link_is_replaced_and_another_ones_link_is_left(tmp_path):
    link = tmp_path / "imu"
    link.symlink_to("/dev/null")
    with emulator("g350", "--link", link) as (process, _):
        assert link.readlink() != Path("/dev/null")
        link.unlink()
        link.symlink_to("/dev/zero")
        process.terminate()
        assert process.wait(60) == 0
    assert link.readlink() == Path("/dev/zero")


@pytest.mark.parametrize(
    "arguments, code, complaint",
    [
        ([], 64, "DEVICE"),
        (["rga"], 64, "a device is g350 or nmea"),
        (["g350@1200"], 64, "one of 4800"),
        (["g350", "--scenario", "train"], 64, "invalid choice"),
        (["g350", "--gyro-bias-dps", "1,2"], 64, "three numbers"),
        (["g350", "--seconds", "nan"], 64, "time in seconds"),
        (["g350", "--seconds", "x"], 64, "'x': a time in seconds is needed"),
        (["nmea", "--rate", "10"], 64, "1 to 5 fixes"),
        (["g350", "--link", "a", "--link", "b"], 64, "more --link than devices"),
        (["g350", "g350", "--link", "a", "--link", "a"], 64, "same --link"),
        (["g350", "--loop"], 64, "--loop goes with --replay"),
        (["nmea", "--replay", "IMU"], 64, "needs a gnss.csv"),
        (["g350", "--replay", "IMU", "--truth", "t.csv"], 64, "knows no truth"),
        (["g350", "--replay", "absent.csv"], 66, "absent.csv: No such file"),
        (["g350", "--replay", "BAD"], 65, "header must be"),
        (["g350", "--link", "/absent/imu"], 73, "/absent/imu: No such file"),
        (["g350", "--link", "BAD"], 73, "exists and is not a link"),
        (["g350", "--truth", "/absent/t.csv"], 73, "/absent/t.csv: No such file"),
    ],
)
def test_misuse_is_reported_and_has_its_exit_code(tmp_path, arguments, code, complaint):
    bad = tmp_path / "bad"
    bad.write_text("not,this\n")
    names = {"IMU": write_recording(tmp_path)[0], "BAD": bad}
    done = run(*[names.get(argument, argument) for argument in arguments], "--seconds=1")
    assert done.returncode == code
    assert complaint in done.stderr and "Traceback" not in done.stderr and done.stdout == ""


def test_the_emulator_shares_no_code_with_what_it_tests():
    allowed = set(sys.stdlib_module_names) | {"numpy", "mcap", "firmware_sim"}
    for path in sorted((ROOT / "firmware_sim").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module]
            assert {name.partition(".")[0] for name in names} <= allowed, f"{path.name}:{getattr(node, 'lineno', 0)}"
