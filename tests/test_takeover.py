"""A spare takes over: its attitude is as good as claimed, however it sits, and whatever the comparison saw of it."""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from navigation_runner import euler_deg
from navigation_simulation import Drive, drive, moved, received, sensed
from replay_in_process import NO_FIXES, new_filter, replay
from scipy.spatial.transform import Rotation

from imud.compile.jit import interpreted
from imud.configuration.settings import Imu, Initial, Settings
from imud.daemon.spares import Spares
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.registry import by_name
from imud.estimators import registry
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID
from imud.pipeline import Filter, InertialPipeline
from imud.sensor_errors.calibration import Calibration
from imud.sensor_errors.mounting_error import MOUNTING_ERROR, added_covariance, set_covariance
from imud.sensor_errors.profiles import PROFILES
from imud.sensors.inertial import Inertial

RATE, LOST_S, TAKEN_S, MINUTE_S = 100, 60.0, 65.0, 60.0
PROFILE, DRIVER = PROFILES["m-g350"], by_name("epson")
NO_TURN = (0.0, 0.0, 0.0)


def journey(rest_s, roll_deg=0.0, pitch_deg=0.0):
    """A drive of a body that leans: at rest for so long, then under way."""
    d = drive(TAKEN_S + MINUTE_S, rate=RATE, rest=rest_s)
    lean = Rotation.from_euler("ZYX", (0.0, pitch_deg, roll_deg), degrees=True)
    return moved(d.t, d.v, d.attitude * lean)


JOURNEYS: dict[tuple[float, ...], Drive] = {}


def journey_of(*parts):
    if parts not in JOURNEYS:
        JOURNEYS[parts] = journey(*parts)
    return JOURNEYS[parts]


class Port:
    def __init__(self, path, line, configured):
        self.spec, self.line, self.configured = SimpleNamespace(path=path), line, configured


class Unit:
    """A sensor on a port, with switch-on errors as its data sheet has them; `sits`: from its axes to the vehicle's."""

    def __init__(self, path, d, rng, sits, settings):
        p = PROFILE
        biases = p.gyro_bias_initial * rng.standard_normal(3), p.accel_bias_initial * rng.standard_normal(3)
        self.rows = sensed(d, rng, p.gyro_noise, p.accel_noise, *biases, mount=sits.inv())
        self.settings = settings
        self.configured = ImuConfigured(Identity("epson", "M-G350", path), float(RATE), 10_000_000, 0, 0)
        line = SimpleNamespace(counters={})
        self.port = Port(path, line, self.configured)
        filter_ = Filter(registry.by_name("tilt"), settings, Initial(), float(RATE))
        self.sensor = Inertial(InertialPipeline(DRIVER, DRIVER.new_state(self.configured), filter_))
        self.sensor.connect(line, DRIVER, self.configured, 0)

    def give(self, spares, sensor, begin, end):
        """These samples, in body axes, to the comparison."""
        n = end - begin
        samples, turn = sensor.pipeline.samples, sensor.pipeline.filter.correction["turn"].reshape(3, 3)
        samples[:n] = self.rows[begin:end]
        for name in ("w", "f"):
            samples[name][:n] = samples[name][:n] @ turn.T
        spares.add_samples(self.port, sensor, n)


class Takeover(NamedTuple):
    out: np.ndarray  # SOLUTION
    error: np.ndarray  # roll, pitch, yaw, deg
    findings: tuple[str, ...]  # of the spare

    @property
    def sigma(self):
        return np.degrees(self.out["sigma_rpy"])

    @property
    def worst(self):
        """Of what counts as valid: the largest error of roll or pitch, and of yaw, in sigmas; 0: never valid."""
        z = np.abs(self.error) / self.sigma
        attitude, heading = (self.out["status"] & bit != 0 for bit in (ATTITUDE_VALID, HEADING_VALID))
        return z[attitude, :2].max(initial=0.0), z[heading, 2].max(initial=0.0)


def compared(rest_s, lean, turned_deg, seed, is_given=False):
    """Both sensors until the first one is lost, where the spare sits `turned_deg` (roll, pitch, yaw) and some 1 deg
    otherwise than the settings say: the drive, its random numbers, settings, sensors, and the spares.
    """
    d, rng = journey_of(rest_s, *lean), np.random.default_rng(seed)
    mounts = {"b": NO_TURN} if is_given else {}
    settings = Settings(imu=Imu(profile="m-g350", mounts=mounts))
    sits = Rotation.from_euler("ZYX", turned_deg[::-1], degrees=True)
    sits = Rotation.from_rotvec(np.radians(1.0) * rng.standard_normal(3)) * sits
    first, second = (Unit(name, d, rng, turn, settings) for name, turn in (("a", Rotation.identity()), ("b", sits)))
    spares = Spares(lambda _: None, settings)
    spares.add(second.port, DRIVER, second.configured, Calibration("b"), settings, (first.port, first.sensor), 0)
    for begin in range(0, round(LOST_S * RATE), RATE):
        first.give(spares, first.sensor, begin, begin + RATE)
        second.give(spares, spares.sensors[second.port], begin, begin + RATE)
        spares.update(first.port, first.sensor)
    spares.remove(first.port)
    return d, rng, settings, first, second, spares


@functools.cache
def handed_over(rest_s, lean, turned_deg, seed, is_given=False):
    """What the spare is left with: the drive, the fixes on it, settings, its samples, calibration and findings."""
    d, rng, settings, _, second, spares = compared(rest_s, lean, turned_deg, seed, is_given)
    spares.remove(second.port)
    calibration = spares.calibration(second.port, second.configured, Calibration("b"), settings, 0)
    fixes = received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1)
    after = second.rows[round(TAKEN_S * RATE) :].copy()
    return d, fixes, settings, after, calibration, spares.findings(second.port)


def take_over(rest_s, lean, turned_deg, seed, is_given=False, estimator="navigation", has_fixes=True):
    """What follows after that."""
    d, fixes, settings, after, calibration, findings = handed_over(rest_s, lean, turned_deg, seed, is_given)
    filter_ = new_filter(estimator, after, settings)
    filter_.calibrate(calibration)
    fixes = fixes[fixes["arrival_ns"] > after["t_ns"][0]] if has_fixes else NO_FIXES
    out, _ = replay(filter_, after, fixes)
    truth = d.attitude[round(TAKEN_S * RATE) :].as_euler("ZYX", degrees=True)[:, ::-1]
    error = (euler_deg(out["q_nb"]) - truth + 180.0) % 360.0 - 180.0
    return Takeover(out, error, findings)


SEEDS = range(20, 24)
LEANS = {"level": (0.0, 0.0), "2 deg": (2.0, 0.0), "10 and 5 deg": (10.0, 5.0)}
TURNS = [(0.0, 0.0, 0.0), (0.0, 0.0, 5.0), (0.0, 0.0, 90.0), (0.0, 0.0, 180.0), (5.0, 0.0, 0.0), (20.0, 0.0, 0.0)]
AT_LAST = -1


@pytest.mark.thorough
@pytest.mark.parametrize("lean", LEANS)
@pytest.mark.parametrize("turned_deg", TURNS, ids=str)
def test_a_spare_at_rest_takes_over_and_then_drives_off(turned_deg, lean):
    """Gravity alone was compared: it has shown roll and pitch, or that how the spare sits is not known."""
    runs = [take_over(75.0, LEANS[lean], turned_deg, seed) for seed in SEEDS]
    assert max(run.worst[0] for run in runs) < 3.5
    assert not any((run.out["status"] & HEADING_VALID).any() for run in runs)
    is_seen = turned_deg[0] > 10.0 or (lean == "10 and 5 deg" and turned_deg[2] > 10.0)
    for run in runs:
        assert (run.out["status"][500:] & ATTITUDE_VALID != 0).all() != is_seen
        assert is_seen or run.sigma[500:, :2].max() < 8.0
        (finding,) = run.findings
        assert ("attitude" if is_seen else "heading") + " is not valid" in finding


@pytest.mark.parametrize("turned_deg", [(0.0, 0.0, 0.0), (0.0, 0.0, 5.0), (5.0, 0.0, 0.0)], ids=str)
def test_one_whose_mounting_the_settings_name_has_a_heading(turned_deg):
    """It is believed to some degrees."""
    for seed in SEEDS:
        run = take_over(75.0, LEANS["2 deg"], turned_deg, seed, is_given=True)
        assert max(run.worst) < 3.5 and not run.findings
        assert run.out["status"][AT_LAST] & HEADING_VALID and 2.5 < run.sigma[AT_LAST, 2] < 4.0


@pytest.mark.thorough
@pytest.mark.parametrize("has_fixes", [True, False], ids=["fixes", "none"])
@pytest.mark.parametrize("turned_deg", TURNS, ids=str)
def test_motion_shows_how_the_spare_sits(turned_deg, has_fixes):
    for seed in SEEDS:
        run = take_over(10.0, LEANS["2 deg"], turned_deg, seed, has_fixes=has_fixes)
        assert max(run.worst) < 3.5 and not run.findings
        assert bool(run.out["status"][AT_LAST] & HEADING_VALID) == has_fixes
        if has_fixes:
            assert run.sigma[AT_LAST].max() < 1.5


@pytest.mark.thorough
@pytest.mark.parametrize("turned_deg", [(0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, 0.0, 180.0)], ids=str)
def test_without_a_receiver_it_is_the_same(turned_deg):
    for seed in SEEDS:
        run = take_over(75.0, LEANS["2 deg"], turned_deg, seed, estimator="attitude", has_fixes=False)
        assert run.worst[0] < 3.5
        assert np.abs(run.error[:900, :2]).max() < 2.5, "at rest gravity has shown it"


@pytest.mark.parametrize(("rest_s", "returns"), [(75.0, True), (10.0, False)], ids=["parked", "under way"])
def test_the_first_one_takes_over_again_where_nothing_showed_how_the_spare_is_turned(rest_s, returns):
    """It defines the body: its mounting is that of the settings."""
    _, _, settings, first, second, spares = compared(rest_s, LEANS["2 deg"], (0.0, 0.0, 90.0), 20)
    spares.remove(second.port)
    used = spares.calibration(second.port, second.configured, Calibration("b"), settings, 0)
    second.sensor.pipeline.filter.calibrate(used)
    assert used.relative_mounting is not None and not spares.should_replace(second.port)
    spares.add(first.port, DRIVER, first.configured, Calibration("a"), settings, (second.port, second.sensor), 0)
    assert spares.should_replace(second.port) == returns
    spares.remove(second.port)
    spares.remove(first.port)
    again = spares.calibration(first.port, first.configured, Calibration("a"), settings, 0)
    assert again.relative_mounting is None


@pytest.mark.thorough
@pytest.mark.parametrize("sigma", [0.03, 0.3, 1.8])
def test_what_the_mounting_adds_is_the_scatter_of_the_vertical(sigma):
    """Of a turn by any angle about one axis of the body, and small ones about all: drawn at random."""
    rng, n, small = np.random.default_rng(5), 200_000, 0.01
    attitude = Rotation.from_euler("ZYX", (40.0, 10.0, -15.0), degrees=True)
    axis = Rotation.from_euler("YX", (3.0, 5.0), degrees=True).inv().apply([0.0, 0.0, 1.0])
    error = np.zeros(1, MOUNTING_ERROR)
    set_covariance(error, sigma**2 * np.outer(axis, axis) + small**2 * np.eye(3))
    matrix = tuple(attitude.as_matrix().ravel())
    n00, n01, _, n11, _, n22 = interpreted(added_covariance)(error.view(np.recarray)[0], matrix)
    turns = Rotation.from_rotvec(sigma * rng.standard_normal((n, 1)) * axis) * Rotation.from_rotvec(
        small * rng.standard_normal((n, 3))
    )
    north, east, _ = (attitude * turns * attitude.inv()).apply([0.0, 0.0, 1.0]).T
    assert (n00, n11, -n01) == pytest.approx(
        (np.mean(east**2), np.mean(north**2), np.mean(north * east)), rel=0.03, abs=3e-5
    )
    along = axis @ attitude.inv().apply([0.0, 0.0, 1.0])
    assert n22 == pytest.approx((sigma * along) ** 2 + small**2, rel=0.01)
