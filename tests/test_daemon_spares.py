"""Two inertial sensors on one daemon: the second one is compared with the first, and takes over."""

import contextlib

import pytest
from processes import daemon, emulator
from recorded import replayed, stored
from two_sensors import CAR, RATE, RATE_HZ, REST, level, plug_in_spare

from imud.recording.messages import ESTIMATE_TABLE
from imud.recording.source import Recording


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
