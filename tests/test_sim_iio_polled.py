"""Emulated barometer and magnetometer of the kernel: attributes as libiio and our driver read them, with faults."""

import json
import os
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest
from processes import TIMEOUT_S, daemon, process
from recorded import stored

from imud.commands.doctor import examine
from imud.configuration.settings import Initial
from imud.daemon import simulated
from imud.drivers.errors import PortAbsentError
from imud.drivers.transport.iio_polled import find_polled
from imud.drivers.transport.iio_sysfs import ROOT
from imud.errors import UsageError
from imud.estimators.records import BAROMETER, MAGNETOMETER
from imud.firmware_sim.device import POLLED
from imud.firmware_sim.faults import spec
from imud.firmware_sim.faults.wire import Wire
from imud.firmware_sim.iio_polled import POLLED_CHIPS, RATE_HZ, PolledDevice
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.scenarios import SCENARIOS
from imud.recording.messages import INNOVATION_TABLE
from imud.recording.player import Handlers, Player
from imud.recording.source import Recording, adapter

RPY = np.radians([10.0, -5.0, 30.0])
HEIGHT_M = 60.0
PASCAL = 101325.0 * (1.0 - 0.0065 * HEIGHT_M / 288.15) ** 5.255880  # ISO 2533
FIELD_UT = np.array([30.1416, -4.2083, 35.6602])  # pygeomag, WMM 2025, 35.6586 N 139.7454 E, 2027.5


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.setenv(ROOT, str(tmp_path))
    return tmp_path


def chip(name, root, faults="", *, ideal=True):
    [own] = spec.parse(faults, [name])
    at_rest = Trajectory(SCENARIOS["rest"](*RPY), 35.6586, 139.7454, HEIGHT_M)
    wire = Wire(name, spec.of_layer("wire", own), np.random.default_rng(1))
    return PolledDevice(name, 0, at_rest, np.random.default_rng(2), root, own, ideal=ideal, wire=wire)


def read(name):
    """Pa, or uT forward, right, down; None: it cannot be read."""
    try:
        values = find_polled(name)[0].read()
    except (OSError, PortAbsentError):
        return None
    return np.array(values) * (1.0 if name == "bmp280" else 1e6)


def readings(device, times):
    """What a host reads at each of the times."""
    found = []
    with device:
        steps = 0
        for t in times:
            for count in range(steps, round(t * RATE_HZ) + 1):
                device.step((count + 0.5) / RATE_HZ)
                steps = count + 1
            found.append(read(device.name))
    return found


def in_body():
    """The field in the body's axes, by one turn after the other."""
    (roll, pitch, yaw), (n, e, d) = RPY, FIELD_UT
    n, e = n * np.cos(yaw) + e * np.sin(yaw), e * np.cos(yaw) - n * np.sin(yaw)
    n, d = n * np.cos(pitch) - d * np.sin(pitch), d * np.cos(pitch) + n * np.sin(pitch)
    return np.array([n, e * np.cos(roll) + d * np.sin(roll), d * np.cos(roll) - e * np.sin(roll)])


def test_each_name_has_a_chip():
    assert set(POLLED) == set(POLLED_CHIPS)


def test_ideal_ones_tell_the_true_pressure_and_field(root):
    assert readings(chip("bmp280", root), [1.0])[0] == pytest.approx([PASCAL], abs=0.1)
    assert readings(chip("ak8975", root), [1.0])[0] == pytest.approx(in_body(), abs=0.16)  # half a count


def test_real_ones_are_wrong_by_a_little(root):
    pressures = np.array(readings(chip("bmp280", root, ideal=False), np.arange(1.0, 5.0, 0.02)))
    assert np.std(pressures) == pytest.approx(1.3, rel=0.3) and abs(pressures.mean() - PASCAL) < 1500.0
    fields = np.array(readings(chip("ak8975", root, ideal=False), np.arange(1.0, 5.0, 0.02)))
    assert np.std(fields, axis=0) == pytest.approx([0.3] * 3, rel=0.3)
    assert 0.1 < np.abs(fields.mean(axis=0) - in_body()).max() < 4.0


@pytest.mark.parametrize(
    ("name", "faults", "during"),
    [
        ("bmp280", "offset=500@2-3", PASCAL + 500.0),
        ("bmp280", "other:scale=0.1@2-3", 0.1 * PASCAL),
        ("ak8975", "offset=15@2-3", in_body() - 15.0),
        ("ak8975", "scale=-1@2-3", -in_body()),
        ("bmp280", "lose@2-3", None),
        ("ak8975", "unplug@2-3", None),
    ],
)
def test_faults_hold_for_their_time(root, name, faults, during):
    before, within, after = readings(chip(name, root, faults), [1.9, 2.5, 3.1])
    right = [PASCAL] if name == "bmp280" else in_body()
    assert before == pytest.approx(right, abs=0.2) and after == pytest.approx(right, abs=0.2)
    if during is None:
        assert within is None
    else:
        assert within == pytest.approx(np.atleast_1d(during), abs=0.2)


def test_a_held_reading_repeats_and_a_late_one_is_old(root):
    times = np.arange(1.0, 4.0, 0.1)
    plain = np.ravel(readings(chip("bmp280", root, ideal=False), times))
    held = np.ravel(readings(chip("bmp280", root, "held@2-3", ideal=False), times))
    inside = (times > 2.01) & (times < 2.99)
    assert len(set(held[inside])) == 1 and (held[~inside] == plain[~inside]).mean() > 0.9
    late = np.ravel(readings(chip("bmp280", root, "delay=1x0.5", ideal=False), times))
    assert late[5:] == pytest.approx(plain[:-5])


def test_a_share_of_the_readings_fails_as_a_chip_that_does_not_answer(root):
    device = chip("bmp280", root, "lose=0.3")
    failed = [each is None for each in readings(device, np.arange(1.0, 9.0, 1.0 / RATE_HZ))]
    assert np.mean(failed) == pytest.approx(0.3, abs=0.07)
    with chip("bmp280", root, "lose") as device:
        device.step(0.0)
        with pytest.raises(OSError, match="Input/output error"):
            find_polled("bmp280")[0].read()
        assert (root / "sys/bus/iio/devices/iio:device0/in_temp_input").read_text() == "25000\n"


def test_emulated_ports_in_the_kernel(monkeypatch):
    monkeypatch.delenv(ROOT, raising=False)
    texts = ("sim:rest:iio", "sim:rest:bmp280", "sim:rest:wheel", "sim:rest:ak8975")
    with simulated.emulated(texts, 1) as emulated:
        ports = emulated.ports
        assert ports[0] == "iio:bmi160" and ports[1].endswith(":nmea") and len(ports) == 2
        assert find_polled("bmp280")[0].folder == "iio:device1"
        whats = [finding.what for finding in examine()]
        assert any(what.startswith("IIO device bmi160 (iio:device0) may be opened") for what in whats)
        assert any(what.startswith("IIO magnetometer ak8975") for what in whats)
    assert ROOT not in os.environ and simulated.polled(texts) == ("bmp280", "ak8975")
    with pytest.raises(UsageError, match="name that, too"), simulated.emulated(("sim:rest:bmp280",), 1):
        pass


def can_replace_sysfs():
    """libiio reads /sys/bus/iio only: root may put another folder there, for one process."""
    trial = ("unshare", "--mount", "mount", "-t", "tmpfs", "none", "/sys/bus")
    return shutil.which("iio_info") and subprocess.run(trial, capture_output=True, check=False).returncode == 0


@pytest.mark.skipif(not can_replace_sysfs(), reason="needs libiio-utils, and root")
def test_libiio_reads_the_tree_and_a_buffer(tmp_path):
    """iio_info lists devices, channels and values; iio_readdev sets the trigger, enables the buffer and reads scans."""
    script = (
        f"mount -t tmpfs none /sys/bus && mkdir /sys/bus/iio && mount --bind {tmp_path}/sys/bus/iio /sys/bus/iio && "
        "mount -t tmpfs none /dev && touch /dev/iio:device0 && "
        f"mount --bind {tmp_path}/dev/iio:device0 /dev/iio:device0"
    )

    def run(*command):
        words = ("unshare", "--mount", "sh", "-c", f'{script} && exec "$@"', "sh", *command)
        return subprocess.run(words, capture_output=True, check=False, timeout=TIMEOUT_S)

    words = ("bmi160", "bmp280", "ak8975", "--iio-root", str(tmp_path), "--ideal", "--roll-deg", "90")
    with process("imud.firmware_sim", *words, stdout=subprocess.PIPE) as running:
        assert all(running.stdout.readline() for _ in range(3))
        time.sleep(0.2)
        info = run("iio_info").stdout.decode()
        for line in (
            "iio:device0: bmi160 (buffer capable)",
            "anglvel_x:  (input, index: 4, format: le:S16/16>>0)",
            "iio:device1: bmp280",
            "attr  0: input value: 100.606",
            "iio:device2: ak8975",
            "attr  1: scale value: 0.003000",
        ):
            assert line in info, info
        scans = run("iio_readdev", "-s", "20", "-b", "5", "-t", "bmi160-dev0", "bmi160")
    dtype = [("rates", "<i2", 3), ("forces", "<i2", 3), ("", "V4"), ("ns", "<i8")]
    found = np.frombuffer(scans.stdout, dtype)
    assert len(found) == 20, scans.stderr
    assert (found["forces"] * 0.001197)[0] == pytest.approx([0.0, 9.7976, 0.0], abs=0.01)  # y left is up: roll is 90
    assert np.diff(found["ns"]) == pytest.approx(1e9 / 25.0, abs=1000)


@pytest.mark.thorough
def test_a_daemon_is_aided_by_them_through_their_faults_and_the_recording_replays_to_the_same_bits(tmp_path, root):
    faults = "bmp280:lose=0.1,unplug@14-22/40;ak8975:lose@14-22/40"
    words = ("bmi160", "nmea", *POLLED, "--iio-root", str(root), "--link", str(root / "gnss"), "--faults", faults)
    settings = ("--set", 'aiding.iio=["bmp280","ak8975"]', "--set", "aiding.magnetometer=true")
    settings += ("--set", "imu.rate_hz=100", "--record", str(tmp_path / "rest.mcap"))
    with (
        process("imud.firmware_sim", *words, stdout=subprocess.PIPE) as running,
        daemon(tmp_path, "--port", "iio:bmi160", "--port", str(root / "gnss"), *settings) as imud,
    ):
        assert all(running.stdout.readline() for _ in range(4))
        est = imud.until(lambda m: m["class"] == "EST" and "heading" in m["state"])
        assert est["yaw_deg"] == pytest.approx(0.0, abs=3.0 * est["syaw_deg"]) and est["syaw_deg"] < 15.0
        imud.says("iio:ak8975 cannot be read: Input/output error")
        imud.says("has ended: barometer: stale")
        imud.says("has ended: magnetometer: stale")
        command = [sys.executable, "-m", "imud", "status", "--json", str(tmp_path / "gpsd.sock")]
        status = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        assert status["aiding"]["sources"]["barometer"]["received"] > 0
        assert status["innovations"]["barometer"]["used"] > 0
        assert status["innovations"]["magnetometer"]["used"] > 0
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0

    innovations = []
    recording, adapt = Recording([tmp_path / "rest.mcap"]), adapter(None, (), None)
    player = Player(
        recording.settings(adapt),
        adapt,
        Initial(),
        Handlers(aid=lambda _, new: innovations.append(new.copy())),
    )
    for entry in recording:
        player.take(entry)
    kinds = (BAROMETER, MAGNETOMETER)
    found, aided = stored(tmp_path / "rest.mcap", INNOVATION_TABLE), np.concatenate(innovations)
    assert set(aided["kind"]) == set(kinds)
    assert aided.tobytes() == found[np.isin(found["kind"], kinds)].tobytes()
