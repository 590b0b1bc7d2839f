"""Calibration: known errors put into samples come back within their sigmas; unfit data is refused; files survive."""

import errno
import itertools
import math
import os
import re
import tempfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imud.commands import main
from imud.drivers.sample import SAMPLE
from imud.errors import BadDataError, CannotCreateError
from imud.sensor_errors import calibration, gyro
from imud.sensor_errors.accelerometer import accelerometer, positions
from imud.sensor_errors.calibration import Accelerometer, Calibration, Gyro, Mounting, correct, correction
from imud.sensor_errors.mounting import mounting
from imud.sensor_errors.rest import UnfitError, refuse_broken, rest_intervals

RATE_HZ, G = 100.0, 9.80665
RNG = np.random.default_rng(7)
BIAS = np.array([0.01, -0.02, 0.005])


def recording(forces, seconds=3.0, rates=None, temperature=25.0, seed=1):
    """Samples of a noisy sensor that feels each of `forces` for some seconds, and turns from one to the next in 1 s."""
    rng = np.random.default_rng(seed)
    n, m = round(seconds * RATE_HZ), round(RATE_HZ)
    parts = [np.repeat(np.atleast_2d(forces[0]), n, axis=0)]
    for before, after in itertools.pairwise(forces):
        share = np.linspace(0.0, 1.0, m)[:, None]
        parts += [(1.0 - share) * before + share * after, np.repeat(np.atleast_2d(after), n, axis=0)]
    f = np.concatenate(parts)
    samples = np.zeros(len(f), SAMPLE)
    samples["t_ns"] = (np.arange(len(f)) * 1e9 / RATE_HZ).astype(np.int64)
    samples["f"] = f + 0.02 * rng.standard_normal(f.shape)
    w = BIAS if rates is None else rates
    samples["w"] = w + 0.002 * rng.standard_normal(f.shape)
    samples["temperature"] = temperature
    if len(forces) > 1:  # it turns in between
        for k in range(len(forces) - 1):
            at = n + k * (n + m)
            samples["w"][at : at + m] += 1.5
            samples["f"][at : at + m] += 1.5 * rng.standard_normal((m, 3))
    return samples


FACES = [G * s * np.eye(3)[i] for i in range(3) for s in (1.0, -1.0)]
EDGES = [G * np.array(v) / math.sqrt(2) for v in ((1, 1, 0), (1, 0, -1), (0, -1, 1), (-1, 1, 0), (0, 1, 1), (1, 0, 1))]


def test_gyro_bias_lies_within_its_sigma():
    z = []
    for seed in range(40):
        found = gyro.bias(recording([np.array([0, 0, -G])], 30.0, seed=seed), RATE_HZ)
        z.append((found.value - BIAS) / found.sigma)
    assert abs(np.mean(z)) < 0.3
    assert 0.8 < np.std(z) < 1.25


def test_the_slope_of_the_gyro_bias_over_temperature_is_found():
    samples = recording([np.array([0, 0, -G])], 60.0)
    samples["temperature"] = np.linspace(10.0, 30.0, len(samples))
    true = np.array([1e-4, -2e-4, 0.0])
    samples["w"] += (samples["temperature"] - 20.0)[:, None] * true
    bias, slope, at = gyro.slope(samples, RATE_HZ)
    assert at == pytest.approx(20.0, abs=0.2)
    assert (np.abs(bias.value - BIAS) < 4 * bias.sigma).all()
    assert (np.abs(slope.value - true) < 4 * slope.sigma).all()
    assert (slope.sigma < 2e-5).all()


def measured(true_forces, bias, matrix):
    return np.array(true_forces) @ np.linalg.inv(matrix).T + bias


@pytest.mark.parametrize("shape", ["six faces", "with edges"])
def test_bias_and_matrix_of_the_accelerometer_are_found_from_positions(shape):
    bias = np.array([0.1, -0.05, 0.02])
    skew = 0.003 if shape == "with edges" else 0.0
    matrix = np.array([[1.005, skew, -skew], [0.0, 0.997, 2 * skew], [0.0, 0.0, 1.002]])
    true = FACES + (EDGES if shape == "with edges" else [])
    samples = recording(measured(true, bias, matrix))
    forces = positions(samples, RATE_HZ)
    assert len(forces) == len(true)
    found, ours, residual = accelerometer(forces, G)
    np.testing.assert_allclose(found.value, bias, atol=0.006)
    np.testing.assert_allclose(ours, matrix, atol=0.001)
    assert residual < 0.005
    accel = Accelerometer("", tuple(found.value), tuple(map(tuple, ours)), (0,) * 3, 0, 6)
    c = correction(Calibration("x", accelerometer=accel), (0.0,) * 3)
    sample = samples[:1].copy()
    sample["f"] = measured([FACES[0]], bias, matrix)
    correct(sample[0], c[0])
    np.testing.assert_allclose(np.linalg.norm(sample["f"]), G, atol=0.005)


@pytest.mark.parametrize("face", range(6))
def test_a_missing_face_is_named(face):
    name = ("+x", "-x", "+y", "-y", "+z", "-z")[face]
    with pytest.raises(UnfitError, match=re.escape(f"no position has {name} up")):
        accelerometer(np.array([f for i, f in enumerate(FACES) if i != face]), G)


RIGHT_HANDED = Rotation.create_group("O").as_matrix()


def drive(C_vs, acceleration=2.0, seed=1):
    """Rest, then a start forwards, in the axes of a sensor whose vehicle axes are C_vs times its own; then a turn."""
    n = round(5 * RATE_HZ)
    f_v = np.tile([0.0, 0.0, -G], (3 * n, 1))
    f_v[n : 2 * n, 0] = acceleration
    samples = np.zeros(3 * n, SAMPLE)
    rng = np.random.default_rng(seed)
    samples["f"] = f_v @ C_vs + 0.02 * rng.standard_normal((3 * n, 3))
    samples["w"] = 0.002 * rng.standard_normal((3 * n, 3))
    return samples


@pytest.mark.parametrize("C_vs", RIGHT_HANDED, ids=range(24))
def test_mounting_in_all_right_handed_orientations_and_a_little_off(C_vs):
    fine = Rotation.from_euler("ZYX", [5.0, -3.0, 2.0], degrees=True).as_matrix()
    matrix, sigma = mounting(drive(C_vs @ fine), RATE_HZ)
    error = Rotation.from_matrix(matrix @ (C_vs @ fine).T).magnitude()
    assert math.degrees(error) < 1.0
    assert math.degrees(sigma[2]) < 3.0
    assert np.linalg.det(matrix) == pytest.approx(1.0)


def rolling(mirror):
    """A sensor that is rolled and pitched to and fro slowly, with its gyro's y axis the wrong way round if mirrored."""
    t = np.arange(0.0, 20.0, 1.0 / RATE_HZ)
    angle = np.where(t > 5.0, 0.6 * np.sin(1.2 * (t - 5.0)), 0.0)
    turn = Rotation.from_euler("YX", np.stack([angle, 0.5 * angle], axis=1))
    samples = np.zeros(len(t), SAMPLE)
    samples["f"] = turn.inv().apply([0.0, 0.0, -G]) + 0.01 * RNG.standard_normal((len(t), 3))
    rates = (turn[:-1].inv() * turn[1:]).as_rotvec() * RATE_HZ
    samples["w"][:-1] = rates * ((-1.0, -1.0, -1.0) if mirror else (1.0, 1.0, 1.0))
    samples["w"] += 0.001 * RNG.standard_normal((len(t), 3))
    return samples


def test_mirrored_axes_are_refused():
    with pytest.raises(UnfitError, match="mirrored"):
        mounting(rolling(mirror=True), RATE_HZ)
    matrix, _ = mounting(rolling(mirror=False), RATE_HZ)  # tilting looks like a start; but nothing is mirrored
    assert np.linalg.det(matrix) == pytest.approx(1.0)


def test_unfit_for_a_mounting():
    with pytest.raises(UnfitError, match="no acceleration above"):
        mounting(drive(np.eye(3), acceleration=0.1), RATE_HZ)
    crooked = drive(np.eye(3))
    n = round(5 * RATE_HZ)
    crooked["f"][n + 60 : 2 * n, 1] += 2.0
    with pytest.raises(UnfitError, match="not straight"):
        mounting(crooked, RATE_HZ)


def test_broken_moving_and_short_data_is_refused():
    still = recording([np.array([0, 0, -G])], 20.0)
    frozen = still.copy()
    frozen["w"][:, 1] = 0.25
    with pytest.raises(UnfitError, match="gyro's y is frozen"):
        refuse_broken(frozen)
    limited = still.copy()
    limited["f"][500:900, 2] = -29.4
    with pytest.raises(UnfitError, match="accelerometer's z is at the end of its range"):
        refuse_broken(limited)
    missing = still.copy()
    missing["f"][3, 0] = np.nan
    with pytest.raises(UnfitError, match="no numbers"):
        refuse_broken(missing)
    refuse_broken(still)
    moving = still.copy()
    moving["w"] += np.sin(np.arange(len(moving)) / 20.0)[:, None]
    with pytest.raises(UnfitError, match="never at rest"):
        rest_intervals(moving, RATE_HZ)
    bends = still.copy()
    bends["w"][:, 2] += 0.1 * np.sin(np.arange(len(bends)) / RATE_HZ)  # smooth, as a drive without a shake
    with pytest.raises(UnfitError, match="needs 10 s"):
        gyro.bias(bends, RATE_HZ)
    cruise = still.copy()
    cruise["f"][:, 0] += np.sin(2.0 * np.pi / 11.0 * np.arange(len(cruise)) / RATE_HZ)  # to and fro, as smoothly
    with pytest.raises(UnfitError, match="never at rest"):
        rest_intervals(cruise, RATE_HZ)
    with pytest.raises(UnfitError, match="too short"):
        rest_intervals(still[:50], RATE_HZ)
    with pytest.raises(UnfitError, match="needs 10 s"):
        gyro.bias(still[:500], RATE_HZ)
    with pytest.raises(UnfitError, match=r"changes by 0\.0 K"):
        gyro.slope(still, RATE_HZ)


def test_correct_is_its_formula():
    known = Calibration(
        "s",
        Gyro("", (0.1, 0.2, 0.3), (0, 0, 0), 20.0, (0.01, 0.0, -0.01)),
        Accelerometer("", (1.0, 2.0, 3.0), ((1.1, 0.1, 0.2), (0.0, 0.9, 0.3), (0.0, 0.0, 1.0)), (0, 0, 0), 0.0, 9),
        Mounting("", (10.0, 20.0, 30.0), (0, 0, 0)),
    )
    C = Rotation.from_euler("ZYX", [30.0, 20.0, 10.0], degrees=True).as_matrix()
    sample = np.zeros(1, SAMPLE)
    sample["w"], sample["f"], sample["down"], sample["temperature"] = (1, 2, 3), (4, 5, 6), (0, 0, 1), 25.0
    correct(sample[0], correction(known, (0.0, 0.0, 0.0))[0])
    np.testing.assert_allclose(sample["w"][0], C @ (np.array([1, 2, 3]) - [0.15, 0.2, 0.25]))
    np.testing.assert_allclose(sample["f"][0], C @ np.array(known.accelerometer.matrix) @ [3, 3, 3])
    np.testing.assert_allclose(sample["down"][0], C @ [0, 0, 1])
    sample["w"], sample["temperature"] = (1, 2, 3), np.nan
    correct(sample[0], correction(known, (0.0, 0.0, 90.0))[0])  # the user's mounting goes first
    np.testing.assert_allclose(sample["w"][0], [-1.8, 0.9, 2.7], atol=1e-12)


numbers = st.floats(-1.0, 1.0)  # more is refused
triples = st.tuples(numbers, numbers, numbers)


@settings(max_examples=50)
@given(
    st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=20),
    triples,
    triples,
    st.tuples(triples, triples, triples),
)
def test_what_is_kept_is_read_back_bit_for_bit(tmp_path_factory, serial, a, b, matrix):
    folder = tmp_path_factory.mktemp("state")
    known = Calibration(serial, Gyro("2026-01-02", a, b, 3.5), Accelerometer("x", b, matrix, a, 0.1, 6, math.nan))
    path = calibration.save(known, [folder])
    back = calibration.load(serial, [folder])
    assert repr(back) == repr(known)
    assert path.parent == folder and len(list(folder.iterdir())) == 1


def test_where_calibrations_are_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "service"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "own"))
    expected = ["/var/lib/imud", str(tmp_path / "service"), str(tmp_path / "own/imud")]
    assert list(map(str, calibration.folders())) == expected
    folders = [tmp_path / "absent", tmp_path / "own"]
    assert calibration.save(Calibration("a/../b"), folders) == tmp_path / "own" / "calibration-a_.._b.toml"
    assert calibration.load("other", folders) == Calibration("other")
    (tmp_path / "own" / "calibration-bad.toml").write_text("serial = 3")
    with pytest.raises(BadDataError, match="delete it"):
        calibration.load("bad", folders)
    (tmp_path / "file").touch()
    with pytest.raises(CannotCreateError, match="file: File exists"):
        calibration.save(Calibration("x"), [tmp_path / "file"])


def test_a_full_disk_leaves_nothing_behind_and_what_would_hide_a_new_one_is_said(tmp_path, monkeypatch):
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    made = tempfile.NamedTemporaryFile

    def full(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as full_disk:
        full_disk.setattr(os, "fsync", full)
        with pytest.raises(CannotCreateError, match=r"first: No space left on device\n.*second: No space"):
            calibration.save(Calibration("x"), [first, second])
    assert not list(first.iterdir()) and not list(second.iterdir())

    calibration.save(Calibration("x"), [first])

    def read_only(*arguments, dir, **others):
        if dir == first:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return made(*arguments, dir=dir, **others)

    monkeypatch.setattr(tempfile, "NamedTemporaryFile", read_only)
    with pytest.raises(CannotCreateError, match=r"Read-only file system; calibration-x\.toml in it would be used"):
        calibration.save(Calibration("x"), [first, second])
    assert calibration.save(Calibration("y"), [first, second]).parent == second


def test_the_command_saves_what_the_daemon_loads(tmp_path, capsys):
    samples = recording([np.array([0, 0, -G])], 20.0)
    samples["temperature"] = 21.5
    t, temperature = samples["t_ns"][:, None] * 1e-9, samples["temperature"][:, None]
    table = np.concatenate([t, samples["w"], samples["f"], temperature], axis=1)
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2,temperature_c"
    np.savetxt(tmp_path / "still.csv", table, fmt="%.9g", delimiter=",", header=header, comments="")
    command = ["calibrate", "still", str(tmp_path / "still.csv"), "--serial", "S1", "--state", str(tmp_path)]
    assert main([*command, "--dry-run"]) == 0
    assert "gyro bias: x +0.57" in capsys.readouterr().out
    assert not list(tmp_path.glob("calibration*"))
    assert main(command) == 0
    assert "the daemon" not in capsys.readouterr().err  # which reads another folder
    kept = calibration.load("S1", [tmp_path])
    np.testing.assert_allclose(kept.gyro.bias_radps, BIAS, atol=2e-4)
    assert kept.gyro.temperature_c == pytest.approx(21.5)
    for serial in ("S\n1", "\udcff", "S" * 1000):
        assert main([*command, "--serial", serial]) == 64
    assert main(["calibrate", "faces", *command[2:]]) == 65
    assert "each of its six sides" in capsys.readouterr().err
    assert calibration.load("S1", [tmp_path]) == kept
    estimates = tmp_path / "e.csv"
    replay = ["replay", "--imu", str(tmp_path / "still.csv"), "-o", str(estimates), "--estimator", "suh-standard"]
    yaw = []
    for more in ([], ["--calibration", str(tmp_path / "calibration-S1.toml")]):
        assert main([*replay, *more]) == 0
        yaw.append(float(estimates.read_text().splitlines()[-1].split(",")[9]))
    assert abs(yaw[1]) < 0.5 < abs(yaw[0])  # its model has no bias


@pytest.mark.parametrize("rate_dps", [-5.0, 2.0, 5.0])
@pytest.mark.parametrize("C_vs", RIGHT_HANDED[::5], ids=range(5))
def test_a_start_in_a_slight_curve_gives_the_mounting_of_a_straight_one(C_vs, rate_dps):
    """Closed form: with a constant a forwards and a constant rate r about down the force to the right is r a t."""
    samples, n, rate, acceleration = drive(np.eye(3)), round(5 * RATE_HZ), math.radians(rate_dps), 2.0
    t = np.arange(n) / RATE_HZ
    samples["f"][n : 2 * n, 1] += rate * acceleration * t
    samples["w"][n : 2 * n, 2] += rate
    samples["f"], samples["w"] = samples["f"] @ C_vs, samples["w"] @ C_vs
    matrix, sigma = mounting(samples, RATE_HZ)
    error_deg = math.degrees(Rotation.from_matrix(matrix @ C_vs.T).magnitude())
    assert error_deg < 0.5  # the curve alone turns the acceleration by up to 3.7 deg
    assert 1.0 < math.degrees(sigma[2]) < 2.5
