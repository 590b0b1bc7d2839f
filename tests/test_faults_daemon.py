"""Faults as the daemon meets them: plugs pulled, a sensor that boots again, damaged frames; and emulated ports."""

import json
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest
from processes import TIMEOUT_S, daemon, emulator
from recorded import replayed, stored

from imud.drivers.capture import Capture
from imud.drivers.capture_messages import CONNECTIONS, Connection
from imud.recording.messages import ESTIMATE_TABLE
from imud.recording.source import Recording

REST = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5", "--gyro-bias-dps", "0.2,-0.2,0.2")
CALM = ("--set", "imu.rate_hz=250")  # faults of a line and of a sensor show as well as at 1000
DAMAGE = ",".join(f"{kind}=0.005" for kind in ("cut", "flip", "drop", "dup", "header", "cr"))


def descriptors(pid):
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


def is_settled(message):
    return message["class"] == "EST" and "aligning" not in message["state"]


@pytest.mark.thorough
def test_unplugging_a_reset_and_damage_cost_neither_attitude_nor_descriptors(tmp_path):
    imu = tmp_path / "imu"
    faults = f"{DAMAGE},reset@9.5,unplug@14-14.3/4"
    with (
        daemon(tmp_path, "--port", f"{imu}:epson@460800", *CALM) as imud,
        emulator("g350", *REST, "--accel-bias-mg", "0,0,0", "--faults", faults, links=[imu]),
    ):
        imud.until(is_settled)
        held = descriptors(imud.process.pid)
        last, connects = None, 0
        while connects < 4:  # the reset, and three plugs
            before = imud.log.count("trying again")
            est = imud.until(lambda m, before=before: is_settled(m) and imud.log.count("trying again") > before)
            assert est["roll_deg"] == pytest.approx(10.0, abs=0.5)
            assert est["pitch_deg"] == pytest.approx(-5.0, abs=0.5)
            connects, last = connects + 1, est
        imud.until(lambda m: m["class"] == "EST" and m["seq"] > last["seq"] + 500)
        assert descriptors(imud.process.pid) <= held
        assert "Traceback" not in imud.log


def arguments(path):
    """Of a process, by its /proc/PID/cmdline; none if it is gone."""
    try:
        return path.read_bytes().split(b"\0")
    except OSError:
        return []


def test_emulated_ports_of_one_scenario_share_their_motion(tmp_path):
    with daemon(tmp_path, "--port", "sim:car", "--port", "sim:car:nmea", "--seed", "3") as imud:
        est = imud.until(lambda m: m["class"] == "EST" and "position" in m["state"])
        assert est["lat_deg"] == pytest.approx(35.6586, abs=0.02)
        parent = f"--parent={imud.process.pid}".encode()
        children = [path.parent for path in Path("/proc").glob("[0-9]*/cmdline") if parent in arguments(path)]
        assert len(children) == 1
        imud.process.kill()
        imud.process.wait()
        deadline = time.monotonic() + TIMEOUT_S
        while children[0].exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)


@pytest.mark.parametrize(
    ("port", "says"),
    [("sim:moon", "no scenario 'moon'; there are rest,"), ("sim:car:nmea@300", "460800"), ("sim:", "no device")],
)
def test_a_scenario_that_is_none_is_misuse(port, says):
    command = [sys.executable, "-m", "imud", "run", "--port", port]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (64, "")
    assert says in ended.stderr and "Traceback" not in ended.stderr


def test_another_sensor_on_the_port_is_not_taken_for_the_one_before(tmp_path):
    imu = tmp_path / "imu"
    port = f"{imu}:epson@460800"
    with daemon(tmp_path, "--port", port, *CALM) as imud:
        with emulator("g350", "--no-identity", "--gyro-bias-dps", "0.5,0.5,0.5", links=[imu]):
            imud.until(lambda m: is_settled(m) and m["sbgx_dps"] < 0.02)
        with emulator("g350", "--gyro-bias-dps=-0.5,-0.5,-0.5", links=[imu]):
            imud.until(lambda m: m["class"] == "EST" and m["sbgx_dps"] > 0.1)  # nothing is known of this one
            est = imud.until(lambda m: is_settled(m) and m["sbgx_dps"] < 0.02)
        assert est["bgx_dps"] == pytest.approx(-0.5, abs=0.1)


@pytest.mark.thorough
def test_after_a_replug_with_other_biases_the_attitude_is_right_by_its_sigma_live_and_replayed(tmp_path):
    imu, recording = tmp_path / "imu", tmp_path / "replug.mcap"
    faults = "unplug@14-17,reset@15,bias=0.2@15"  # deg/s: what a power-on may do to an M-G350
    record = ("--record", str(recording), "--set", "record.estimate_rate_hz=0")
    with (
        daemon(tmp_path, "--port", f"{imu}:epson@460800", *record, *CALM) as imud,
        emulator("g350", *REST, "--accel-bias-mg", "0,0,0", "--faults", faults, links=[imu]),
    ):
        before = imud.until(lambda m: is_settled(m) and m["sbgx_dps"] < 0.02)
        opened = imud.until(lambda m: m["class"] == "EST" and m["sbgx_dps"] > 0.2)
        assert opened["t_mono_ns"] > before["t_mono_ns"]
        est = opened
        while est["t_mono_ns"] < opened["t_mono_ns"] + 20_000_000_000:
            est = imud.until(lambda m: m["class"] == "EST")
            assert abs(est["roll_deg"] - 10.0) < 4.0 * est["sroll_deg"]
            assert abs(est["pitch_deg"] + 5.0) < 4.0 * est["spitch_deg"]
        assert est["bgx_dps"] == pytest.approx(0.4, abs=0.1)
        assert max(est["sroll_deg"], est["spitch_deg"]) < 1.0
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
    assert replayed(Recording([recording])).tobytes() == stored(recording, ESTIMATE_TABLE).tobytes()


def settled(path):
    """Whether the biases in this file have been measured at rest."""
    return max(json.loads(path.read_text())["biases"]["gyro_sigma_radps"]) < 3e-4


def finds_it_streaming(path):
    """Whether the daemon of this recording found the sensor streaming, when it first looked."""
    connections = [entry.data for entry in Capture(path) if entry.topic == CONNECTIONS]
    return msgspec.json.decode(connections[0], type=Connection).imu().still_powered


def is_killed_with_known_biases(folder, port):
    """A daemon that is killed once it has stored the biases that it measured at rest."""
    with daemon(folder, "--port", port, *CALM) as imud:
        imud.until(lambda m: is_settled(m) and m["sbgx_dps"] < 0.02)
        while not any(settled(path) for path in (folder / "state").rglob("biases-*.json")):
            imud.until(lambda m: m["class"] == "EST")
        imud.process.kill()
        imud.process.wait()


def first_estimate(folder, port, recording):
    """Of a daemon, which is recorded."""
    with daemon(folder, "--port", port, "--record", str(recording), *CALM) as imud:
        first = imud.until(lambda m: m["class"] == "EST")
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
    return first


@pytest.fixture
def port(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return f"{tmp_path / 'imu'}:epson@460800"


@pytest.mark.thorough
def test_after_a_daemon_that_was_killed_the_biases_are_known_if_the_sensor_was_not_switched_off(tmp_path, port):
    with emulator("g350", *REST, links=[tmp_path / "imu"]):
        for attempt in range(5):  # on a busy machine nothing may come in the half second for which it looks
            is_killed_with_known_biases(tmp_path, port)
            recording = tmp_path / f"{attempt}.mcap"
            first = first_estimate(tmp_path, port, recording)
            if finds_it_streaming(recording):
                break
        assert finds_it_streaming(recording)
        assert first["sbgx_dps"] < 0.1
        assert first["bgx_dps"] == pytest.approx(0.2, abs=0.1)


@pytest.mark.thorough
def test_after_a_daemon_that_was_killed_the_biases_are_unknown_if_the_sensor_was_switched_off(tmp_path, port):
    with emulator("g350", *REST, links=[tmp_path / "imu"]):
        is_killed_with_known_biases(tmp_path, port)
    recording = tmp_path / "drive.mcap"
    with emulator("g350", *REST, links=[tmp_path / "imu"]):  # while no daemon could have set it up anew
        first = first_estimate(tmp_path, port, recording)
    assert not finds_it_streaming(recording)
    assert first["sbgx_dps"] >= 0.1
