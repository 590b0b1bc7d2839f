"""Two or three inertial sensors on one body: what they must agree on, and which of them is wrong."""

from types import SimpleNamespace

import numpy as np
import pytest
from attitude_simulation import after, simulate, wobble
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Settings
from imud.daemon.spares import Spares
from imud.drivers.sample import NO_FORCE, NO_RATE, SAMPLE, SATURATED, SUSPECT
from imud.sensor_errors.profiles import PROFILES
from imud.sensors.comparison import Sensor, SensorComparison

RATE, SECONDS = 100, 40.0
MOTIONS = {
    "rest": lambda seed: simulate(SECONDS, RATE, rpy_deg=(20.0, -10.0, 0.0)),
    "motion": lambda seed: simulate(SECONDS, RATE, after(3.0, wobble(seed, 1.5)), moving(seed)),
}
PAIRS = [("m-g350", "m-g350"), ("m-g350", "consumer-mems"), ("consumer-mems", "consumer-mems")]


def moving(seed):
    """A course through space that sways by some metres per second squared."""
    rng = np.random.default_rng(seed)
    size, pace, phase = rng.uniform(0.1, 0.6, 3), rng.uniform(0.5, 3.0, 3), rng.uniform(0.0, 6.0, 3)
    return lambda t: size * np.sin(pace * t[:, None] + phase)


def sensed(truth, profile, seed, place=(0.0, 0.0, 0.0), bias=1.0, late_s=0.0):
    """Samples at a place on the body by a sensor as its data sheet has it, mounted some degrees off."""
    p, rng = PROFILES[profile], np.random.default_rng(seed)
    n = len(truth.t)
    turn = Rotation.from_rotvec(np.radians(1.0) * rng.standard_normal(3))
    w = truth.w
    change = np.gradient(w, truth.t, axis=0)
    f = truth.f + np.cross(change, place) + np.cross(w, np.cross(w, np.broadcast_to(place, w.shape)))
    samples = np.zeros(n, SAMPLE)
    samples["t_ns"] = np.rint((truth.t + late_s) * 1e9)
    for name, true, noise, initial, scale in (
        ("w", w, p.gyro_noise, p.gyro_bias_initial, p.gyro_scale),
        ("f", f, p.accel_noise, p.accel_bias_initial, p.accel_scale),
    ):
        errors = bias * initial * rng.standard_normal(3) + noise * np.sqrt(RATE) * rng.standard_normal((n, 3))
        samples[name] = turn.apply(true) * (1.0 + scale * rng.standard_normal(3)) + errors
    return samples


def compared(*sensors, profiles=("m-g350",) * 3):
    """All verdicts that were given, by the second in which they were."""
    comparison = SensorComparison()
    for name, profile in zip("abc"[: len(sensors)], profiles, strict=False):
        comparison.join(name, PROFILES[profile], has_gyros=True)
    verdicts = []
    for begin in range(0, len(sensors[0]), RATE // 5):
        for name, samples in zip("abc", sensors, strict=False):
            comparison.add_samples(name, samples[begin : begin + RATE // 5])
        comparison.update(set())
        verdicts.append(comparison.verdicts)
    return verdicts


def named(verdicts):
    """Who was said to disagree, and who to be wrong."""
    return {name for each in verdicts for name in each}, {n for each in verdicts for n, v in each.items() if v.is_wrong}


@pytest.mark.thorough
@pytest.mark.parametrize("profiles", PAIRS, ids="+".join)
@pytest.mark.parametrize("motion", MOTIONS)
def test_sensors_as_good_as_their_data_sheets_agree(motion, profiles):
    for seed in range(15):
        truth = MOTIONS[motion](seed)
        first = sensed(truth, profiles[0], 2 * seed)
        second = sensed(truth, profiles[1], 2 * seed + 1, place=(0.4, -0.3, 0.2), late_s=0.005)
        assert named(compared(first, second, profiles=profiles)) == (set(), set()), seed


FAULTS = {  # of the second sensor from 15 s on: what disagrees
    "gyro bias across gravity": (("w", (0.0, 0.12, 0.0)), "rates"),
    "accelerometer bias": (("f", (0.0, 0.0, 1.5)), "forces"),
}


@pytest.mark.thorough
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("which", [0, 1])
def test_at_rest_gravity_says_which_of_two_is_wrong(which, fault):
    (field, change), what = FAULTS[fault]
    for seed in range(10):
        truth = MOTIONS["rest"](seed)
        sensors = [sensed(truth, "m-g350", 2 * seed + k) for k in range(2)]
        sensors[which][field][15 * RATE :] += change
        verdicts = compared(*sensors)
        assert named(verdicts[: 15 * 5]) == (set(), set())
        assert named(verdicts[20 * 5 :]) == ({"ab"[which]}, {"ab"[which]})
        assert verdicts[-1]["ab"[which]].text.startswith(what)


def test_about_the_vertical_nothing_tells_which_of_two_is_wrong():
    """A turntable that turns, or a gyro that says so."""
    for seed in range(10):
        truth = simulate(SECONDS, RATE)
        sensors = [sensed(truth, "m-g350", 2 * seed + k) for k in range(2)]
        sensors[1]["w"][15 * RATE :, 2] += 0.08
        assert named(compared(*sensors)) == ({"a", "b"}, set())


@pytest.mark.thorough
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("which", range(3))
def test_of_three_the_one_that_two_others_contradict_is_wrong(which, motion):
    for seed in range(5):
        truth = MOTIONS[motion](seed)
        sensors = [sensed(truth, "m-g350", 3 * seed + k, place=(0.2 * k, 0.0, 0.0)) for k in range(3)]
        sensors[which]["w"][15 * RATE :, 2] += 0.6
        verdicts = compared(*sensors)
        assert named(verdicts[25 * 5 :]) == ({"abc"[which]}, {"abc"[which]})


@pytest.mark.thorough
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_scale_error_is_never_blamed_on_the_good_sensor(motion):
    """Whichever of the two is asked first, and however they move."""
    for seed in range(10):
        truth = MOTIONS[motion](seed)
        sensors = [sensed(truth, "m-g350", 2 * seed + k) for k in range(2)]
        sensors[seed % 2]["f"][15 * RATE :] *= 1.2
        disagree, odd = named(compared(*sensors))
        assert disagree or motion == "motion"  # there it may be the lever arm
        assert "ab"[1 - seed % 2] not in odd


def test_a_mounting_that_the_settings_do_not_tell_is_found_and_blamed_on_nobody():
    truth = MOTIONS["rest"](0)
    first, second = sensed(truth, "m-g350", 0), sensed(truth, "m-g350", 1)
    second["f"][:, 1:] *= -1.0
    verdicts = compared(first, second)
    assert named(verdicts[5 * 5 :]) == ({"a", "b"}, set())
    assert "imu.mounts" in verdicts[-1]["a"].text


def test_one_whose_own_monitor_finds_a_fault_is_wrong_when_they_disagree():
    truth = simulate(SECONDS, RATE)
    comparison = SensorComparison()
    for number, name in enumerate("ab"):
        samples = sensed(truth, "m-g350", number)
        samples["w"][:, 2] += 0.2 * number
        comparison.join(name, PROFILES["m-g350"], has_gyros=True)
        comparison.add_samples(name, samples)
    comparison.update({"b"})
    assert set(comparison.verdicts) == {"b"}
    assert comparison.verdicts["b"].is_wrong


@pytest.mark.parametrize("fault", [NO_RATE, NO_FORCE, SATURATED])
def test_one_that_is_frozen_or_at_the_end_of_its_range_for_seconds_is_wrong_beside_a_sound_one(fault):
    """Such samples cannot be compared; before, nobody was wrong, and a sensor in use that was frozen stayed so."""
    truth = MOTIONS["motion"](1)
    first, second = sensed(truth, "m-g350", 1), sensed(truth, "m-g350", 2)
    first["flags"][20 * RATE :] |= fault
    verdicts = compared(first, second)
    wrong = [set(each) for each in verdicts]
    assert wrong[: 5 * 23] == [set()] * 5 * 23 and wrong[5 * 25 :] == [{"a"}] * (len(wrong) - 5 * 25)
    assert verdicts[-1]["a"].is_wrong
    second["flags"][20 * RATE :] |= fault
    assert named(compared(first, second)) == (set(), set())


def test_one_whose_range_ends_now_and_then_is_not_wrong():
    truth = MOTIONS["motion"](1)
    first, second = sensed(truth, "m-g350", 1), sensed(truth, "m-g350", 2)
    first["flags"][::3] |= SATURATED
    assert named(compared(first, second)) == (set(), set())


def test_one_that_left_is_not_compared_any_more():
    truth = simulate(SECONDS, RATE)
    comparison = SensorComparison()
    for number, name in enumerate("ab"):
        samples = sensed(truth, "m-g350", number)
        samples["w"] += 0.2 * number
        comparison.join(name, PROFILES["m-g350"], has_gyros=True)
        comparison.add_samples(name, samples)
    comparison.update(set())
    assert comparison.verdicts
    comparison.leave("b")
    assert not comparison.verdicts


@pytest.mark.parametrize("block", [1, 7, 20, 100, 350])
def test_means_are_of_the_sound_samples_of_each_whole_second_in_whatever_blocks_they_come(block):
    samples = sensed(simulate(5.0, RATE), "m-g350", 1)
    samples["flags"][[3, 140, 199, 200, 377]] = SUSPECT
    samples["w"][samples["flags"] == SUSPECT] = np.nan
    sensor = Sensor(PROFILES["m-g350"], True, 0.0)
    for begin in range(0, len(samples), block):
        sensor.add(samples[begin : begin + block])
    assert sorted(sensor.means) == [0, 1, 2, 3]  # the last second has not ended
    for number, means in sensor.means.items():
        rows = samples[number * RATE : (number + 1) * RATE]
        sound = rows[rows["flags"] != SUSPECT]
        np.testing.assert_allclose(means.mean, np.hstack([sound["w"], sound["f"]]).mean(axis=0), rtol=1e-12)


class Port:
    def __init__(self, path):
        self.spec = SimpleNamespace(path=path)


def test_only_faults_of_its_readings_speak_against_a_sensor(monkeypatch):
    """On a busy machine samples are read late, of whichever sensor."""
    spares, faulty = Spares(print, Settings()), []
    monkeypatch.setattr(spares, "_comparison", SimpleNamespace(update=faulty.append))
    monkeypatch.setattr(spares, "_find_mounting", lambda *_: None)
    late = SimpleNamespace(faults=lambda now_ns: ("stale",), reading_faults=lambda: ())
    frozen = SimpleNamespace(faults=lambda now_ns: ("gyro x frozen",), reading_faults=lambda: ("gyro x frozen",))
    spares.sensors = {Port("a"): late, Port("b"): frozen}
    spares.update(Port("c"), late)
    assert faulty == [{"b"}]
