"""A range that no data sheet declares is learned from plateaus, and smooth motion makes none."""

import numpy as np
import pytest
from attitude_runs import tilt_variance_deg2
from attitude_simulation import DEG, Flaws, after, errors_deg, measure, simulate, wobble
from broad import filter_of, samples_of
from replay_in_process import new_filter, replay

from imud.configuration.settings import Imu, Settings
from imud.drivers.sample import LIMITED_FORCE, LIMITED_RATE, UNCONFIRMED_RATE
from imud.estimators.records import SATURATED, SOLUTION
from imud.sensor_monitor.findings import words
from imud.sensor_monitor.health import recent_findings

RATE, RANGE = 100, 7.4  # Hz, rad/s


def swung(amplitude, hz=2.5, seconds=10.0, seed=1):
    """Samples of a level sensor that is swung to and fro about x after 2 s, with noise of 5 mrad/s."""
    t = np.arange(round(seconds * RATE)) / RATE
    w = 0.005 * np.random.default_rng(seed).standard_normal((len(t), 3))
    w[:, 0] += amplitude * np.sin(2.0 * np.pi * hz * t) * (t > 2.0)
    return samples_of(t, w, np.tile([0.0, 0.0, -9.8], (len(t), 1)) + 0.02 * w)


def flags_of(samples, settings=None):
    """(flags that the sensor monitor sets, its findings in words); rates are unconfirmed, as no force here turns."""
    filter_, seen = new_filter("attitude", samples, settings), samples.copy()
    filter_.run(seen, np.zeros(len(seen), SOLUTION))
    return seen["flags"] & ~UNCONFIRMED_RATE, words(recent_findings(filter_.health))


def test_a_range_is_learned_from_two_plateaus_of_each_side():
    samples = swung(13.0)
    samples["w"][:, 0] = np.clip(samples["w"][:, 0], -RANGE, RANGE)
    clipped = np.abs(samples["w"][:, 0]) == RANGE
    flags, said = flags_of(samples)
    late = np.arange(len(samples)) > 3.5 * RATE
    assert np.array_equal(flags & LIMITED_RATE > 0, clipped & (flags & LIMITED_RATE > 0))
    assert ((flags & LIMITED_RATE > 0) == clipped)[late].all()
    assert said == ("gyro x at the end of its range",)


def ramped(plateau_s, steps=10):
    """Samples of a body that begins to turn at RANGE about y in so many steps, and ends it after `plateau_s`."""
    samples = swung(0.0)
    begin, end = 500, 500 + round(plateau_s * RATE)
    shape = np.interp(np.arange(len(samples)), [begin - steps, begin, end, end + steps], [0.0, RANGE, RANGE, 0.0])
    samples["w"][:, 1] += shape
    return samples, np.flatnonzero(shape == RANGE)


def test_a_first_plateau_counts_as_clipped_while_it_lasts():
    samples, plateau = ramped(0.3)
    flagged = np.flatnonzero(flags_of(samples)[0] & LIMITED_RATE)
    assert set(plateau[5:]) <= set(flagged) <= set(plateau)


def test_a_machine_that_begins_to_turn_evenly_is_doubted_for_a_second():
    samples, plateau = ramped(4.0)
    flagged = np.flatnonzero(flags_of(samples)[0] & LIMITED_RATE)
    assert flagged.max() <= plateau[0] + RATE
    shock, _ = ramped(4.0, steps=1)
    assert not flags_of(shock)[0].any()


@pytest.mark.parametrize(
    ("speed", "rate_hz", "counts", "copies", "seed"),
    [
        (5.0, 50.0, 0.0, 1, 3),
        (5.0, 100.0, 0.002, 1, 3),
        (5.0, 200.0, 0.0, 1, 3),
        (5.0, 300.0, 1e-4, 3, 3),
        (5.0, 400.0, 1e-4, 4, 3),
        (2.5, 100.0, 0.001, 1, 10),
    ],
)
def test_a_machine_that_turns_at_one_rate_again_and_again_has_reached_no_range(speed, rate_hz, counts, copies, seed):
    """After 12 s at rest. Without its noise as evidence the yaw was 100 deg off. Copies: it is polled so many times for
    each of its readings. The last one has a plateau by chance: what comes back by less than the noise adds nothing.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(60.0 * rate_hz)) / rate_hz
    w = 0.003 * rng.standard_normal((len(t), 3))
    turns = np.interp((t - 12.0) % 10.0, [0.0, 0.5, 2.5, 3.0, 10.0], [0.0, speed, speed, 0.0, 0.0]) * (t > 12.0)
    w[:, 2] += turns
    readings = np.arange(len(t)) // copies * copies
    w, turns = w[readings], turns[readings]
    if counts > 0.0:
        w = np.round(w / counts) * counts
    samples = samples_of(t, w, ([0.0, 0.0, -9.8] + 0.02 * rng.standard_normal(w.shape))[readings])
    filter_, seen = new_filter("attitude", samples), samples.copy()
    out = np.zeros(len(seen), SOLUTION)
    filter_.run(seen, out)
    assert (seen["flags"] & LIMITED_RATE > 0).mean() < 0.01
    yaw = np.unwrap(2.0 * np.arctan2(out["q_nb"][:, 3], out["q_nb"][:, 0]))
    turned = yaw[-1] - yaw[np.searchsorted(t, 11.0)]
    missed = (turned - turns.sum() / rate_hz + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(missed) < 2.0 * DEG


def swung_gently():
    """Samples of a body that is swung about x at 1 Hz and exceeds RANGE little, so that it comes there slowly."""
    samples = swung(0.0, seconds=20.0)
    t = samples["t_ns"] * 1e-9
    samples["w"][:, 0] += RANGE * np.minimum(t / 5.0, 1.06) * np.sin(2.0 * np.pi * (t - 4.0)) * (t > 4.0)
    samples["w"][:, 0] = np.clip(samples["w"][:, 0], -RANGE, RANGE)
    return samples, np.abs(samples["w"][:, 0]) == RANGE


def test_a_range_that_is_reached_slowly_is_learned_and_no_axis_is_frozen():
    samples, clipped = swung_gently()
    flags, said = flags_of(samples)
    assert ((flags & LIMITED_RATE > 0) == clipped)[800:].all()
    assert said == ("gyro x at the end of its range",)


def test_readings_just_below_the_end_of_an_exact_range_are_within_it():
    samples, _ = swung_gently()
    below = (np.abs(samples["w"][:, 0]) > 0.98 * RANGE) & (np.abs(samples["w"][:, 0]) < RANGE)
    assert below[800:].sum() > 20
    assert not (flags_of(samples)[0][800:][below[800:]] & LIMITED_RATE).any()


def test_hands_beyond_a_range_that_no_data_sheet_declares_are_seldom_wrong_and_sure():
    """With a range from the second plateau on, and none of slow rises: wrong and sure for 4.6 of the 36 s."""
    seconds = []
    for seed in range(8):
        truth = simulate(
            40.0, 200.0, after(4.0, wobble(seed, 5.0, 1.0, 9.0)), after(4.0, wobble(seed + 9, 3.0, 1.0, 9.0))
        )
        w, f = measure(truth, Flaws(), np.random.default_rng(seed))
        end = 0.7 * np.abs(w).max()
        samples = samples_of(truth.t, np.clip(w, -end, end), f)
        out, _ = replay(filter_of(samples), samples)
        tilt, _ = errors_deg(out["q_nb"], truth.attitude)
        seconds.append(((tilt > 5.0) & (tilt**2 > 16.0 * tilt_variance_deg2(out))).sum() / 200.0)
    assert np.mean(seconds) < 1.5


def test_what_a_first_plateau_cuts_off_is_bridged_from_its_beginning():
    """A turn faster than a range that nobody declared. Bridged from where the plateau is noticed it misses 8.2 deg."""
    missed = []
    for fastest in (9.0, 10.0, 11.0):
        samples = swung(0.0, seconds=4.0)
        t = samples["t_ns"] * 1e-9
        rate = np.clip(fastest * np.sin(2.0 * np.pi * 1.5 * (t - 3.0)), 0.0, None) * ((t > 3.0) & (t < 3.5))
        samples["w"][:, 1] += np.minimum(rate, RANGE)
        out, _ = replay(new_filter("attitude", samples), samples)
        q = out["q_nb"][np.searchsorted(t, 3.4)]
        missed.append(np.degrees(np.sum(rate) / RATE - 2.0 * np.arctan2(q[2], q[0])))
    assert np.mean(np.abs(missed)) < 4.0


def test_a_damaged_reading_hides_no_range():
    """A spike far beyond the range before it is learned, and one after."""
    samples = swung(13.0, seconds=20.0)
    samples["w"][:, 0] = np.clip(samples["w"][:, 0], -RANGE, RANGE)
    expected, _ = flags_of(samples)
    quiet = np.flatnonzero((np.abs(samples["w"][:, 0]) < 1.0) & (np.arange(len(samples)) > 2 * RATE))
    samples["w"][quiet[::40], 0] = 30.0
    flags, _ = flags_of(samples)
    assert (flags & LIMITED_RATE > 0).sum() > 0.8 * (expected & LIMITED_RATE > 0).sum() > 0


def test_a_reading_beyond_a_learned_range_shows_that_it_was_none():
    samples = swung(13.0, seconds=20.0)
    held = np.arange(len(samples)) < 10 * RATE
    samples["w"][held, 0] = np.clip(samples["w"][held, 0], -RANGE, RANGE)
    flags, _ = flags_of(samples)
    assert (flags[held] & LIMITED_RATE).any()
    assert not flags[11 * RATE :].any()


@pytest.mark.thorough
@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 285.0, 1000.0])
def test_smooth_motion_is_not_clipped(rate_hz):
    for seed in range(20):
        fastest = np.random.default_rng(seed).uniform(3.0, 25.0)
        rates, pushes = wobble(seed, 6.0, 0.5, fastest), wobble(seed + 100, 15.0, 1.0, fastest)
        truth = simulate(20.0, rate_hz, after(2.0, rates), after(2.0, pushes))
        w, f = measure(truth, Flaws(), np.random.default_rng(seed))
        flags, _ = flags_of(samples_of(truth.t, w, f))
        assert not flags.any(), seed


def test_an_undeclared_range_is_reported_and_increases_the_sigma():
    truth = simulate(60.0, 100.0, after(5.0, wobble(4, 5.0, 6.0, 14.0)))
    w, f = measure(truth, Flaws(), np.random.default_rng(4))
    samples = samples_of(truth.t, np.clip(w, -RANGE, RANGE), f)
    out, _ = replay(filter_of(samples), samples)
    assert (out["status"] & SATURATED).any()
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    sigma = np.degrees(np.hypot(out["sigma_rpy"][:, 0], out["sigma_rpy"][:, 1]))
    late = truth.t > 20.0
    assert (tilt < 4.0 * sigma)[late].mean() > 0.99


@pytest.mark.parametrize(
    ("column", "end", "flag", "given"),
    [
        ("w", np.radians(120.0), LIMITED_RATE, {"gyro_range_dps": 120.0}),
        ("f", 30.0, LIMITED_FORCE, {"accel_range_g": 3.0}),
    ],
)
def test_the_user_may_give_the_ranges(column, end, flag, given):
    samples = swung(1.0)
    samples[column][500:505, 1] = end
    limited = np.flatnonzero(flags_of(samples, Settings(imu=Imu(**given)))[0] & flag)
    assert np.array_equal(limited, np.arange(501, 505))  # a jump may be a spike: the first sample is withheld
    assert not flags_of(samples)[0].any()


def test_what_a_known_range_cuts_off_is_bridged_and_its_sigma_is_true():
    """With noise in proportion to the rate instead: 6.4 deg, NEES 0.08."""
    errors, nees = [], []
    for seed in range(8):
        rates, pushes = wobble(seed, 5.0, 4.0, 8.0), wobble(seed + 9, 2.0, 4.0, 12.0)
        gently = lambda course: lambda t: course(t) * np.clip((t - 5.0) / 2.0, 0.0, 1.0)[:, None]  # noqa: E731
        truth = simulate(40.0, 200.0, gently(rates), gently(pushes))
        w, f = measure(truth, Flaws(), np.random.default_rng(seed))
        samples = samples_of(truth.t, np.clip(w, -10.0, 10.0), f)
        filter_ = new_filter("attitude", samples, Settings(imu=Imu(gyro_range_dps=float(np.degrees(10.0)))))
        out, _ = replay(filter_, samples)
        tilt, _ = errors_deg(out["q_nb"], truth.attitude)
        errors.append(np.sqrt(np.mean(tilt**2)))
        nees.append(np.mean((tilt**2 / tilt_variance_deg2(out))[1600:]))
    assert np.mean(errors) < 6.0
    assert 0.3 < np.mean(nees) < 1.8


def test_the_ends_of_a_range_need_not_be_symmetric():
    """A calibrated bias shifts them: the first plateau at the nearer end is noticed after one at the farther end."""
    samples = swung(13.0)
    samples["w"][:, 0] = np.clip(samples["w"][:, 0], -RANGE, 0.95 * RANGE)
    first = np.flatnonzero(samples["w"][:, 0] == 0.95 * RANGE)
    samples["w"][first[0] - 30 : first[-1] + 1, 0] = np.clip(
        samples["w"][first[0] - 30 : first[-1] + 1, 0], -RANGE, 9.0
    )
    flags, _ = flags_of(samples)
    nearer = (samples["w"][:, 0] == 0.95 * RANGE) & (np.arange(len(samples)) > 3.5 * RATE)
    assert nearer.any() and (flags & LIMITED_RATE > 0)[nearer].all()


def test_what_is_cut_off_is_part_of_the_sigma_while_the_rate_is_at_the_end():
    samples = swung(0.0, seconds=4.0)
    t = samples["t_ns"] * 1e-9
    rate = np.clip(11.0 * np.sin(2.0 * np.pi * 1.5 * (t - 3.0)), 0.0, None) * ((t > 3.0) & (t < 3.5))
    samples["w"][:, 1] = np.minimum(samples["w"][:, 1] + rate, RANGE)
    out, _ = replay(new_filter("attitude", samples, Settings(imu=Imu(gyro_range_dps=np.degrees(RANGE)))), samples)
    turned = 2.0 * np.arctan2(out["q_nb"][:, 2], out["q_nb"][:, 0])
    missing = np.cumsum(rate) / RATE - turned
    cut = (rate > RANGE) & (missing > 0.02)
    assert cut.sum() > 5
    assert (missing < 3.0 * np.sqrt(0.5 * tilt_variance_deg2(out)) * DEG)[cut].all()


def test_what_is_cut_off_is_as_uncertain_whichever_end_is_steep():
    """A roll that comes to the end of the range slowly and is stopped at once, and one the other way round."""

    def sigma(times, speeds):
        def rates(t):
            swings = np.where(t < 10.0, np.sin(np.pi * t), 0.0)
            return np.outer(swings + np.interp(t - 12.005, times, speeds), [1.0, 0.0, 0.0])

        truth = simulate(12.75, 100.0, after(4.0, rates))
        w, f = measure(truth, Flaws(), np.random.default_rng(1))
        samples = samples_of(truth.t, np.clip(w, -6.0, 6.0), f)
        out, _ = replay(new_filter("attitude", samples, Settings(imu=Imu(gyro_range_dps=np.degrees(6.0)))), samples)
        return np.sqrt(0.5 * tilt_variance_deg2(out)[-1])

    stopped = sigma([0.0, 0.4, 0.6, 0.7], [0.0, 6.0, 7.0, 0.0])  # by the first slope 2.5 deg
    started = sigma([0.0, 0.1, 0.3, 0.7], [0.0, 7.0, 6.0, 0.0])
    assert started > 1.5
    assert 0.8 < stopped / started < 1.25
