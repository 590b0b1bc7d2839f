"""Two inertial sensors on one daemon: the second one is compared with the first, and takes over."""

import contextlib
import json
import time

import pytest
from processes import TIMEOUT_S, daemon, emulator
from recorded import replayed, stored
from scipy.spatial.transform import Rotation

from imud.recording.messages import ESTIMATE_TABLE
from imud.recording.source import Recording
from imud.sensor_errors import stored_rotation as rotation_module
from imud.sensor_errors.stored_rotation import StoredRotation

REST = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5", "--patient")
CAR = ("--scenario", "car", "--patient")
RATE_HZ = 250
RATE = ("--set", f"imu.rate_hz={RATE_HZ}")  # of an M-G350; 1000 show nothing more


def level(message, most_deg=1.0):
    return message["class"] == "EST" and "aligning" not in message["state"] and message.get("sroll_deg", 9.0) < most_deg


def plug_in_spare(imud, first, second, port):
    """The sensor on `port` is plugged in as `second` once the one on `first` is in use."""
    imud.says(f"streaming port={first}")
    second.symlink_to(port)
    imud.says(f"a spare, for when {first}, the inertial sensor, is away")


@pytest.mark.thorough
def test_a_second_sensor_is_a_spare_and_takes_over(tmp_path):
    """Its attitude begins with its own gravity, whatever the first one's biases were."""
    first, second = tmp_path / "first", tmp_path / "second"
    with daemon(tmp_path, "--port", str(first), "--port", str(second), *RATE) as imud, contextlib.ExitStack() as stack:
        with emulator("g350", *REST, "--gyro-bias-dps", "0.6,0.6,-0.6", links=[first]):
            imud.says(f"streaming port={first}")
            stack.enter_context(emulator("g350", *REST, "--gyro-bias-dps=-0.6,0.6,0.3", "--seed", "2", links=[second]))
            imud.says(f"a spare, for when {first}, the inertial sensor, is away")
            seq = imud.until(level)["seq"]
            imud.until(lambda message: level(message) and message["seq"] > seq + 6 * RATE_HZ)
            assert "disagree" not in imud.log
        imud.says(f"streaming port={second}")
        for wait_s in (0, 1, 5):
            least = seq + wait_s * RATE_HZ
            seq = imud.until(lambda message, least=least: level(message) and message["seq"] > least)["seq"]
            est = imud.until(level)
            assert est["roll_deg"] == pytest.approx(10.0, abs=4.0 * est["sroll_deg"])
            assert est["pitch_deg"] == pytest.approx(-5.0, abs=4.0 * est["spitch_deg"])
        with emulator("g350", *REST, links=[first]):
            imud.says(f"a spare, for when {second}, the inertial sensor, is away")


@pytest.mark.thorough
def test_one_in_use_whose_rates_gravity_contradicts_is_replaced_by_the_spare(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    with daemon(tmp_path, "--port", str(first), "--port", str(second), *RATE) as imud, contextlib.ExitStack() as stack:
        stack.enter_context(emulator("g350", *REST, "--faults", "bias=6@25-", links=[first]))
        imud.says(f"streaming port={first}")
        stack.enter_context(emulator("g350", *REST, "--seed", "2", links=[second]))
        imud.says(f"a spare, for when {first}, the inertial sensor, is away")
        imud.says(f"rates disagree with those of {second}: it is the one that is wrong")
        imud.says(f"streaming port={second}")
        imud.says(f"a spare, for when {second}, the inertial sensor, is away")  # the first one
        imud.says(f"inertial sensor on {first}: rates disagree with those of {second}: it is the one that is wrong")
        est = imud.until(level)
        assert est["roll_deg"] == pytest.approx(10.0, abs=4.0 * est["sroll_deg"])


@pytest.mark.thorough
def test_a_spare_that_sits_otherwise_than_the_settings_say_is_reported_also_once_it_is_in_use(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    with daemon(tmp_path, "--port", str(first), "--port", str(second), *RATE) as imud, contextlib.ExitStack() as stack:
        used = stack.enter_context(contextlib.ExitStack())
        used.enter_context(emulator("g350", *REST, links=[first]))
        imud.says(f"streaming port={first}")
        options = ("--seed", "2", "--mount-deg", "35,0,0", "--faults", "frozen=gx@25-")
        stack.enter_context(emulator("g350", *REST, *options, links=[second]))
        for path, other in ((first, second), (second, first)):
            imud.says(f"inertial sensor on {path}: forces disagree with those of {other}: one of them is wrong")
        est = imud.until(level)
        assert est["roll_deg"] == pytest.approx(10.0, abs=4.0 * est["sroll_deg"])
        imud.says(f"{second}: gyro x frozen")
        used.close()
        imud.says(f"streaming port={second}")
        imud.says(f"inertial sensor on {second}: disagreed with {first} until that went away: see imu.mounts")
        imud.says("roll and pitch are lost")
        est = imud.until(lambda message: message["class"] == "EST" and "aligning" in message["state"])
        est = imud.until(lambda message: message["class"] == "EST" and message["seq"] > est["seq"] + 5 * RATE_HZ)
        assert "aligning" in est["state"] and est["sroll_deg"] == pytest.approx(180.0), "nobody knows how it sits"


@pytest.mark.thorough
def test_a_spare_that_sits_otherwise_than_the_settings_say_is_turned_once_motion_has_shown_it(tmp_path):
    """And what is recorded replays to the same bits."""
    first, second, port, recording = (tmp_path / name for name in ("first", "second", "port", "drive.mcap"))
    wrong = f'imu.mounts={{"{second}"=[35,0,90]}}'
    ports = ("--port", str(first), "--port", str(second))
    record = ("--record", str(recording), "--set", "record.estimate_rate_hz=0")
    both = emulator("g350", "rga300", *CAR, "--faults", "g350:unplug@30-900", links=[first, port])
    with both, daemon(tmp_path, *ports, "--set", wrong, *record, *RATE) as imud:
        plug_in_spare(imud, first, second, port)
        imud.says(f"inertial sensor on {second} sits otherwise than the settings say")
        imud.says(f"streaming port={second}")
        seq = imud.until(lambda message: level(message, 2.0))["seq"]  # the sigma of its mounting is in it
        est = imud.until(lambda message: level(message, 2.0) and message["seq"] > seq + 300)
        for angle in ("roll_deg", "pitch_deg"):
            assert abs(est[angle]) < 4.0 + 4.0 * est[f"s{angle}"], "the emulated road is flat"
        imud.process.terminate()
        assert imud.process.wait(30.0) == 0
    assert replayed(Recording([recording])).tobytes() == stored(recording, ESTIMATE_TABLE).tobytes()


def stored_rotation(folder, than=0):
    """The one that a daemon has written at a later time of its clock than `than`; waits for it."""
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        for path in folder.rglob("rotation-*.json"):
            if (found := json.loads(path.read_text()))["monotonic_ns"] > than:
                return found
        time.sleep(0.1)
    raise AssertionError(f"no new rotation below {folder}")


@contextlib.contextmanager
def spare_on(imud, first, second, port):
    """With the sensor on `port` as a spare; ends by killing the daemon."""
    plug_in_spare(imud, first, second, port)
    yield
    imud.process.kill()
    imud.process.wait()
    second.unlink()


@pytest.mark.thorough
def test_how_a_spare_sits_is_known_over_a_restart(tmp_path, monkeypatch):
    """Found in motion. Then at rest, the sensors switched on anew: confirmed by both. Then known at once."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    first, second, port, recording = (tmp_path / name for name in ("first", "second", "port", "drive.mcap"))
    options = [*RATE, "--set", f'imu.mounts={{"{second}"=[35,0,90]}}']  # it sits as the first one does
    options += [item for path in (first, second) for item in ("--port", f"{path}:epson@460800")]
    says = f"inertial sensor on {second} sits otherwise than the settings say"
    before = ", as an earlier run of the daemon found"
    car = emulator("g350", "g370", *CAR, links=[first, port])
    with car, daemon(tmp_path, *options) as imud, spare_on(imud, first, second, port):
        imud.says(says)
        assert before not in imud.log
        found = stored_rotation(tmp_path)
    with contextlib.ExitStack() as used, emulator("g370", *REST, "--seed", "2", links=[port]):
        used.enter_context(emulator("g350", *REST, links=[first]))
        with daemon(tmp_path, *options) as imud, spare_on(imud, first, second, port):
            imud.says(before)
            assert says in imud.log and "disagree" not in imud.log
            assert stored_rotation(tmp_path, found["monotonic_ns"])["turn"] == found["turn"]
        record = ("--record", str(recording), "--set", "record.estimate_rate_hz=0")
        with daemon(tmp_path, *options, *record) as imud, spare_on(imud, first, second, port):
            used.close()
            imud.says(f"streaming port={second}")
            assert before in imud.log
            seq = imud.until(lambda message: level(message, 2.0))["seq"]  # the sigma of its mounting is in it
            est = imud.until(lambda message: level(message, 2.0) and message["seq"] > seq + 3 * RATE_HZ)
            assert est["sroll_deg"] > found["sigma_deg"]
            assert est["roll_deg"] == pytest.approx(10.0, abs=4.0 * est["sroll_deg"])
            assert est["pitch_deg"] == pytest.approx(-5.0, abs=4.0 * est["spitch_deg"])
            imud.process.terminate()
            assert imud.process.wait(30.0) == 0
    assert replayed(Recording([recording])).tobytes() == stored(recording, ESTIMATE_TABLE).tobytes()


@pytest.mark.thorough
def test_what_an_earlier_run_found_is_dropped_if_the_sensors_contradict_it(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    first, second, port = (tmp_path / name for name in ("first", "second", "port"))
    options = [*RATE, *(item for path in (first, second) for item in ("--port", f"{path}:epson@460800"))]
    turn, body = (rotation_module.nine(Rotation.from_rotvec([x, 0.0, 0.0]).as_matrix()) for x in (0.6, 0.0))
    before = StoredRotation("W0000042", "S0000042", turn, body, 1.0, time.time(), {"": (0.0, 0.0, 0.0)})
    rotation_module.save(before, time.monotonic_ns())
    with contextlib.ExitStack() as used, emulator("g370", *REST, "--seed", "2", links=[port]):
        used.enter_context(emulator("g350", *REST, links=[first]))
        with daemon(tmp_path, *options) as imud, spare_on(imud, first, second, port):
            imud.says(f"inertial sensor on {second}: its forces contradict the mounting against {first}")
            assert not list(tmp_path.rglob("rotation-*.json"))
            seq = imud.until(level)["seq"]
            imud.until(
                lambda message: message["class"] == "EST" and message["seq"] > seq + 15 * RATE_HZ
            )  # until they agree
            used.close()
            imud.says(f"streaming port={second}")
            est = imud.until(lambda message: level(message) and message["device"] == str(second))
            assert est["roll_deg"] == pytest.approx(10.0, abs=4.0 * est["sroll_deg"])
