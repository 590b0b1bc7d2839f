"""Emulated sensors on SPI and the daemon, end to end: stand-ins for spidev and gpiod on PYTHONPATH, all else real."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from processes import TIMEOUT_S, daemon, is_settled

ROOT = Path(__file__).resolve().parents[1]
STAND_IN = ROOT / "firmware_sim" / "stand_in"
REST = "--scenario rest --roll-deg 10 --pitch-deg -5 --accel-bias-mg 0,0,0 --gyro-bias-dps 0.05,-0.05,0.05"
CALM = "imu.rate_hz=250"  # that a loaded machine keeps up with


@pytest.fixture
def bench(monkeypatch):
    """Sets the emulated sensors of the processes to come."""
    path = os.pathsep.join(filter(None, [str(ROOT), str(STAND_IN), os.environ.get("PYTHONPATH")]))
    monkeypatch.setenv("PYTHONPATH", path)
    return lambda devices: monkeypatch.setenv("IMUD_SIM", devices)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("device", "model", "settings"),
    [("g350", "M-G350", ["--set", "spi.data_ready=gpiochip0:24"]), ("g370", "M-G370PDF1", [])],
)
def test_attitude_of_a_still_sensor(tmp_path, bench, device, model, settings):
    bench(f"{device} {REST}")
    with daemon(tmp_path, "--port", "spi:0.0", "--set", CALM, *settings) as imud:
        est = imud.until(is_settled)
        assert est["roll_deg"] == pytest.approx(10.0, abs=0.3)
        assert est["pitch_deg"] == pytest.approx(-5.0, abs=0.3)
        later = imud.until(lambda m: m["class"] == "EST" and m["t_mono_ns"] > est["t_mono_ns"] + 2_000_000_000)
        rate = (later["seq"] - est["seq"]) / (later["t_mono_ns"] - est["t_mono_ns"]) * 1e9
        assert 50.0 < rate < 255.0  # none twice; what else the machine does may cost some
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
        assert model in imud.log
        assert "broken rules: none" in imud.log
        assert " bad=0 " in imud.log
        assert "no edges" not in imud.log


def run(*arguments):
    command = [sys.executable, "-m", "imud", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_probe_names_the_sensors_of_a_bus(bench):
    bench("g365 g350 --no-identity")
    result = run("probe", "spi:0.0", "spi:0.1", "--json")
    first, second = map(json.loads, result.stdout.splitlines())
    assert (first["model"], first["serial"], first["spi"]) == ("M-G365PDF1", "W0000042", True)
    assert (second["model"], second["serial"]) == ("M-G350", "")
    assert "--port spi:0.0:epson\n" in run("probe", "spi:0.0").stdout
    absent = run("probe", "spi:0.2")
    assert absent.returncode == 69
    assert "raspi-config" in absent.stdout


def test_a_missing_package_ends_the_daemon_though_it_would_wait(tmp_path, monkeypatch):
    (tmp_path / "spidev.py").write_text("raise ImportError")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    ended = run("run", "--port", "spi:0.0", "--listen", str(tmp_path / "socket"))
    assert (ended.returncode, ended.stdout) == (69, "")
    assert "pip install 'imud[spi]'" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("--port", "spi:0"), 64, "spi:BUS.DEVICE"),
        (("--port", "spi:0.0", "--set", "spi.data_ready=24"), 78, "spi.data_ready"),
        (("--port", "spi:0.7", "--no-wait"), 69, "/dev/spidev0.7"),
    ],
)
def test_exit_codes(tmp_path, bench, arguments, code, says):
    bench("g350")
    ended = run("run", *arguments, "--listen", str(tmp_path / "socket"))
    assert (ended.returncode, ended.stdout) == (code, "")
    assert says in ended.stderr
    assert "Traceback" not in ended.stderr
