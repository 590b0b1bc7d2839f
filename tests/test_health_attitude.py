"""Faults of the sensor through the pipeline into the attitude filter: it says what it still knows, and comes back."""

import numpy as np
import pytest
from attitude_runs import tilt_variance_deg2
from attitude_simulation import MG, Flaws, G, after, errors_deg, measure, simulate, wobble
from broad import samples_of, solutions_of

from imud.drivers.sample import SAMPLE
from imud.estimators.records import ATTITUDE_VALID

RATE = 200
LSB = np.radians(0.0125), 0.125e-3 * G
BEGIN, END, SECONDS = 20.0, 25.0, 40.0
ALL = slice(None)
GYRO, FORCE = 0, 1


def at(seconds):
    return round(seconds * RATE)


@pytest.fixture(scope="module", params=[1, 2])
def body(request):
    """(truth, rates, forces) of a hand-held M-G350 in lively motion after 10 s of rest."""
    seed = request.param
    truth = simulate(SECONDS, RATE, after(10.0, wobble(seed, 1.0)), after(10.0, wobble(seed + 50, 0.7)))
    flaws = Flaws(gyro_bias=(0.005, -0.004, 0.003), accel_bias=(2.0 * MG, -3.0 * MG, 1.0 * MG))
    w, f = measure(truth, flaws, np.random.default_rng(seed))
    return truth, np.rint(w / LSB[0]) * LSB[0], np.rint(f / LSB[1]) * LSB[1]


def spoilt(body, faults):
    """Tilt errors, sigmas (deg) and validity, with faults (sensor, axes, value or None for the last one) for 5 s."""
    truth, w, f = body
    samples = np.zeros(len(truth.t), SAMPLE)
    samples["t_ns"] = 10**12 + np.rint(truth.t * 1e9).astype(np.int64)
    samples["w"], samples["f"], samples["temperature"] = w, f, 25.0
    for sensor, axes, value in faults:
        values = samples["wf"[sensor]]
        values[at(BEGIN) : at(END), axes] = values[at(BEGIN), axes] if value is None else value
    out = solutions_of(samples, "m-g350")
    sigma = np.degrees(out["sigma_rpy"][:, :2].max(axis=1))
    return errors_deg(out["q_nb"], truth.attitude)[0], sigma, (out["status"] & ATTITUDE_VALID) > 0


BLIND = {
    "everything frozen": [(GYRO, ALL, None), (FORCE, ALL, None)],
    "gyro frozen": [(GYRO, ALL, None)],
    "one gyro axis frozen": [(GYRO, 0, None)],
    "one gyro axis zero": [(GYRO, 2, 0.0)],
    "everything zero": [(GYRO, ALL, 0.0), (FORCE, ALL, 0.0)],
    "not a number": [(GYRO, ALL, np.nan), (FORCE, ALL, np.nan)],
}


@pytest.mark.parametrize("faults", BLIND.values(), ids=BLIND)
def test_an_invalid_gyro_ends_the_attitude_within_a_second_and_not_for_long(body, faults):
    error, sigma, valid = spoilt(body, faults)
    assert valid[at(15.0) : at(BEGIN)].all()
    assert not valid[at(BEGIN + 1.0) : at(END)].any()
    assert (error[at(12.0) :] < 6.0 * sigma[at(12.0) :])[valid[at(12.0) :]].all()
    assert valid[at(END + 1.0) :].all()
    assert error[at(END + 1.0) :].max() < 6.0
    assert error[at(END + 8.0) :].max() < 4.0


@pytest.mark.parametrize("axes", [ALL, 1])
@pytest.mark.parametrize("value", [None, 0.0, np.nan])
def test_without_the_accelerometer_the_gyro_carries_the_attitude_on(body, axes, value):
    error, sigma, valid = spoilt(body, [(FORCE, axes, value)])
    assert valid[at(15.0) :].all()
    assert error[at(BEGIN) : at(END)].max() < 3.0
    assert (error[at(12.0) :] < 6.0 * sigma[at(12.0) :]).all()
    assert sigma[at(END) - 1] > sigma[at(BEGIN)]
    assert error[at(END) :].max() < 4.0


@pytest.mark.parametrize("start_s", [0.0, 10.0])
def test_a_hand_that_shakes_the_sensor_by_three_g_does_not_cost_the_accelerometer(start_s):
    truth = simulate(60.0, RATE, after(start_s, wobble(3, 2.0, 2.0, 8.0)), after(start_s, wobble(53, 25.0, 10.0, 25.0)))
    assert np.linalg.norm(truth.f[at(start_s) :], axis=1).mean() > 2.5 * G
    w, f = measure(truth, Flaws(gyro_bias=(0.005, -0.004, 0.003)), np.random.default_rng(3))
    out = solutions_of(samples_of(truth.t, w, f))
    error = errors_deg(out["q_nb"], truth.attitude)[0]
    assert np.sqrt(np.mean(error[at(start_s + 10.0) :] ** 2)) < 2.0  # 13 to 16 when it does
    assert (out["status"][at(start_s + 10.0) :] & ATTITUDE_VALID).all()


def test_rates_that_are_held_return_to_zero():
    """A hand turns to and fro: where the rates before a fault of a second last, the tilt is 83 deg wrong after it."""
    tilts = []
    for seed in range(6):
        truth = simulate(15.0, RATE, after(4.0, wobble(seed, 1.5, 1.0, 9.0)), after(4.0, wobble(seed + 9, 1.0)))
        w, f = measure(truth, Flaws(), np.random.default_rng(seed))
        for first in (at(9.0), at(12.0)):
            w[first : first + RATE] = f[first : first + RATE] = np.nan
        out = solutions_of(samples_of(truth.t, w, f))
        tilts += [errors_deg(out["q_nb"], truth.attitude)[0][at(end)] for end in (9.99, 12.99)]
    assert np.sqrt(np.mean(np.square(tilts))) < 70.0


@pytest.mark.thorough
@pytest.mark.parametrize("axes", [(0,), (1,), (2,), (0, 1, 2)])
@pytest.mark.parametrize("seconds", [0.3, 1.0, 3.0])
def test_axes_that_freeze_while_the_body_turns_are_seldom_wrong_and_sure(axes, seconds):
    """A gyro whose noise is one resolution (BROAD's: 0.061 deg/s); all three: the accelerometer freezes, too."""
    rate, wrong = 285.0, []
    for seed in range(4):
        truth = simulate(
            40.0, rate, after(4.0, wobble(seed, 3.0, 0.5, 5.0)), after(4.0, wobble(seed + 9, 3.0, 1.0, 9.0))
        )
        w, f = measure(truth, Flaws(), np.random.default_rng(seed))
        lsb = np.radians(0.061)
        w = np.rint(w / lsb + 1.2 * np.random.default_rng(seed + 50).standard_normal(w.shape)) * lsb
        samples = samples_of(truth.t, w, f + 0.02 * np.random.default_rng(seed + 70).standard_normal(f.shape))
        for begin in (12.0, 25.0):
            first, last = round(begin * rate), round((begin + seconds) * rate)
            for axis in axes:
                samples["w"][first:last, axis] = samples["w"][first, axis]
                samples["f"][first : last if len(axes) == 3 else first, axis] = samples["f"][first, axis]
        out = solutions_of(samples)
        tilt, _ = errors_deg(out["q_nb"], truth.attitude)
        wrong.append(((tilt > 5.0) & (tilt**2 > 16.0 * tilt_variance_deg2(out))).sum() / rate)
    assert np.mean(wrong) < 0.8
