"""Recordings for the golden traces of the attitude filter, one for each class of fault and of motion."""

import numpy as np
from attitude_simulation import DEG, MG, Flaws, after, car_that_stops, measure, simulate, steady
from golden_run import Recording, golden
from multicopter_simulation import flight
from simulated import samples_of

from imud.configuration.settings import Imu, Initial, Settings

UNDRIVEN, HEADED = Initial(), Initial(yaw_deg=20.0)
BIASES = Flaws(gyro_bias=(0.2 * DEG, -0.1 * DEG, 0.15 * DEG), accel_bias=(2.0 * MG, -3.0 * MG, 1.0 * MG))
COUNT = 2000.0 * DEG / 2**15  # of a gyro of 2000 deg/s and 16 bits


def wobble(seed, amplitude, slowest=0.3, fastest=2.5):
    """As `attitude_simulation.wobble`, from a generator whose stream never changes (NEP 19)."""
    rng = np.random.RandomState(seed)
    frequency, phase = rng.uniform(slowest, fastest, (3, 3)), rng.uniform(0.0, 2.0 * np.pi, (3, 3))
    return lambda t: amplitude * np.sin(frequency * t[:, None, None] + phase).sum(2) / np.sqrt(1.5)


def lively(duration=60.0, rate_hz=100.0, still=10.0, turning=0.8, moving=1.0, rpy_deg=(10.0, 5.0, 0.0)):
    """In a hand, after a rest."""
    return simulate(
        duration, rate_hz, after(still, wobble(1, turning)), after(still, wobble(2, moving, 1.0, 4.0)), rpy_deg
    )


def shown(truth, flaws=BIASES, seed=0):
    """SAMPLE rows of a sensor with these flaws."""
    values = np.hstack(measure(truth, flaws, np.random.RandomState(seed)))
    return samples_of(truth.t, values)


def judged(samples, initial=UNDRIVEN, profile="m-g350", estimator="attitude"):
    return Recording(estimator, samples, settings=Settings(imu=Imu(profile=profile)), initial=initial)


@golden("attitude")
def hand():
    return judged(shown(lively()), HEADED)


@golden("attitude")
def start_in_motion():
    return judged(shown(lively(still=-1.0, rpy_deg=(30.0, -20.0, 0.0))))


@golden("attitude")
def start_in_a_steady_turn():
    """On a roundabout: 2.5 m/s, 0.8 rad/s."""

    def centripetal(t):
        return 2.0 * np.column_stack([-np.sin(0.8 * t), np.cos(0.8 * t), 0.0 * t])

    truth = simulate(40.0, 100.0, lambda t: wobble(1, 0.1)(t) + np.array([0.0, 0.0, 0.8]), centripetal)
    return judged(shown(truth))


@golden("attitude")
def steady_turn_before_the_first_rest():
    """The same roundabout, left after half a minute; of all samples every third one is lost."""

    def rates(t):
        return (wobble(1, 0.1)(t) + np.array([0.0, 0.0, 0.8])) * (t < 30.0)[:, None]

    def centripetal(t):
        return 2.0 * np.column_stack([-np.sin(0.8 * t), np.cos(0.8 * t), 0.0 * t]) * (t < 30.0)[:, None]

    samples = shown(simulate(50.0, 150.0, rates, centripetal))
    return judged(samples[np.arange(len(samples)) % 3 != 1])


@golden("attitude")
def start_with_strong_forces():
    """The first forces are far from gravity."""
    truth = lively(30.0, still=-1.0)
    samples = shown(truth)
    samples["f"][:30] *= 3.0
    return judged(samples)


@golden("attitude")
def start_far_from_gravity():
    """At first too heavy to show the vertical, then so light that it just may."""
    samples = shown(lively(40.0, still=-1.0))
    samples["f"][:30] *= 2.2
    samples["f"][30:60] *= 0.55
    return judged(samples)


@golden("attitude")
def all_initial_values():
    given = Initial(roll_deg=10.0, pitch_deg=5.0, yaw_deg=20.0, lat_deg=48.0, height_m=500.0, lon_deg=11.0)
    return judged(shown(lively()), given)


@golden("attitude")
def rest():
    """Long, a little tilted, from the start."""
    return judged(shown(simulate(240.0, 100.0, rpy_deg=(3.0, -2.0, 0.0))), HEADED)


@golden("attitude")
def rest_with_a_step_of_the_bias():
    truth = simulate(200.0, 100.0)
    samples = shown(truth)
    samples["w"][truth.t > 60.0] += (0.03 * DEG, -0.15 * DEG, 0.1 * DEG)
    samples["w"][truth.t > 100.0] -= (0.5 * DEG, 0.0, 0.0)
    return judged(samples)


@golden("attitude")
def rest_with_steps_of_both_biases():
    """The force is no gravity then, and stays where it is while the rate says that it turns."""
    truth = simulate(60.0, 100.0)
    samples = shown(truth)
    samples["f"][truth.t > 20.0] += (0.3, 0.1, 0.2)
    samples["w"][truth.t > 21.0] += (0.6 * DEG, -0.4 * DEG, -0.7 * DEG)
    return judged(samples)


def graded(duration, rate_hz, begin, kinds):
    """What is added to the samples of a rest: for each kind 8 spells of 4 s, ever stronger, with 4 s of rest between.

    kinds: (column, axis, least, most, course over the t s of a spell).
    """
    t = np.arange(round(duration * rate_hz)) / rate_hz
    added = {"w": np.zeros((len(t), 3)), "f": np.zeros((len(t), 3))}
    for column, axis, least, most, course in kinds:
        for size in np.geomspace(least, most, 8):
            spell = (t >= begin) & (t < begin + 4.0)
            added[column][spell, axis] += size * course(t[spell] - begin)
            begin += 8.0
    return added


@golden("attitude")
def disturbed_rest():
    """By rates and forces about as large as a rest may have."""
    short, ramp = lambda t: (t < 0.05).astype(float), lambda t: np.minimum(t / 2.0, 1.0)
    kinds = (
        ("w", 1, 0.025, 0.06, short),
        ("f", 0, 0.35, 0.9, short),
        ("f", 1, 0.07, 0.16, ramp),
        ("w", 2, 3e-4, 3e-3, ramp),
    )
    samples = shown(simulate(270.0, 100.0, rpy_deg=(2.0, 1.0, 0.0)))
    for column, added in graded(270.0, 100.0, 10.0, kinds).items():
        samples[column] += added
    return judged(samples, HEADED)


@golden("attitude")
def disturbed_rest_of_a_consumer_sensor():
    """By single rates, about as large as a rest may have."""
    single = lambda t: (np.arange(len(t)) % 100 == 50).astype(float)  # noqa: E731
    samples = shown(simulate(90.0, 100.0))
    samples["w"] += graded(90.0, 100.0, 10.0, (("w", 1, 0.025, 0.06, single),))["w"]
    return judged(samples, profile="consumer-mems")


@golden("attitude")
def fast_turntable():
    """About as fast as a bias may be."""
    edges = ((0.0, 1.8), (20.0, 0.0), (40.0, 2.15), (60.0, 0.0), (80.0, -2.4))
    courses = [steady((0.0, 0.0, rate * DEG), begin, begin + 20.0) for begin, rate in edges]
    return judged(shown(simulate(110.0, 100.0, lambda t: sum(course(t) for course in courses))))


@golden("attitude")
def turntable_that_tilts():
    """It turns at the start, which looks like a bias; when it stops it leans otherwise, as a vehicle in a curve."""
    turning, tilting = steady((0.0, 0.0, 1.0 * DEG), -1.0, 30.0), steady((1.0 * DEG, 0.0, 0.0), 30.0, 33.0)
    return judged(shown(simulate(130.0, 100.0, lambda t: turning(t) + tilting(t))))


@golden("attitude")
def accelerometer_scale_error():
    """More than a good board's error explains, by a little."""
    flaws = Flaws(accel_bias=(0.0, 0.0, -26.0 * MG), gyro_bias=(0.5 * DEG,) * 3)
    return judged(shown(lively(40.0), flaws), profile="auto")


@golden("attitude")
def coarse_counts():
    """Coarser than is looked at for how readings were cut off."""
    return cut_off(np.trunc, (0.3, -0.2, -0.4), count=0.22 * DEG)


@golden("attitude")
def fine_counts():
    """In which the noise hides each single one."""
    return cut_off(np.trunc, (0.03, -0.02, 0.04), still=1e3, duration=60.0, count=0.0105 * DEG)


@golden("attitude")
def counts_hidden_by_noise():
    """The noise nearly hides each single one: it takes long to learn from it."""
    return cut_off(np.trunc, (0.03, -0.02, 0.04), still=1e3, duration=130.0, count=0.0145 * DEG)


@golden("attitude")
def counts_with_an_offset():
    """A bias that was taken out left them a little beside whole numbers, by as much as they just may be."""
    return cut_off(np.trunc, (0.08, -0.05, -0.4), 8.11 * COUNT / DEG, still=60.0)


@golden("attitude")
def heading_of_a_long_drive():
    """Until it is not trusted any more."""
    return judged(shown(lively(150.0, 50.0, turning=1.5), seed=4), HEADED, profile="consumer-mems")


@golden("attitude")
def turntable():
    """Slow and even, and then not at all: no bias."""
    return judged(shown(simulate(110.0, 100.0, steady((0.0, 0.0, 1.0 * DEG), 15.0, 85.0))), HEADED)


@golden("attitude")
def start_on_a_turntable():
    return judged(shown(simulate(70.0, 100.0, steady((0.0, 0.0, 1.0 * DEG), -1.0, 40.0))))


@golden("attitude")
def even_curve():
    """Longer than curves are, so that what it shows then counts as rest."""
    turn = 0.5 * DEG

    def centripetal(t):
        psi = turn * t
        return 8.0 * turn * np.column_stack([-np.sin(psi), np.cos(psi), 0.0 * psi]) * (t < 100.0)[:, None]

    return judged(shown(simulate(180.0, 100.0, steady((0.0, 0.0, turn), -1.0, 100.0), centripetal)))


@golden("attitude")
def car():
    """Speeds up, cruises on a road that shakes it, brakes, stands with its engine running; again and again."""
    truth, phase = car_that_stops(150.0)
    samples = shown(truth)
    samples["f"][:, 2] += 0.1 * np.sin(2.0 * np.pi * 26.0 * truth.t)
    going = ((phase > 0.0) & (phase < 31.0))[:, None]
    samples["f"] += 0.3 * np.random.RandomState(3).normal(size=samples["f"].shape) * going
    return judged(samples)


@golden("attitude")
def car_on_a_smooth_road():
    """The same without a road that shakes it: cruising is as quiet as standing."""
    speed_up, brake = steady((2.5, 0.0, 0.0), 10.0, 25.0), steady((-3.0, 0.0, 0.0), 90.0, 102.5)
    return judged(shown(simulate(130.0, 50.0, acceleration=lambda t: speed_up(t) + brake(t))), profile="auto")


@golden("attitude")
def fast_car():
    speed_up, brake = steady((5.0, 0.0, 0.0), 10.0, 19.0), steady((-5.0, 0.0, 0.0), 30.0, 39.0)
    return judged(shown(simulate(50.0, 100.0, acceleration=lambda t: speed_up(t) + brake(t))), profile="consumer-mems")


@golden("attitude")
def unknown_sensor_model():
    """A sensor that nobody named, whose weight is false by more than a good board's."""
    flaws = Flaws(accel_bias=(10.0 * MG, -20.0 * MG, -70.0 * MG), gyro_bias=(1.0 * DEG,) * 3)
    return judged(shown(lively(), flaws), profile="auto")


@golden("attitude")
def tapping():
    """Knocks, and a spell of vibration that samples show as up and down."""
    truth = lively(50.0, 200.0)
    samples = shown(truth)
    samples["f"][3000::400, 2] += 100.0
    samples["f"][5000:8000:2, 0] += 5.0
    samples["f"][5001:8001:2, 0] -= 5.0
    return judged(samples)


@golden("attitude")
def scale_factors_and_misalignments():
    """Scale factors and misalignments that motion shows."""
    matrix = np.array([[0.008, 0.003, -0.004], [0.002, -0.01, 0.003], [-0.003, 0.004, 0.006]])
    flaws = Flaws(gyro_bias=(0.2 * DEG,) * 3, gyro_matrix=matrix, accel_scale=(0.01, -0.01, 0.005))
    return judged(shown(lively(120.0, turning=1.5, moving=2.0), flaws), HEADED)


def cut_off(cast, bias_degps, taken_out_degps=0.0, still=8.0, duration=100.0, count=COUNT):
    """Rates as integers; a bias was taken out afterwards."""
    truth = simulate(duration, 200.0, after(still, wobble(6, 0.5, 0.3, 1.5)), after(still, wobble(6, 0.5, 1.0, 3.0)))
    samples = shown(truth, Flaws(gyro_bias=tuple(np.array(bias_degps) * DEG)))
    samples["w"] = cast(samples["w"] / count) * count - taken_out_degps * DEG
    return judged(samples)


@golden("attitude")
def rates_truncated():
    return cut_off(np.trunc, (0.3, -0.2, -0.4))


@golden("attitude")
def rates_truncated_about_zero():
    """After a long rest, whose noise tells it."""
    return cut_off(np.trunc, (0.08, -0.05, -0.4), 0.47, still=60.0)


@golden("attitude")
def long_rest_of_counts():
    """Longer than its noise is looked at; for a while a low-pass makes the noise of neighbours alike."""
    recording = cut_off(np.trunc, (0.03, -0.1, 0.2), still=1e3, duration=110.0)
    noise = np.random.RandomState(5).normal(size=(4000, 2))
    for k in range(1, len(noise)):
        noise[k] = (0.78, 0.6) * noise[k - 1] + (0.626, 0.8) * noise[k]
    recording.samples["w"][:4000, 0] = np.trunc(1.5 * noise[:, 0]) * COUNT
    recording.samples["w"][6000:10000, 1] = np.trunc(1.4 * noise[:, 1]) * COUNT
    return recording


@golden("attitude")
def rates_rounded():
    return cut_off(np.round, (0.08, -0.05, -0.4), 0.47, still=60.0)


@golden("attitude")
def large_biases():
    """A gyro of the worst kind, and an accelerometer that does not weigh gravity."""
    flaws = Flaws(gyro_bias=(15.0 * DEG, -12.0 * DEG, 9.0 * DEG), accel_bias=(20.0 * MG, 0.0, -70.0 * MG))
    return judged(shown(lively(), flaws), profile="auto")


@golden("attitude")
def turntable_at_the_start():
    """Faster than usual biases, about the vertical."""
    truth = simulate(20.0, 100.0, steady((0.0, 0.0, 12.0 * DEG), -1.0, 2.5))
    return judged(shown(truth), profile="auto")


@golden("attitude")
def multicopter():
    """It hovers, sets off, which is no slip, and shows its velocity by its drag."""
    return judged(shown(flight(wobble, 20, 0.2, 90.0, leaves_s=30.0)), profile="auto")
