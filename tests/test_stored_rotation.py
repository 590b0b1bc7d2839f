"""How a spare sits, kept over a restart: of the sensors' own axes, trusted as far as nothing can have moved them."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation as Turn

from imud.configuration.settings import Imu, Settings
from imud.daemon.relative_mountings import Mounted, RelativeMountings
from imud.drivers.sample import SAMPLE
from imud.folders import boot_id
from imud.sensor_errors import stored_rotation
from imud.sensor_errors.calibration import UNKNOWN_MOUNTING, Calibration, correction, relative_mounting_of
from imud.sensors.relative_rotation import Rotation

SITS = {  # from the sensor's axes to the vehicle's
    "U": Turn.from_euler("ZYX", (10.0, -40.0, 170.0), degrees=True),
    "S": Turn.from_euler("ZYX", (0.0, 5.0, 90.0), degrees=True),
}
WRONG = Turn.from_euler("ZYX", (20.0, 0.0, 35.0), degrees=True)  # the settings' error of the spare
SIGMA = np.radians(1.0)
KEPT_NS = 10**12


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    return tmp_path / "imud"


def sensor(name, error=None, *, serial=None, powered=True):
    """As the settings have it, with that error of its mounting in the vehicle's axes."""
    turn = SITS[name] if error is None else error * SITS[name]
    return Mounted(name, name if serial is None else serial, powered, turn.as_matrix())


def run(imu=None):
    """The mountings of a daemon that starts, and what it has told the user."""
    told = []
    return RelativeMountings(told.append, imu or Imu()), told


def find(spare, used):
    """A run in which motion shows how the spare sits, and which stores it."""
    mountings, _ = run()
    turn = used.turn @ SITS[used.path].inv().as_matrix() @ SITS[spare.path].as_matrix() @ spare.turn.T
    mountings.found(spare, used, Rotation(turn, SIGMA**2 * np.eye(3)))
    for each in mountings.to_store({spare.path, used.path}):
        stored_rotation.save(each, KEPT_NS)


def sits(mountings, spare, applied=None):
    """The rotation from the sensor's axes to the vehicle's that is used, once the mounting in the settings is wrong."""
    applied = mountings.applied_to(Calibration(""), spare.path) if applied is None else applied
    rpy = Turn.from_matrix(spare.turn).as_euler("ZYX", degrees=True)[::-1]
    c = correction(applied, tuple(rpy))
    return None if c["flags"][0] else Turn.from_matrix(c["turn"].reshape(3, 3))


def error_deg(found, name):
    return np.degrees((found * SITS[name].inv()).magnitude())


def change(**parts):
    """Of the stored file."""
    (path,) = Path(stored_rotation.folders_for("state")[0]).glob("rotation-*.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | parts))


def test_seconds_later_it_is_known_at_once():
    find(sensor("S", WRONG), sensor("U"))
    mountings, told = run()
    mountings.recall(sensor("S", WRONG), sensor("U"), KEPT_NS + 10**10)
    assert error_deg(sits(mountings, sensor("S", WRONG)), "S") < 1e-6
    assert len(told) == 1 and "as an earlier run of the daemon found" in told[0]
    assert [each.serial for each in mountings.to_store({"S", "U"})] == ["S"]


@pytest.mark.parametrize("case", ["a minute later", "another boot", "spare was off", "used was off"])
def test_else_it_is_tried_and_known_once_both_agree(case):
    find(sensor("S", WRONG), sensor("U"))
    if case == "another boot":
        change(boot_id="x" + boot_id()[1:])
    spare, used = sensor("S", WRONG, powered=case != "spare was off"), sensor("U", powered=case != "used was off")
    mountings, told = run()
    mountings.recall(spare, used, KEPT_NS + 10**9 * (61 if case == "a minute later" else 3))
    assert mountings.is_unknown("S") and sits(mountings, spare) is None and not told
    assert error_deg(sits(mountings, spare, mountings.tried_on(Calibration(""), "S")), "S") < 1e-6
    assert mountings.to_store({"S", "U"}) == []
    mountings.confirm("S")
    assert error_deg(sits(mountings, spare), "S") < 1e-6 and len(told) == 1
    assert len(mountings.to_store({"S", "U"})) == 1 and mountings.to_store({"U"}) == []


def test_what_is_contradicted_is_dropped_and_how_the_sensor_sits_is_unknown(folder):
    find(sensor("S", WRONG), sensor("U"))
    mountings, _ = run()
    mountings.recall(sensor("S", WRONG), sensor("U"), KEPT_NS)
    mountings.contradict("S", "U")
    assert mountings.applied_to(Calibration(""), "S").relative_mounting is UNKNOWN_MOUNTING
    assert not mountings.is_recalled("S") and list(folder.iterdir()) == []


def test_the_other_one_may_be_in_use_by_then():
    find(sensor("S", WRONG), sensor("U"))
    mountings, _ = run()
    used = sensor("S", WRONG)  # in use before any other was found: trusted
    mountings.recall(sensor("U"), used, KEPT_NS)
    assert error_deg(WRONG.inv() * sits(mountings, sensor("U")), "U") < 1e-6


@pytest.mark.parametrize("corrected", ["S", "U"])
def test_settings_that_were_put_right_are_taken(corrected):
    """Whichever of the two was wrong; also where the sensor comes into use alone."""
    errors = {"S": {"S": WRONG, "U": None}, "U": {"S": None, "U": WRONG}}[corrected]
    find(sensor("S", errors["S"]), sensor("U", errors["U"]))
    mountings, told = run(Imu(mounts={corrected: (0.0, 0.0, 1.0)}))
    mountings.recall_alone(sensor("S"), KEPT_NS)
    mountings.recall(sensor("U"), sensor("S"), KEPT_NS)
    mountings.recall(sensor("S"), sensor("U"), KEPT_NS)
    assert not told and mountings.applied_to(Calibration("x"), "S") == Calibration("x")


@pytest.mark.parametrize(("late_s", "powered", "known"), [(3, True, True), (61, True, False), (3, False, False)])
def test_alone_it_is_known_only_if_nothing_can_have_moved_it(late_s, powered, known):
    find(sensor("S", WRONG), sensor("U"))
    mountings, _ = run()
    spare = sensor("S", WRONG, powered=powered)
    mountings.recall_alone(spare, KEPT_NS + late_s * 10**9)
    assert mountings.is_found("S") == known
    assert (error_deg(sits(mountings, spare), "S") < 1e-6) == known


@pytest.mark.parametrize("serials", [("", "U"), ("S", ""), ("X", "X")])
def test_sensors_without_a_number_of_their_own_are_not_stored(serials, folder):
    find(sensor("S", WRONG, serial=serials[0]), sensor("U", serial=serials[1]))
    assert not folder.exists()


@pytest.mark.parametrize(
    "parts",
    [
        {"serial": "Q"},
        {"other": "Q"},
        {"found_s": time.time() + 1e4},
        {"found_s": time.time() - 10 * 86400.0},
        {"sigma_deg": 11.0},
        {"sigma_deg": 0.0},
        {"turn": [1.0] * 9},
        {"body": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0]},
        {"turn": None},
        {"strange": 1},
    ],
)
def test_any_other_file_is_as_none(parts):
    find(sensor("S", WRONG), sensor("U"))
    assert stored_rotation.between("S", "U") and stored_rotation.between("U", "S")
    change(**parts)
    assert stored_rotation.between("S", "U") is None
    mountings, told = run()
    mountings.recall(sensor("S", WRONG), sensor("U"), KEPT_NS)
    assert not mountings.is_unknown("S") and not told


def test_it_is_known_less_well_from_day_to_day():
    find(sensor("S", WRONG), sensor("U"))
    change(found_s=time.time() - 3 * 86400.0)
    mountings, _ = run()
    mountings.recall(sensor("S", WRONG), sensor("U"), KEPT_NS)
    relative = mountings.applied_to(Calibration(""), "S").relative_mounting
    assert np.array(relative.covariance_deg2) == pytest.approx((1.0 + 9.0) * np.eye(3), rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("estimator", ["attitude", "navigation", "tilt"])
def test_an_attitude_is_as_well_known_as_the_mounting(estimator):
    rows = np.zeros(500, SAMPLE)
    rows["t_ns"], rows["f"] = KEPT_NS + 10**7 * np.arange(500), (0.0, 0.0, -9.8)
    out = {}
    for sigma_deg in (0.0, 2.0):
        filter_ = new_filter(estimator, rows, Settings())
        relative = relative_mounting_of(np.eye(3), np.radians(sigma_deg) ** 2 * np.eye(3))
        filter_.calibrate(Calibration("", relative_mounting=relative))
        out[sigma_deg] = replay(filter_, rows.copy())[0]["sigma_rpy"]
    assert np.degrees(out[2.0]) == pytest.approx(np.hypot(np.degrees(out[0.0]), 2.0))
