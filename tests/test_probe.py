"""`imud probe` on emulated devices and on none."""

import json
import os
import subprocess
import sys

from processes import emulator, silent_tty


def probe(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "imud", "probe", *map(str, arguments)], capture_output=True, text=True, check=False,
        env={**os.environ, "NO_COLOR": "1"},
    )  # fmt: skip


def test_devices_and_baud_rates_are_found(tmp_path):
    imu, gnss = tmp_path / "imu", tmp_path / "gnss"
    with emulator("g350@230400", "nmea@4800", links=[imu, gnss]):
        ended = probe("--json", imu, gnss)
    assert ended.returncode == 0, ended.stderr
    first, second = map(json.loads, ended.stdout.splitlines())
    assert (first["driver"], first["model"], first["baud"]) == ("epson", "M-G350", 230400)
    assert (second["driver"], second["baud"]) == ("nmea", 4800)


def test_silence_and_absence_are_distinguished(tmp_path):
    with silent_tty() as (_, path):
        ended = probe(path, tmp_path / "absent")
    assert ended.returncode == 69
    silent, absent = ended.stdout.splitlines()
    assert "silent" in silent
    assert "there is no" in absent


def test_an_unknown_driver_is_a_usage_error():
    ended = probe("/dev/null:toaster")
    assert ended.returncode == 64
    assert "toaster" in ended.stderr
