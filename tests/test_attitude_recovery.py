"""The attitude filter when roll and pitch are wrong in the midst of motion: it notices, and finds them again."""

import numpy as np
import pytest
from attitude_runs import Fields, samples_from, tilt_variance_deg2
from attitude_simulation import DEG, Flaws, Truth, after, errors_deg, simulate, steady, wobble
from broad import solutions_of
from scipy.spatial.transform import Rotation

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ahrs.levelling import require_initialisation
from imud.estimators.ahrs.setup import configure, start
from imud.estimators.ahrs.state import ATTITUDE, STATES
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID
from imud.math.kalman import packed_index

SLIP_S = 20.0


def slipped(truth, angle_deg):
    """Samples of a sensor that slips by this angle after SLIP_S, and its attitude. Its biases stay its own."""
    slip = Rotation.from_rotvec(angle_deg * DEG * np.array([0.6, 0.8, 0.0]))
    late = truth.t >= SLIP_S
    turned = lambda vectors: np.where(late[:, None], slip.apply(vectors), vectors)  # noqa: E731
    attitude = Rotation.concatenate([truth.attitude[~late], truth.attitude[late] * slip.inv()])
    body = Truth(truth.t, attitude, turned(truth.w), turned(truth.f))
    return samples_from(body, Flaws(gyro_bias=(0.2 * DEG,) * 3)), attitude


def assert_found(samples, attitude, late, most_deg, most_nees):
    """From then on the tilt is right, and known to be."""
    out = solutions_of(samples, "m-g350")
    tilt, _ = errors_deg(out["q_nb"], attitude)
    assert np.max(tilt[late]) < most_deg
    assert np.mean(tilt[late] ** 2 / tilt_variance_deg2(out)[late]) < most_nees


@pytest.mark.parametrize("angle_deg", [45.0, 90.0, 170.0])
def test_a_sensor_that_slipped_unseen_finds_the_vertical_again(angle_deg):
    """Weight then counts as an acceleration, until the speed it gains is beyond belief."""
    truth = simulate(60.0, 100.0, after(5.0, wobble(1, 1.0)), after(5.0, wobble(2, 1.0, 1.0, 4.0)))
    samples, attitude = slipped(truth, angle_deg)
    out = solutions_of(samples, "m-g350", Initial(yaw_deg=0.0))
    tilt, _ = errors_deg(out["q_nb"], attitude)
    found = truth.t > SLIP_S + 10.0
    assert np.max(tilt[found]) < 8.0
    assert np.max(tilt[truth.t > SLIP_S + 25.0]) < 3.0
    assert np.mean(tilt[found] ** 2 / tilt_variance_deg2(out)[found]) < 2.0
    assert np.all(out["status"][found] & ATTITUDE_VALID)
    assert out["status"][1900] & HEADING_VALID and not np.any(out["status"][found] & HEADING_VALID)


def test_the_tilt_is_found_soon_after_a_gap_in_strong_motion():
    truth = simulate(60.0, 100.0, wobble(8, 2.0), wobble(58, 2.0, 1.0, 4.0))
    keep = (truth.t < 30.0) | (truth.t > 30.9)
    out = solutions_of(samples_from(truth)[keep], "m-g350")
    tilt, _ = errors_deg(out["q_nb"], truth.attitude[keep])
    t = truth.t[keep]
    assert np.max(tilt[t > 40.0]) < 3.0
    assert np.max(tilt[t > 30.9] ** 2 / tilt_variance_deg2(out)[t > 30.9]) < 9.0


def test_a_fast_car_is_not_beyond_belief():
    """From 0 to 45 m/s and back at 0.5 g."""
    speed_up, brake = steady((5.0, 0.0, 0.0), 10.0, 19.0), steady((-5.0, 0.0, 0.0), 30.0, 39.0)
    truth = simulate(50.0, 100.0, acceleration=lambda t: speed_up(t) + brake(t))
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3)), "consumer-mems")
    assert np.max(errors_deg(out["q_nb"], truth.attitude)[0]) < 0.5


@pytest.mark.parametrize("angle_deg", [3.0, 5.0, 10.0])
def test_a_wrong_tilt_at_rest_is_corrected_when_no_acceleration_lasts_so_long(angle_deg):
    truth = simulate(70.0, 50.0)
    samples, attitude = slipped(truth, angle_deg)
    assert_found(samples, attitude, truth.t > SLIP_S + 33.0, 1.0, 2.0)


@pytest.mark.parametrize("seed", range(6))
def test_both_biases_that_step_at_rest_are_no_motion(seed):
    """The force, which is no gravity then, stays where it is while the rate says that it turns."""
    truth, rng = simulate(60.0, 50.0), np.random.default_rng(seed)
    samples = samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), seed)
    samples["f"][truth.t > 20.0] += (0.3, 0.1, 0.2)
    samples["w"][truth.t > 20.0 + rng.uniform(0.0, 2.0)] += 0.7 * DEG * np.array([0.8, -0.6, -1.0])
    out = solutions_of(samples)
    tilt, yaw = errors_deg(out["q_nb"], truth.attitude)
    assert not np.any((tilt > 5.0) & (tilt**2 > 8.0 * tilt_variance_deg2(out)))
    assert np.ptp(yaw[truth.t > 30.0]) < 3.0


@pytest.mark.parametrize("angle_deg", [5.0, 15.0])
def test_a_vehicle_that_stands_where_its_road_shook_it_is_levelled_at_once(angle_deg):
    speed_up, brake = steady((2.0, 0.0, 0.0), 5.0, 10.0), steady((-2.0, 0.0, 0.0), 12.0, 17.0)
    truth = simulate(40.0, 50.0, acceleration=lambda t: speed_up(t) + brake(t))
    samples, attitude = slipped(truth, angle_deg)
    going = (truth.t > 5.0) & (truth.t < 17.0)
    samples["f"] += 0.2 * np.random.default_rng(5).normal(size=samples["f"].shape) * going[:, None]
    out = solutions_of(samples, "m-g350")
    tilt, _ = errors_deg(out["q_nb"], attitude)
    assert np.max(tilt[truth.t > SLIP_S + 7.0]) < 1.0


@pytest.mark.parametrize("angle_deg", [7.0, 12.0])
def test_a_small_error_of_tilt_in_motion_is_noticed_within_about_a_minute(angle_deg):
    truth = simulate(120.0, 50.0, after(5.0, wobble(1, 0.1, 0.5, 4.0)), after(5.0, wobble(2, 0.4, 0.3, 1.5)))
    samples, attitude = slipped(truth, angle_deg)
    assert_found(samples, attitude, truth.t > SLIP_S + 65.0, 5.0, 4.0)


def test_the_yaw_may_be_as_wrong_as_a_lost_tilt_turns_it():
    s = Fields(start(configure(Settings(), 100.0), Initial())[0])
    s.imu.f, s.cov.sigma_tilt = (0.0, -8.0, -6.0), 0.6
    interpreted(require_initialisation)(s)
    yaw = s.cov.P[interpreted(packed_index)(STATES, ATTITUDE + 2, ATTITUDE + 2)]
    assert np.sqrt(yaw) == pytest.approx(np.arctan2(8.0, 6.0))
