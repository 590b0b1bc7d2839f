"""A sensor that was switched off and on has other biases: the filters open theirs again, and keep what they promise."""

import numpy as np
import pytest
from attitude_simulation import Flaws, errors_deg, measure, simulate
from broad import samples_of, solutions_of
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Imu, Initial, Settings
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.registry import by_name
from imud.drivers.sample import POWER_ON, RECONNECTED, SAMPLE
from imud.estimators.records import HEADING_VALID
from imud.sensor_errors.calibration import Calibration
from imud.sensor_errors.profiles import PROFILES
from imud.sensors.estimator_selection import AWAY_NS, EstimatorSelection

PROFILE, SETTINGS = PROFILES["m-g350"], Settings(imu=Imu(profile="m-g350"))
RATE, BEFORE_S, AFTER_S = 100, 20.0, 45.0
AT_S = np.array([0.1, 1.0, 2.0, 5.0, 10.0, 20.0, 42.0])  # since the first sample after the power-on


def switch_on_biases(rng):
    """Biases of gyro and accelerometer as the data sheet has them from one switch-on to the next."""
    return PROFILE.gyro_bias_initial * rng.standard_normal(3), PROFILE.accel_bias_initial * rng.standard_normal(3)


def replugged(rows, after, away_s):
    """`rows` until BEFORE_S, and those of `after` from `away_s` later on; and the places of AT_S in them."""
    off, on = round(BEFORE_S * RATE), round((BEFORE_S + away_s) * RATE)
    samples = np.concatenate([rows[:off], after[on:]])
    samples["flags"][off] |= POWER_ON
    kept = np.r_[0:off, on : len(rows)]
    return samples, kept, off + np.round(AT_S * RATE).astype(int)


def attitude_errors(seed, away_s):
    """Tilt error, deg, and its sigma, of a sensor at rest, at AT_S after a power-on."""
    rng = np.random.default_rng(seed)
    truth = simulate(BEFORE_S + away_s + AFTER_S, RATE, rpy_deg=tuple(rng.uniform(-30.0, 30.0, 3)))
    rows = np.zeros((2, len(truth.t)), SAMPLE)
    for run in rows:
        gyro_bias, accel_bias = switch_on_biases(rng)
        run["t_ns"] = 10**12 + np.rint(truth.t * 1e9).astype(np.int64)
        run["w"], run["f"] = measure(truth, Flaws(gyro_bias=gyro_bias, accel_bias=accel_bias), rng)
    samples, kept, at = replugged(*rows, away_s)
    out = solutions_of(samples, "m-g350")
    tilt, _ = errors_deg(out["q_nb"], truth.attitude[kept])
    return tilt[at], np.degrees(np.hypot(*out["sigma_rpy"][at, :2].T))


@pytest.mark.thorough
@pytest.mark.parametrize("away_s", [0.3, 3.0])
def test_attitude_after_100_replugs_is_as_good_as_claimed(away_s):
    tilt, sigma = np.swapaxes([attitude_errors(seed, away_s) for seed in range(100)], 0, 1)
    assert (tilt < 3.5 * sigma).all()
    nees = ((tilt / sigma) ** 2).mean(axis=0)
    assert (nees < 1.3).all()
    assert (nees[3:] > 0.5).all()  # and soon not much better than it says, either
    assert (sigma[:, 2:] < 1.0).all()


DIRECTIONS = np.array([[1, 0, 0], [0, 1, 0], [0.7, 0.7, 0], [-0.7, 0, 0.7], [0, 0.6, -0.8], [-0.6, 0, -0.8]])


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("change_dps", [0.2, 0.6, -0.4])
def test_rest_contradicts_a_bias_that_changed_unnoticed(direction, change_dps):
    """Gravity would turn in the body if it turned by such a rate. About the vertical nothing tells."""
    truth = simulate(BEFORE_S + AFTER_S, RATE)
    w, f = measure(truth, Flaws(gyro_bias=(0.002, -0.003, 0.001)), np.random.default_rng(4))
    w[truth.t > BEFORE_S] += np.radians(change_dps) * direction
    out = solutions_of(samples_of(truth.t, w, f), "m-g350")
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    k = round(BEFORE_S * RATE)
    assert (tilt[k:] < 3.5 * np.degrees(np.hypot(*out["sigma_rpy"][k:, :2].T))).all()
    assert np.abs(np.degrees(out["bg"][k + 8 * RATE] - out["bg"][k]) - change_dps * direction).max() < 0.05


PATHS = {
    "rest": Later(drive, BEFORE_S + AFTER_S + 3.0, rate=RATE, rest=1e6),
    "car": Later(drive, BEFORE_S + AFTER_S + 3.0, rate=RATE),
}
YAW = Initial(yaw_deg=float(np.degrees(0.7)))  # in which these paths begin


def navigated(path, seed, away_s, remounted=None):
    """Solutions at AT_S after a power-on, and their attitude errors, rad."""
    rng, d = np.random.default_rng(seed), PATHS[path]
    noise = PROFILE.gyro_noise, PROFILE.accel_noise
    rows = sensed(d, rng, *noise, *switch_on_biases(rng)), sensed(d, rng, *noise, *switch_on_biases(rng), remounted)
    samples, kept, at = replugged(*rows, away_s)
    fixes = received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1)
    solutions, _, _ = navigate(samples, fixes, SETTINGS, YAW)
    whole = np.zeros(len(d.t), solutions.dtype)
    whole["q_nb"][:, 0] = 1.0
    whole[kept] = solutions
    return solutions[at], errors(d, whole)[2][kept][at]


@pytest.mark.thorough
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("away_s", [0.3, 3.0])
def test_navigation_after_replugging_is_as_good_as_claimed(path, away_s):
    runs = [navigated(path, seed, away_s) for seed in range(25)]
    sigma = np.array([out["sigma_rpy"] for out, _ in runs])
    z = np.array([error for _, error in runs]) / sigma
    assert (np.abs(z) < 4.5).all()
    assert ((z**2).mean(axis=(0, 2)) < 2.0).all()
    assert (np.degrees(sigma[:, 2:, :2]) < 6.0).all()
    assert all((out["status"] & HEADING_VALID).all() for out, _ in runs)


@pytest.mark.parametrize("fixes_end_s", [0.0, BEFORE_S, 1e6])
@pytest.mark.parametrize("change_dps", [0.2, 0.6, -0.4])
def test_rest_contradicts_such_a_bias_in_navigation_too(change_dps, fixes_end_s):
    """Whether there are fixes, were some or never was one; after a second nothing is left of it but across gravity."""
    d, (first, after) = PATHS["rest"], (round(BEFORE_S * RATE), round((BEFORE_S + 8.0) * RATE))
    for seed, direction in enumerate(DIRECTIONS[::2]):
        rng = np.random.default_rng(seed)
        samples = sensed(d, rng, PROFILE.gyro_noise, PROFILE.accel_noise, *switch_on_biases(rng))
        samples["w"][first:] += np.radians(change_dps) * direction
        fixes = received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1)
        fixes = fixes[fixes["arrival_ns"] < samples["t_ns"][0] + int(fixes_end_s * 1e9)]
        out, _, _ = navigate(samples, fixes, SETTINGS, YAW)
        error = np.hypot(*errors(d, out)[2][first:, :2].T)
        assert (error < 3.5 * np.hypot(*out["sigma_rpy"][first:, :2].T)).all()
        assert np.degrees(error).max() < 2.0
        assert np.degrees(out["sigma_rpy"][first + 3 * RATE :, :2]).max() < 2.0
        changed = np.degrees(out["bg"][after] - out["bg"][first - 1]) - change_dps * direction
        assert np.abs(changed[:2]).max() < 0.05


@pytest.mark.parametrize("turned_deg", [25.0, 90.0, 180.0])
def test_a_sensor_that_was_turned_while_unplugged_is_levelled_anew_and_has_no_heading(turned_deg):
    turn = Rotation.from_euler("x", turned_deg, degrees=True)
    for seed in range(5):
        out, _ = navigated("rest", seed, 3.0, turn)
        down = Rotation.from_quat(np.roll(out["q_nb"], -1, axis=1)).inv().apply([0.0, 0.0, 1.0])
        tilt = np.arccos(np.clip(down @ turn.apply([0.0, 0.0, 1.0]), -1.0, 1.0))
        assert (tilt < 3.5 * np.hypot(*out["sigma_rpy"][:, :2].T)).all()
        assert np.degrees(out["sigma_rpy"][3:, :2]).max() < 1.0  # from 5 s on: of an unknown bias a rest takes 3 s
        assert not (out["status"] & HEADING_VALID).any()


LINES = b"\n" + b"0512 0512 0717\n" * 3


@pytest.mark.parametrize("name", ["S2", "/dev/ttyUSB1"])
def test_a_spare_has_a_mounting_of_its_own(name):
    """The same board, upside down: its filter sees the vehicle level as the first one's does."""
    chosen = Settings(
        estimator="tilt", ports=("/dev/ttyUSB0", "/dev/ttyUSB1"), imu=Imu(mounts={name: (180.0, 0.0, 0.0)})
    )
    selection, driver = EstimatorSelection(chosen, str), by_name("seraccel")
    tilts = []
    for port, (serial, lines) in enumerate(
        (("S1", b"\n" + b"0512 0512 0717\n" * 3), ("S2", b"\n" + b"0512 0512 0307\n" * 3))
    ):
        configured = ImuConfigured(Identity("seraccel", "", serial), 100.0, 10_000_000, 0, 0)
        sensor = selection.connect(None, driver, configured, Calibration(serial), chosen, 0, port)
        sensor.pipeline.rx[: len(lines)] = bytearray(lines)
        sensor.pipeline.ingest(len(lines), 0)
        tilts.append(sensor.newest["q_nb"].copy())
    assert np.allclose(*np.abs(tilts), atol=1e-3)


@pytest.fixture
def connect():
    """Connect a sensor, by serial number, port and time in s, and read LINES of it; returns the sensor."""
    selection, driver = EstimatorSelection(Settings(estimator="tilt"), str, Initial(yaw_deg=90.0)), by_name("seraccel")

    def connect(serial, port=0, at_s=0.0, still_powered=False):
        identity = Identity("seraccel", "", serial)
        configured = ImuConfigured(identity, 100.0, 10_000_000, 0, 0, still_powered=still_powered)
        at_ns = round(at_s * 1e9)
        sensor = selection.connect(None, driver, configured, Calibration(serial), Settings(), at_ns, port)
        sensor.pipeline.rx[: len(LINES)] = bytearray(LINES)
        sensor.pipeline.ingest(len(LINES), at_ns)
        return sensor

    return connect


def test_the_first_sample_of_each_later_connection_may_follow_a_power_on(connect):
    flags = [connect("1", at_s=at_s).pipeline.samples["flags"][:3].tolist() for at_s in (0.0, 3.0, 6.0)]
    assert flags == [[0, 0, 0], [POWER_ON, 0, 0], [POWER_ON, 0, 0]]


@pytest.mark.parametrize(("serial", "flags"), [("1", RECONNECTED), ("", POWER_ON)])
def test_a_sensor_that_was_not_switched_off_keeps_its_biases_if_its_serial_number_is_the_same(connect, serial, flags):
    connect(serial)
    sensor = connect(serial, at_s=3.0, still_powered=True)
    assert sensor.pipeline.samples["flags"][0] == flags


@pytest.mark.parametrize(
    ("before", "then", "goes_on"),
    [
        (("1", 0), ("1", 0, 3.0), True),
        (("1", 0), ("1", 1, 3.0), True),  # plugged in elsewhere
        (("", 0), ("", 0, 3.0), True),
        (("1", 0), ("", 0, 3.0), True),  # read only: it could not be asked
        (("1", 0), ("2", 0, 3.0), False),
        (("", 0), ("", 1, 3.0), False),  # a spare
        (("1", 0), ("", 1, 3.0), False),
        (("1", 0), ("1", 0, AWAY_NS * 1e-9 + 1.0), False),
    ],
)
def test_a_filter_continues_with_the_same_sensor_only_and_not_after_long(connect, before, then, goes_on):
    first = connect(*before)
    second = connect(*then)
    assert (second.pipeline.filter is first.pipeline.filter) == goes_on
    assert np.isclose(first.newest["q_nb"][3], np.sqrt(0.5))
    if not goes_on:
        assert abs(second.newest["q_nb"][3]) < 0.01  # the initial heading was that of the start
