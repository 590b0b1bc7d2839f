"""What concerns single axes of a sensor, the attitude filter does in its axes, however it is mounted."""

import numpy as np
import pytest
from attitude_runs import assert_whole, samples_from
from attitude_simulation import DEG, Flaws, after, errors_deg, simulate, wobble
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation

from imud.setup import config

MOUNTS = [(0.0, 90.0, 0.0), (30.0, -40.0, 110.0)]


def tilt_deg(samples, truth, mount, profile="auto"):
    """Errors of the tilt of the body, of a sensor whose axes are those of `truth`."""
    settings = config.loads("", (f"imu.profile={profile}", f"imu.mount_rpy_deg={list(mount)}"))
    out = replay(new_filter("attitude", samples, settings), samples)[0]
    assert_whole(out)
    turn = Rotation.from_euler("ZYX", mount[::-1], degrees=True)
    return errors_deg(out["q_nb"], truth.attitude * turn.inv())[0]


def in_motion(seed=1, rate_radps=3.0):
    truth = simulate(40.0, 100.0, after(5.0, wobble(seed, rate_radps)), rpy_deg=(10.0, 5.0, 0.0))
    return truth, samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), seed)


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_rate_beyond_the_range_is_bridged_about_the_axis_of_the_sensor(mount):
    truth, samples = in_motion()
    samples["w"][:, 0] = np.clip(samples["w"][:, 0], -4.0, 4.0)
    straight = tilt_deg(samples, truth, (0.0, 0.0, 0.0))[1000:]
    mounted = tilt_deg(samples, truth, mount)[1000:]
    assert np.sqrt(np.mean(mounted**2)) < 1.1 * np.sqrt(np.mean(straight**2))


@pytest.mark.parametrize("mount", MOUNTS)
def test_of_a_frozen_axis_only_that_of_the_sensor_is_held(mount):
    truth, samples = in_motion(rate_radps=1.0)
    samples["w"][2000:2100, 0] = samples["w"][2000, 0]
    straight = tilt_deg(samples, truth, (0.0, 0.0, 0.0))[2000:2100]
    mounted = tilt_deg(samples, truth, mount)[2000:2100]
    np.testing.assert_allclose(mounted, straight, rtol=0.1, atol=0.3)


@pytest.mark.parametrize("mount", MOUNTS)
def test_truncated_readings_are_found_whatever_the_mounting(mount):
    """The bias at rest is off by half a count else, for good."""
    lsb = 0.0611 * DEG
    truth = simulate(60.0, 285.0, after(20.0, wobble(3, 0.5)))
    samples = samples_from(truth, Flaws(gyro_noise=0.005 * DEG, gyro_bias=(0.01 * DEG, -0.02 * DEG, 0.0)))
    samples["w"] = np.trunc(samples["w"] / lsb) * lsb
    largest = []
    for angles in ((0.0, 0.0, 0.0), mount):
        settings = config.loads("", (f"imu.mount_rpy_deg={list(angles)}",))
        filter_ = new_filter("attitude", samples, settings)
        replay(filter_, samples)
        largest.append(filter_.state["quantization"]["max_error"][0].max() / lsb)
    assert largest[0] > 0.4 and largest[1] > 0.4


def test_a_frozen_axis_beside_one_that_is_no_number_leaves_the_attitude_whole():
    truth, samples = in_motion(rate_radps=1.0)
    samples["w"][2000:2100, 0] = samples["w"][2000, 0]
    frozen = tilt_deg(samples.copy(), truth, (0.0, 0.0, 0.0))
    samples["w"][2060:2070, 1] = np.nan
    np.testing.assert_allclose(tilt_deg(samples, truth, (0.0, 0.0, 0.0)), frozen, atol=0.3)
