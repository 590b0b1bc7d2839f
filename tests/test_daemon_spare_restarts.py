"""How a spare sits, as an earlier run of the daemon found it: a file of its own, as it waits for minutes."""

import contextlib
import json
import math
import time

import pytest
from processes import TIMEOUT_S, daemon, emulator
from recorded import replayed, stored
from scipy.spatial.transform import Rotation
from two_sensors import CAR, RATE, RATE_HZ, REST, level, plug_in_spare

from imud.recording.messages import ESTIMATE_TABLE
from imud.recording.source import Recording
from imud.sensor_errors import stored_rotation as rotation_module
from imud.sensor_errors.stored_rotation import StoredRotation


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
            sigmas = [est[name] for name in ("sroll_deg", "spitch_deg", "syaw_deg")]
            assert math.hypot(*sigmas) > found["sigma_deg"]  # of one axis, about which it is known worst
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
