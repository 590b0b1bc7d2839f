"""The sensor monitor: what is found on which axis, how soon, and what is not."""

import dataclasses
import math

import numpy as np
import pytest
from attitude_simulation import after, simulate, steady, wobble
from hypothesis import given, settings
from hypothesis import strategies as st
from in_c import in_c

from imud.drivers.jit import kernel
from imud.drivers.sample import LIMITED_FORCE, LIMITED_RATE, NO_FORCE, NO_RATE, NO_RATE_AXES, SAMPLE, SATURATED, SUSPECT
from imud.sensor_errors.profiles import PROFILES
from imud.sensor_monitor.findings import words
from imud.sensor_monitor.health import BLOCK, check_sample, new_health, recent_findings

G = 9.80665
G350 = PROFILES["m-g350"]
GYRO_LSB, ACCEL_LSB = math.radians(0.0125), 0.125e-3 * G
RATE = 500


@kernel
def run(health, samples):
    for i in range(len(samples)):
        check_sample(health[0], samples[i])


run = in_c(run)


def noisy(seconds, rng, rate=RATE, gyro_lsbs=4.0, accel_lsbs=10.0, motion=0.0, shaking_lsbs=0.0):
    """Quantised rates and forces of a level sensor, noise in LSB, that turns to and fro with `motion` rad/s."""
    gyro_lsbs, accel_lsbs = (math.hypot(lsbs, shaking_lsbs) for lsbs in (gyro_lsbs, accel_lsbs))
    t = np.arange(round(seconds * rate)) / rate
    samples = np.zeros(len(t), SAMPLE)
    samples["t_ns"] = 10**12 + np.rint(t * 1e9).astype(np.int64)
    turn = motion * np.sin(2.0 * math.pi * t[:, None] * (0.31, 0.47, 0.23))
    w = np.rint(turn / GYRO_LSB + gyro_lsbs * rng.standard_normal((len(t), 3)))
    weight = G * np.column_stack([0.3 * motion * np.sin(t), 0.2 * motion * np.cos(2 * t), -1.0 + 0 * t])
    f = np.rint(weight / ACCEL_LSB + accel_lsbs * rng.standard_normal((len(t), 3)))
    samples["w"], samples["f"], samples["temperature"] = w * GYRO_LSB, f * ACCEL_LSB, 25.0
    return samples


def judged(samples, profile=G350, rate=RATE):
    health = new_health(profile, rate)
    run(health, samples)
    return health


def at(seconds):
    return round(seconds * RATE)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("motion", [0.0, 1.0])
def test_one_frozen_axis_is_found_within_a_fifth_of_a_second(axis, motion):
    samples = noisy(20.0, np.random.default_rng(axis), motion=motion)
    values = samples["w"] if axis < 3 else samples["f"]
    values[at(10.0) : at(15.0), axis % 3] = values[at(10.0), axis % 3]
    run(health := new_health(G350, RATE), samples)
    mine, other = (NO_RATE, NO_FORCE) if axis < 3 else (NO_FORCE, NO_RATE)
    marked = np.flatnonzero(samples["flags"] & mine)
    assert at(10.0) < marked[0] < at(10.2)
    assert np.array_equal(marked, np.arange(marked[0], at(15.0)))
    assert not (samples["flags"] & other).any()
    assert samples["outage_s"][marked] == pytest.approx((marked - at(10.0)) / RATE, abs=2.5 / RATE)
    assert not samples["outage_s"][: at(10.0)].any()
    assert not samples["outage_s"][at(15.0) :].any()
    name = "xyz"[axis % 3]
    assert words(recent_findings(judged(samples[: at(15.0)]))) == (
        f"{'gyro' if axis < 3 else 'accelerometer'} {name} frozen",
    )
    assert recent_findings(health) == 0  # seconds ago


@pytest.mark.parametrize("axis", range(3))
def test_noise_of_one_resolution_is_enough_to_find_a_frozen_gyro_while_it_turns(axis):
    """As the sensor of BROAD has it; before, two resolutions were wanted, and its frozen axes not found."""
    samples = noisy(20.0, np.random.default_rng(axis), gyro_lsbs=1.2, motion=1.0)
    samples["w"][at(10.0) : at(12.0), axis] = samples["w"][at(10.0), axis]
    run(new_health(G350, RATE), samples)
    marked = np.flatnonzero(samples["flags"] & NO_RATE)
    assert at(10.0) < marked[0] < at(10.2)
    assert np.array_equal(marked, np.arange(marked[0], at(12.0)))
    assert (samples["flags"][marked] // NO_RATE_AXES & 7 == 1 << axis).all()


def test_a_freeze_is_found_between_damaged_frames():
    rng = np.random.default_rng(3)
    samples = noisy(12.0, rng)
    samples["w"][at(10.0) :] = samples["w"][at(10.0)]
    damaged = rng.random(len(samples)) < 0.03
    samples["w"][damaged] += 1.0
    samples["flags"][damaged] = SUSPECT
    run(new_health(G350, RATE), samples)
    marked = np.flatnonzero(samples["flags"] & NO_RATE)
    assert marked[0] < at(10.2)
    assert not samples["flags"][damaged & (np.arange(len(samples)) < at(10.0))].max() & NO_RATE


@pytest.mark.parametrize("lsbs", [0.0, 0.05, 0.2, 0.4, 0.7, 1.0])
@pytest.mark.parametrize("before", ["rest", "motion", "vibration"])
@pytest.mark.parametrize("rate", [50, 500])
def test_a_quiet_sensor_of_coarse_resolution_is_not_frozen(lsbs, before, rate):
    rng = np.random.default_rng(5)
    motion, shaking_lsbs = {"rest": (0.0, 0.0), "motion": (1.0, 0.0), "vibration": (1.0, 30.0)}[before]
    busy = noisy(20.0, rng, rate, lsbs, lsbs, motion, shaking_lsbs)
    samples = np.concatenate([busy, noisy(60.0, rng, rate, lsbs, lsbs)])
    samples["t_ns"] = 10**12 + np.arange(len(samples)) * 10**9 // rate
    # the maker promises as little noise as there is
    quiet = dataclasses.replace(
        G350,
        gyro_noise=min(lsbs, 0.9) * GYRO_LSB / math.sqrt(0.5 * rate),
        accel_noise=min(lsbs, 0.9) * ACCEL_LSB / math.sqrt(0.5 * rate),
    )
    run(new_health(quiet, rate), samples)
    assert not samples["flags"].any()


def test_a_simulated_sensor_without_noise_is_not_frozen():
    t = np.arange(60 * RATE) / RATE
    samples = noisy(60.0, np.random.default_rng(0))
    move = np.where((t > 10.0) & (t < 40.0), np.sin(t), 0.0)
    samples["w"] = move[:, None] * (0.3, 0.2, 1.0)
    samples["f"] = np.column_stack([move, 0.5 * move, -G + 0.0 * t])
    run(new_health(G350, RATE), samples)
    assert not samples["flags"].any()


def of_device(samples, rate=RATE):
    """The sensor monitor's record after these samples of a device, which it has marked."""
    health = new_health(G350, rate, is_device=True)
    run(health, samples)
    return health


@pytest.mark.parametrize("rate", [50, 500])
@pytest.mark.parametrize("different", [0, 1, 30, 200])
def test_a_device_that_repeats_one_sample_from_its_first_block_on_is_reported_until_it_changes(rate, different):
    samples = noisy(60.0, np.random.default_rng(different), rate)
    first, end = different + max(rate, 100), 40 * rate  # 1 s, 100 samples at least
    samples["w"][different:end], samples["f"][different:end] = samples["w"][different], samples["f"][different]
    repeated = ("inertial sensor sends the same sample again and again",)
    assert words(recent_findings(of_device(samples[:first], rate))) == ()
    assert words(recent_findings(of_device(samples[: first + 1], rate))) == repeated
    assert words(recent_findings(of_device(samples[:end], rate))) == repeated
    assert words(recent_findings(of_device(samples, rate))) == ()
    assert not samples["flags"].any()


@pytest.mark.parametrize("axes", [(0,), (1,), (2,), (0, 1), (3,), (5,), (3, 4)])
@pytest.mark.parametrize("different", [0, 30])
@pytest.mark.parametrize("motion", [0.0, 1.0])
def test_an_axis_that_never_changes_beside_others_that_do_is_found_within_two_seconds(axes, different, motion):
    samples = noisy(10.0, np.random.default_rng(9), motion=motion)
    values = samples["w"] if axes[0] < 3 else samples["f"]
    for axis in axes:
        values[different:, axis % 3] = 0.0
    of_device(samples)
    mine, other = (NO_RATE, NO_FORCE) if axes[0] < 3 else (NO_FORCE, NO_RATE)
    marked = np.flatnonzero(samples["flags"] & mine)
    assert np.array_equal(marked, np.arange(max(different + RATE, 2 * BLOCK), len(samples)))
    assert not (samples["flags"] & other).any()
    assert samples["outage_s"][marked] == pytest.approx((marked - different) / RATE, abs=2.5 / RATE)
    if mine == NO_RATE:
        assert (samples["flags"][marked] // NO_RATE_AXES & 7 == sum(1 << axis for axis in axes)).all()


def test_gyros_that_a_device_does_not_have_are_not_frozen():
    samples = noisy(10.0, np.random.default_rng(10))
    samples["w"][:, :2] = 0.0
    run(new_health(G350, RATE, is_device=True, gyro_axes=(False, False, True)), samples)
    assert not samples["flags"].any()


@pytest.mark.parametrize("lsbs", [0.3, 0.5, 0.7])
def test_a_quieter_axis_of_a_device_is_not_frozen(lsbs):
    samples = noisy(60.0, np.random.default_rng(11))
    quiet = noisy(60.0, np.random.default_rng(12), gyro_lsbs=lsbs, accel_lsbs=lsbs)
    for kind in ("w", "f"):
        samples[kind][:, 1] = quiet[kind][:, 1]
    of_device(samples)
    assert not samples["flags"].any()


def test_a_device_of_counts_coarser_than_its_noise_may_repeat_samples_once_it_has_changed():
    """Counts of 20 times the noise: all axes are constant at rest."""
    samples = noisy(60.0, np.random.default_rng(7), gyro_lsbs=0.05, accel_lsbs=0.05)
    assert (np.ptp(samples["w"], axis=0) == 0.0).all()
    assert words(recent_findings(of_device(samples))) == ("inertial sensor sends the same sample again and again",)
    samples["w"][at(1.0)] += GYRO_LSB
    assert words(recent_findings(of_device(samples))) == ()


@pytest.mark.parametrize("lsbs", [0.25, 0.5, 1.0, 10.0])
def test_a_device_with_noise_of_a_quarter_of_its_counts_is_never_one_that_repeats_itself(lsbs):
    samples = noisy(60.0, np.random.default_rng(8), gyro_lsbs=lsbs, accel_lsbs=lsbs)
    assert words(recent_findings(of_device(samples))) == ()
    assert not samples["flags"].any()


def test_a_sensor_that_repeats_its_values_regularly_is_not_frozen():
    slow = noisy(60.0, np.random.default_rng(1), rate=20)
    samples = np.repeat(slow, 25)
    samples["t_ns"] = 10**12 + np.arange(len(samples)) * 2_000_000
    run(new_health(G350, RATE), samples)
    assert not samples["flags"].any()


@settings(max_examples=50)
@given(st.integers(0, 10**6), st.floats(0.0, 30.0), st.sampled_from([15.625, 125.0, 1000.0]), st.floats(0.0, 1.0))
def test_noise_alone_is_never_a_finding(seed, lsbs, rate, motion):
    samples = noisy(20000.0 / rate, np.random.default_rng(seed), rate, lsbs, lsbs, motion)
    run(new_health(G350, rate), samples)
    assert not samples["flags"].any()


def test_the_ends_of_the_range_are_reported_by_axis():
    samples = noisy(5.0, np.random.default_rng(2))
    samples["w"][at(3.5) : at(3.7), 1] = -G350.gyro_range
    samples["f"][at(4.0) : at(4.1), 0] = G350.accel_range
    health = judged(samples)
    limited_rate = np.flatnonzero(samples["flags"] & LIMITED_RATE)
    limited_force = np.flatnonzero(samples["flags"] & LIMITED_FORCE)
    assert np.array_equal(limited_rate, np.arange(at(3.5) + 1, at(3.7)))  # the jump itself may be a spike: withheld
    assert np.array_equal(limited_force, np.arange(at(4.0) + 1, at(4.1)))
    assert (samples["flags"][limited_rate] & SATURATED).all()
    assert not (samples["flags"] & (NO_RATE | NO_FORCE)).any()
    assert words(recent_findings(health)) == (
        "gyro y at the end of its range",
        "accelerometer x at the end of its range",
    )


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e6])
def test_what_cannot_be_is_not_taken(wrong):
    samples = noisy(4.0, np.random.default_rng(2))
    samples["w"][at(2.5) : at(2.6), 2] = wrong
    samples["f"][at(3.0) : at(3.1), 2] = wrong
    health = judged(samples)
    assert np.array_equal(np.flatnonzero(samples["flags"] & NO_RATE), np.arange(at(2.5), at(2.6)))
    assert np.array_equal(np.flatnonzero(samples["flags"] & NO_FORCE), np.arange(at(3.0), at(3.1)))
    assert samples["outage_s"][at(2.6) - 1] == pytest.approx(0.1, abs=0.003)
    assert words(recent_findings(health)) == ("gyro z impossible", "accelerometer z impossible")


def test_nothing_at_all_is_found_at_once_even_from_the_start():
    samples = noisy(1.0, np.random.default_rng(2))
    samples["w"] = samples["f"] = 0.0
    assert "shows nothing" in words(recent_findings(judged(samples)))[0]
    assert np.flatnonzero(samples["flags"] & NO_FORCE)[0] < 10


def test_a_steady_force_far_from_gravity_is_a_fault_after_ten_seconds_until_it_is_near_for_one():
    samples = noisy(60.0, np.random.default_rng(2))
    samples["f"][at(30.0) : at(50.0)] *= 0.3
    samples["f"][at(45.0) : at(45.5)] /= 0.3
    judged(samples)
    marked = np.flatnonzero(samples["flags"] & NO_FORCE)
    assert np.array_equal(marked, np.arange(at(40.0) - 1, at(51.0) - 1))
    assert samples["outage_s"][marked[0]] == pytest.approx(10.0, abs=0.01)


@pytest.mark.parametrize("scale", [0.5, 0.6, 2.0])
def test_a_sensor_whose_range_is_not_what_is_assumed_shows_it_at_rest_whatever_its_bias(scale):
    for bias in (-0.3, 0.3):
        samples = noisy(20.0, np.random.default_rng(2))
        samples["f"] *= scale
        samples["f"][:, 2] += bias
        assert "far from gravity" in " ".join(words(recent_findings(judged(samples))))


@pytest.mark.parametrize("g", [0.1, 2.3, 5.0])
def test_a_force_far_from_gravity_of_a_sensor_that_turns_is_no_fault(g):
    """An aircraft pulls 2.3 g in a turn of 65 deg bank; at 100 m/s it turns by 0.2 rad/s. A hand shakes harder."""
    samples = noisy(60.0, np.random.default_rng(2))
    samples["f"][at(5.0) :] *= g
    samples["w"][at(5.0) :, 2] += 0.2
    judged(samples, PROFILES["consumer-mems"])
    assert not samples["flags"].any()


def test_a_sensor_that_is_shaken_without_turning_is_no_fault():
    samples = noisy(60.0, np.random.default_rng(2))
    t = samples["t_ns"] * 1e-9
    shaking = 2.0 * math.pi * 3.0 * t[:, None] + (0.0, 0.5 * math.pi)
    samples["f"][:, :2] += 6.0 * G * np.sin(shaking)  # never near gravity
    judged(samples, PROFILES["consumer-mems"])
    assert not samples["flags"].any()


def test_an_impossible_temperature_is_a_finding_and_a_damaged_word_is_none():
    samples = noisy(1.0, np.random.default_rng(2))
    samples["temperature"] = math.nan  # has none
    assert recent_findings(judged(samples)) == 0
    samples["temperature"] = 25.0
    samples["temperature"][::30] = -115.0  # words that were damaged on the wire
    assert recent_findings(judged(samples)) == 0
    samples["temperature"] = 1000.0
    assert words(recent_findings(judged(samples))) == ("temperature is impossible",)


def test_an_intermittent_finding_stays():
    samples = noisy(5.0, np.random.default_rng(2))
    samples["w"][at(1.0) :: 50, 0] = G350.gyro_range
    health = new_health(G350, RATE)
    run(health, samples[: at(1.0) + 1])
    seen = set()
    for k in range(at(1.0) + 1, len(samples), 10):
        run(health, samples[k : k + 10])
        seen.add(recent_findings(health))
    assert len(seen) == 1


def held(samples, first, count):
    """The sample `first` comes again and again."""
    for name in ("w", "f"):
        samples[name][first : first + count] = samples[name][first]
    return samples


def is_frozen(health):
    """Of all axes together: (any rate, any force)."""
    found = health["found_count"][0]
    return found[:3].any(), found[3:6].any()


@pytest.mark.parametrize("gyro_lsbs", [0.3, 4.0])
def test_a_sample_that_is_repeated_for_a_tenth_of_a_second_is_frozen_also_in_axes_that_alone_may_repeat(gyro_lsbs):
    samples = noisy(20.0, np.random.default_rng(1), rate=100, gyro_lsbs=gyro_lsbs, motion=1.0)
    assert is_frozen(judged(samples.copy(), rate=100)) == (False, False)
    health = judged(held(samples, 1500, 13), rate=100)
    assert is_frozen(health) == (True, True)
    assert health["found_count"][0][:6].max() <= 4


def test_accelerometers_that_freeze_at_rest_do_not_make_coarse_gyros_frozen():
    samples = noisy(20.0, np.random.default_rng(1), gyro_lsbs=0.0)
    samples["f"][at(10.0) : at(11.0)] = samples["f"][at(10.0)]
    assert is_frozen(judged(samples)) == (False, True)


def simulated(truth):
    """A sensor without noise."""
    samples = np.zeros(len(truth.t), SAMPLE)
    samples["t_ns"] = 10**12 + np.rint(truth.t * 1e9).astype(np.int64)
    samples["w"], samples["f"], samples["temperature"] = truth.w, truth.f, 25.0
    return samples


@pytest.mark.parametrize("rate", [20, 57])
def test_a_sample_that_is_repeated_in_motion_is_frozen_where_the_noise_is_not_known(rate):
    """The rates, 3 rad/s, would have turned the force."""
    samples = simulated(simulate(20.0, rate, wobble(1, 3.0), wobble(2, 2.0)))
    assert is_frozen(judged(samples.copy(), rate=rate)) == (False, False)
    health = judged(held(samples, 7 * rate, rate), rate=rate)
    assert is_frozen(health) == (True, True)
    assert health["found_count"][0][:6].min() >= rate - 1 - max(4, round(0.1 * rate))


@pytest.mark.parametrize(("rate", "rates"), [(20, 1.0), (57, 3.0)])
def test_a_sample_that_was_repeated_for_a_moment_hides_no_later_one(rate, rates):
    """The rates of the first would have turned the force by 3 deg, which shows nothing yet."""
    samples = simulated(simulate(20.0, rate, wobble(1, rates), wobble(2, 2.0)))
    across = np.linalg.norm(np.cross(samples["w"], samples["f"]), axis=1) / np.linalg.norm(samples["f"], axis=1)
    count = 9
    first = 2 * rate + np.argmin(abs(across[2 * rate : 16 * rate] * count / rate - 0.06))
    assert 0.02 < across[first] * count / rate < 0.1
    health = judged(held(samples, first, count).copy(), rate=rate)
    assert is_frozen(health) == (False, False)
    later = 17 * rate
    assert across[later] > 0.5
    assert is_frozen(judged(held(samples, later, rate), rate=rate)) == (True, True)


def circling(begin):
    """5 m/s^2 across at 0.5 rad/s, from then on."""
    return (
        steady((0.0, 0.0, 0.5), begin, 99.0),
        lambda t: (
            5.0
            * np.column_stack([-np.sin(0.5 * (t - begin)), np.cos(0.5 * (t - begin)), 0.0 * t])
            * (t > begin)[:, None]
        ),
    )


@pytest.mark.parametrize(("rest_s", "tilts"), [(1.0, 0.3), (0.0, 0.0)])
def test_a_simulated_circle_without_noise_is_not_frozen(rest_s, tilts):
    """All axes repeat, and the force is across the rate; they did so at rest before, or some on level ground."""
    turn, across = circling(20.0)
    shake, tilt = after(rest_s, wobble(1, 1.0)), after(rest_s, wobble(2, tilts))

    def until_then(t):
        return (t <= 20.0)[:, None]

    samples = simulated(
        simulate(
            40.0,
            100,
            lambda t: (tilt(t) + [0.0, 0.0, 0.3] * shake(t)) * until_then(t) + turn(t),
            lambda t: shake(t) * [1.0, 1.0, tilts] * until_then(t) + across(t),
        )
    )
    held(samples, 2001, 1999)
    assert is_frozen(judged(samples, rate=100)) == (False, False)


@pytest.mark.parametrize("times", [2, 4, 20])
def test_samples_that_are_read_several_times_are_not_frozen(times):
    samples = noisy(40.0, np.random.default_rng(1), motion=1.0)
    for name in ("w", "f"):
        samples[name] = np.repeat(samples[name], times, axis=0)[: len(samples)]
    assert is_frozen(judged(samples)) == (False, False)


def test_single_holds_that_are_frozen_do_not_become_usual():
    samples = noisy(40.0, np.random.default_rng(1), rate=100, motion=1.0)
    for first in range(1000, 3800, 200):
        held(samples, first, 18)
    health = judged(held(samples, 3800, 40), rate=100)
    assert health["found_count"][0][:6].min() >= 14 * 5 + 25
