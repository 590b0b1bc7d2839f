"""A daemon that ended without warning goes on where it was, as after a gap in the samples, and no surer than that."""

import os
import shutil
import time

import numpy as np
import pytest
from navigation_simulation import drive, errors, received, sensed
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation
from test_power_on import AT_S, BEFORE_S, PATHS, PROFILE, RATE, SETTINGS, YAW, switch_on_biases

from imud.configuration.settings import Imu, Initial, Navigation, Settings
from imud.daemon.checkpoint_file import CheckpointFiles
from imud.drivers.sample import RECONNECTED
from imud.estimators.records import HEADING_VALID
from imud.pipeline import Stored
from imud.sensor_errors.calibration import Calibration

OFF, AWAY_S = round(BEFORE_S * RATE), 3.0
ON = OFF + round(AWAY_S * RATE)


def run(path, seed, turned=None):
    """Samples, fixes and truth of a sensor that stays switched on; turned: how it was moved while nobody listened."""
    rng, d = np.random.default_rng(seed), PATHS[path]
    biases = switch_on_biases(rng)
    noise = PROFILE.gyro_noise, PROFILE.accel_noise
    samples = sensed(d, rng, *noise, *biases)
    samples[ON:] = sensed(d, rng, *noise, *biases, turned)[ON:]
    samples["flags"][ON] |= RECONNECTED
    return samples, received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1), d


def halves(samples, fixes):
    """Those before the end and after the restart; fixes that arrive meanwhile are lost."""
    end_ns, begin_ns = samples["t_ns"][OFF - 1], samples["t_ns"][ON]
    first, second = fixes[fixes["arrival_ns"] <= end_ns], fixes[fixes["t_ns"] > begin_ns]
    return (samples[:OFF], first), (samples[ON:], second)


def restarted(samples, fixes):
    """Solutions after the restart, of another filter that goes on from the checkpoint."""
    first, second = halves(samples, fixes)
    before, after = (new_filter("navigation", samples, SETTINGS, YAW) for _ in range(2))
    replay(before, *first)
    assert after.restore(Stored(None, before.checkpoint()))
    return replay(after, *second)[0]


@pytest.mark.parametrize("path", PATHS)
def test_navigation_goes_on_as_after_a_gap_to_the_last_bit(path):
    samples, fixes, _ = run(path, 0)
    first, second = halves(samples, fixes)
    whole = new_filter("navigation", samples, SETTINGS, YAW)
    replay(whole, *first)
    assert replay(whole, *second)[0].tobytes() == restarted(samples, fixes).tobytes()


@pytest.mark.parametrize("path", PATHS)
def test_heading_is_back_at_once_and_as_good_as_it_says(path):
    at = np.round(AT_S * RATE).astype(int)
    z = []
    for seed in range(12):
        samples, fixes, d = run(path, seed)
        out = restarted(samples, fixes)
        assert (out["status"][at] & HEADING_VALID).all()
        whole = np.zeros(len(d.t), out.dtype)
        whole["q_nb"][:, 0] = 1.0
        whole[ON:] = out
        z.append(errors(d, whole)[2][ON:][at] / out["sigma_rpy"][at])
    assert (np.abs(z) < 4.5).all()
    assert (np.square(z).mean(axis=(0, 2)) < 2.0).all()


def test_a_sensor_that_was_tilted_meanwhile_is_levelled_anew_and_its_heading_is_not_known():
    turn = Rotation.from_euler("x", 35.0, degrees=True)
    samples, fixes, _ = run("rest", 1, turn)
    out = restarted(samples, fixes)[np.round(AT_S * RATE).astype(int)]
    down = Rotation.from_quat(np.roll(out["q_nb"], -1, axis=1)).inv().apply([0.0, 0.0, 1.0])
    tilt = np.arccos(np.clip(down @ turn.apply([0.0, 0.0, 1.0]), -1.0, 1.0))
    assert (tilt < 3.5 * np.hypot(*out["sigma_rpy"][:, :2].T)).all()
    assert not (out["status"] & HEADING_VALID).any()


@pytest.mark.parametrize("turned_deg", [45.0, 120.0, 180.0])
def test_a_car_that_turned_meanwhile_finds_its_heading_when_it_drives(turned_deg):
    d, rng = drive(110.0, rate=RATE, rest=BEFORE_S + 5.0), np.random.default_rng(2)
    samples = sensed(d, rng, PROFILE.gyro_noise, PROFILE.accel_noise, *switch_on_biases(rng))
    samples["flags"][ON] |= RECONNECTED
    fixes = received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1)
    first, second = halves(samples, fixes)
    before = new_filter("navigation", samples, SETTINGS, Initial(yaw_deg=YAW.yaw_deg + turned_deg))
    replay(before, *first)
    after = new_filter("navigation", samples, SETTINGS)
    assert after.restore(Stored(None, before.checkpoint()))
    out = replay(after, *second)[0]
    whole = np.zeros(len(d.t), out.dtype)
    whole["q_nb"][:, 0] = 1.0
    whole[ON:] = out
    assert abs(errors(d, whole)[2][-1, 2]) < 4.0 * out["sigma_rpy"][-1, 2] < np.radians(12.0)


@pytest.mark.parametrize("estimator", ["attitude", "navigation"])
@pytest.mark.parametrize(
    "change",
    [
        lambda made: {**made, "settings": Settings(imu=Imu(profile="consumer-mems"))},
        lambda made: {**made, "mounted": (0.0, 0.0, 90.0)},
        lambda made: {**made, "checkpoint": made["checkpoint"][:-1]},
        lambda made: {**made, "checkpoint": b"\0" * 32 + made["checkpoint"][32:]},
        lambda made: {**made, "checkpoint": b""},
    ],
)
def test_a_checkpoint_of_other_settings_mounting_or_version_is_as_none(estimator, change):
    samples, _, _ = run("rest", 0)
    before = new_filter(estimator, samples, SETTINGS)
    replay(before, samples[:OFF])
    made = {"settings": SETTINGS, "mounted": (0.0, 0.0, 0.0), "checkpoint": before.checkpoint()}
    for wanted, given in ((True, made), (False, change(made))):
        imu = Imu(profile=given["settings"].imu.profile, mount_rpy_deg=given["mounted"])
        after = new_filter(estimator, samples, Settings(imu=imu, navigation=Navigation()), Initial())
        after.calibrate(Calibration(""))
        assert after.restore(Stored(None, given["checkpoint"])) == wanted


SENSOR, PORT = "epson G350 W1", "/dev/ttyUSB0"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "run"))
    CheckpointFiles(SENSOR, PORT).save(b"what a filter knows\n" * 9)
    return tmp_path / "run"


def test_a_checkpoint_is_taken_once(folder):
    assert len(list(folder.iterdir())) == 1
    assert CheckpointFiles(SENSOR, PORT).take(10**9) == b"what a filter knows\n" * 9
    assert CheckpointFiles(SENSOR, PORT).take(10**9) == b""
    assert not list(folder.iterdir())


def test_old_ones_of_sensors_that_did_not_come_back_are_removed(folder):
    for name, age_s in (("filter-old", 10**5), (".filter-old-77", 10**5), ("filter-new", 10), ("biases-old", 10**5)):
        (folder / name).touch()
        os.utime(folder / name, (time.time() - age_s, time.time() - age_s))
    (folder / "filter-folder").mkdir()
    os.utime(folder / "filter-folder", (0, 0))
    own = folder / CheckpointFiles(SENSOR, PORT).names[0]
    os.utime(own, (0, 0))  # the clock has stepped by years
    assert CheckpointFiles(SENSOR, PORT).take(10**9) == b"what a filter knows\n" * 9
    assert {path.name for path in folder.iterdir()} == {"filter-new", "biases-old", "filter-folder"}


def test_it_is_kept_where_a_file_can_be_made(folder, monkeypatch):
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/proc/no/such/folder")
    CheckpointFiles(SENSOR, PORT).save(b"here")
    assert CheckpointFiles(SENSOR, PORT).take(10**9) == b"here"


@pytest.mark.parametrize("asked", [("another sensor", PORT, 10**9), (SENSOR, "/dev/ttyUSB1", 10**9), (SENSOR, PORT, 0)])
def test_of_another_sensor_port_or_time_there_is_none(folder, asked):
    sensor, port, max_age_ns = asked
    assert CheckpointFiles(sensor, port).take(max_age_ns) == b""


@pytest.mark.parametrize(
    "broken",
    [
        lambda data: b"",
        lambda data: data[:-1],
        lambda data: data.replace(b"knows", b"knew "),
        lambda data: b"{}\n" + data,
        lambda data: b"\xff" + data,
        lambda data: data.replace(b'"boot_id":"', b'"boot_id":"0'),
    ],
)
def test_a_file_that_is_not_what_was_written_is_as_none(folder, broken):
    (path,) = folder.iterdir()
    path.write_bytes(broken(path.read_bytes()))
    assert CheckpointFiles(SENSOR, PORT).take(10**9) == b""


def test_a_daemon_that_was_killed_while_it_wrote_leaves_the_checkpoint_before(folder):
    files = CheckpointFiles(SENSOR, PORT)
    for content in (b"one", b"two", b"three"):
        files.save(content)
    newest, before = (folder / name for name in files.names)
    assert newest.read_bytes().endswith(b"\nthree") and before.read_bytes().endswith(b"\ntwo")
    newest.write_bytes(newest.read_bytes()[:-1])
    assert CheckpointFiles(SENSOR, PORT).take(10**9) == b"two"
    assert not list(folder.iterdir())


def test_the_newest_of_two_checkpoints_is_taken(folder):
    files = CheckpointFiles(SENSOR, PORT)
    for content in (b"a longer one", b"second", b"third", b"fourth"):
        files.save(content)
    assert CheckpointFiles(SENSOR, PORT).take(10**9) == b"fourth"


def test_a_folder_that_is_removed_while_the_daemon_runs_is_made_anew(folder):
    files = CheckpointFiles(SENSOR, PORT)
    files.save(b"before")
    shutil.rmtree(folder)
    files.save(b"after")
    assert CheckpointFiles(SENSOR, PORT).take(10**9) == b"after"
