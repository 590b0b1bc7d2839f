"""An estimate that diverges from right positions, because tilt or a bias have changed: found, stated and corrected."""

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed
from numpy.testing import assert_allclose

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins import ekf
from imud.estimators.ins.aiding.gnss_reset import inflate_to_diverging
from imud.estimators.ins.aiding.position_divergence import measure_divergence
from imud.estimators.ins.integrity.reset_inflation import limit_inflation
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ATTITUDE, NAVIGATING, STATES
from imud.math.kalman import unpack

D = Later(drive, 200.0, speed=12.0)
PARAMETERS = configure(Settings(), 100.0)
P = PARAMETERS.view(np.recarray)[0]
STEP_S = 120.0  # when the sensor changes


def core():
    return start(PARAMETERS, Initial())["core"][0, 0].view(np.recarray)


def counted(offsets, every_s=1.0, sigma=0.02, noise=0.02):
    """Count of positions that accelerate away, after these offsets, m north, since a used one at 0 s, in a row."""
    c = core()
    c.gnss.last_used_ns, c.gnss.reported_sigma[0], c.gnss.noise_var[0] = 0, sigma, noise**2
    c.alignment.mode, c.integrity.divergence_ns = NAVIGATING, -1
    counts = []
    for i, offset in enumerate(offsets):
        c.nav.t_ns = round(1e9 * every_s * (i + 1))
        c.integrity.reject_count[0] = i + 1
        c.scratch.position_innovation[:2] = offset, 0.0
        interpreted(measure_divergence)(P, c)
        counts.append(int(c.integrity.divergence_count))
    return counts


T = np.arange(1.0, 11.0)


def test_the_double_integral_of_a_wrong_acceleration_diverges():
    assert counted(0.5 * 0.5 * T**2) == list(range(10))  # in the first second no more than the least acceleration
    assert counted(np.radians(1.0) * 9.8 * T**3 / 6.0)[-1] >= 3  # a gyro bias of 1 deg/s about a level axis


@pytest.mark.parametrize(
    "offsets",
    [
        np.full(10, 8.0),  # a jump
        4.0 * T,  # an even drift
        20.0 * np.exp(-T / 8.0),  # positions that come back after an outage
        np.where(T < 3, 15.0, 60.0),  # a jump after a jump, faster than gravity makes it
        8.0 * (-1.0) ** T * T,  # outliers to and fro
    ],
)
def test_jumps_drifts_and_outliers_do_not(offsets):
    assert max(counted(offsets)) < 3


def test_noise_needs_longer():
    """Positions of 2 m: in a second an acceleration of 0.5 m/s^2 is within their noise."""
    offsets = 0.5 * 0.5 * np.arange(1.0, 41.0) ** 2
    precise, noisy = counted(offsets), counted(offsets, sigma=2.0, noise=0.5)
    assert precise.index(3) == 3 < noisy.index(3)


@pytest.mark.parametrize("every_s", [1.0, 0.2])
def test_a_noisy_drift_hardly_ever_diverges(every_s):
    """4 m/s for 20 s, 0.5 m of noise; with the sigma of a single velocity 38 % did, at 5 Hz 82 %."""
    rng, t = np.random.default_rng(6), every_s * np.arange(1.0, 20.0 / every_s)
    runs = [counted(4.0 * t + rng.normal(0.0, 0.5, len(t)), every_s, sigma=1e-3, noise=0.5) for _ in range(60)]
    assert np.mean([max(run) >= 3 for run in runs]) < 0.15


@pytest.mark.parametrize(("every", "sigma", "seed"), [(1.0, 2.0, 2), (1.0, 2.0, 3), (0.2, 1.0, 2)])
def test_the_estimate_does_not_follow_a_receiver_that_drifts(every, sigma, seed):
    """4 m/s for 20 s; with the sigma of a single velocity it was dragged away by 70 to 180 m."""
    rng = np.random.default_rng(seed)
    d = drive(240.0, speed=12.0)
    samples, fixes = sensed(d, rng), received(d, rng, every=every, sigma=sigma, white=0.5)
    for name in ("speed", "course"):
        fixes[name] = np.nan
    t = fixes["t_ns"] * 1e-9 - 100.0
    drifts = (t > 130.0) & (t < 150.0)
    fixes["lat"][drifts] += 4.0 * (t[drifts] - 130.0) / 6.37e6
    out = navigate(samples, fixes)[0]
    assert np.abs(errors(d, out)[0][d.t > 60.0, :2]).max() < 20.0


def test_a_velocity_that_a_wrong_tilt_has_made_shows_no_heading():
    """A robot that stood had its heading to 1 deg then, by the direction of that velocity, and was 28 deg off."""
    c = core()
    for i, sigma in ((3, 1.0), (ATTITUDE, 0.01), (ATTITUDE + 1, 0.01), (ATTITUDE + 2, np.radians(10.0))):
        ekf.decorrelate(c, i, sigma**2)
    ekf.add_covariance(c, 3, ATTITUDE + 2, 0.9 * np.radians(10.0))
    before = unpack(c.cov.P, STATES)
    interpreted(inflate_to_diverging)(P, c, 50.0)
    after = unpack(c.cov.P, STATES)
    assert before[3, ATTITUDE + 2] > 0.0
    assert np.count_nonzero(after[ATTITUDE + 2]) == 1
    assert after[3, 3] > before[3, 3]
    assert after[ATTITUDE + 2, ATTITUDE + 2] > before[ATTITUDE + 2, ATTITUDE + 2]


def changed(samples, w=(0.0, 0.0, 0.0), f=(0.0, 0.0, 0.0)):
    later = samples["t_ns"] * 1e-9 - 100.0 >= STEP_S
    samples["w"][later] += np.radians(w)
    samples["f"][later] += f
    return samples


def centimetres(rng):
    """One position a second, and no velocity."""
    fixes = received(D, rng, sigma=0.01, white=0.01, late=0.1)
    fixes["sigma"], fixes["hdop"] = (0.02, 0.02, 0.04), np.nan
    for name in ("speed", "course"):
        fixes[name] = np.nan
    return fixes


@pytest.mark.parametrize("w", [(1.0, 0.0, 0.0), (0.0, -1.5, 0.0), (0.5, 0.7, 0.4)])
def test_a_step_of_the_gyro_biases_with_positions_of_centimetres(w):
    """Before, right positions were rejected for 8 s and more, and the estimate was up to 150 m off."""
    rng = np.random.default_rng(3)
    out = navigate(changed(sensed(D, rng), w), centimetres(rng))[0]
    p = np.hypot(*errors(D, out)[0][:, :2].T)
    after = D.t > STEP_S
    assert p[after].max() < 10.0
    assert p[D.t > STEP_S + 20.0].max() < 3.0
    sigma = np.hypot(*out["sigma_p"][:, :2].T)
    assert np.mean((p > 4.0 * sigma) & (p > 2.0)) < 0.005


def test_two_outliers_in_a_row_are_no_divergence():
    rng = np.random.default_rng(4)
    fixes = centimetres(rng)
    for k, metres in ((130, 9.0), (131, 30.0)):
        fixes["lat"][k] += metres / 6.37e6
    out = navigate(sensed(D, rng), fixes)[0]
    assert np.abs(errors(D, out)[0][D.t > 60.0, :2]).max() < 1.5


def test_a_heading_that_is_found_ends_the_drift_that_was_stated_and_leaves_a_jump():
    c = core()
    c.integrity.position_inflation[:], c.integrity.velocity_inflation[:] = (9e4, 4.0, 25.0), 100.0
    interpreted(limit_inflation)(P, c)
    assert_allclose(c.integrity.position_inflation, (100.0, 4.0, 25.0))
    assert_allclose(c.integrity.velocity_inflation, 0.0)
