"""Inertial sensors of the kernel through the daemon, on an emulated sysfs, with faults; recorded and replayed."""

import os
import re
import subprocess
import sys

import pytest
from processes import daemon, process

TILTED = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5", "--ideal")


def kernel(folder, *words):
    return process("imud.firmware_sim", *words, "--iio-root", str(folder), stdout=subprocess.PIPE)


def tilt_of(imud, after_ns=0):
    est = imud.until(lambda m: m["class"] == "EST" and m["state"] == "attitude" and m["t_mono_ns"] > after_ns)
    assert est["roll_deg"] == pytest.approx(10.0, abs=3.0 * est["sroll_deg"])
    assert est["pitch_deg"] == pytest.approx(-5.0, abs=3.0 * est["spitch_deg"])
    return est


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch):
    monkeypatch.setenv("IMUD_IIO_ROOT", str(tmp_path / "iio"))
    return tmp_path / "iio"


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("chip", "rate_hz"), [("bmi160", 800.0), ("lsm6dso", 833.0), ("adis16505-2", 1000.0), ("swapped", 500.0)]
)
def test_each_kind_of_device_gives_the_true_tilt(tmp_path, root, chip, rate_hz):
    with kernel(root, chip, *TILTED) as running:
        assert running.stdout.readline()
        with daemon(tmp_path, "--port", f"iio:{chip}") as imud:
            tilt_of(imud)
            imud.comes_at(rate_hz, 0.05)


@pytest.mark.thorough
def test_a_device_that_is_unplugged_and_scans_that_are_lost(tmp_path, root):
    with daemon(tmp_path, "--port", "iio:lsm6dso") as imud:
        imud.says("no IIO device 'lsm6dso'")
        with kernel(root, "lsm6dso", *TILTED, "--faults", "overflow=300@5,unplug@9-11") as running:
            assert running.stdout.readline()
            before = tilt_of(imud)
            imud.says("was it removed?")
            after = tilt_of(imud, before["t_mono_ns"] + 8_000_000_000)
        assert after["seq"] > before["seq"]
    lost = int(re.search(r" ended .*lost=(\d+)", imud.log)[1])
    assert 300 <= lost < 3000, imud.log


@pytest.mark.thorough
def test_a_trigger_that_is_lost_and_comes_back(tmp_path, root):
    with kernel(root, "bmi160", *TILTED, "--faults", "trigger@8-13") as running:
        assert running.stdout.readline()
        with daemon(tmp_path, "--port", "iio:bmi160", "--set", "imu.rate_hz=200") as imud:
            before = tilt_of(imud)
            imud.says("sends nothing more of use")
            imud.says("it has no trigger")
            tilt_of(imud, before["t_mono_ns"] + 8_000_000_000)


@pytest.mark.thorough
def test_a_recording_replays(tmp_path, root):
    file = tmp_path / "drive.mcap"
    with kernel(root, "lsm6dso", *TILTED) as running:
        assert running.stdout.readline()
        with daemon(tmp_path, "--port", "iio:lsm6dso", "--record", str(file)) as imud:
            tilt_of(imud)
            imud.comes_at(833.0, 0.05)
    states = tmp_path / "states.csv"
    command = [sys.executable, "-m", "imud", "replay", str(file), "-o", str(states)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "NO_COLOR": "1"})
    assert ended.returncode == 0, ended.stderr
    header, *rows = (line.split(",") for line in states.read_text().splitlines())
    assert len(rows) > 1000
    assert float(rows[-1][header.index("roll_deg")]) == pytest.approx(10.0, abs=0.1)
