"""Recordings for the golden traces of the attitude filter with faults: sensors lost, frozen, clipped, slipped; gaps."""

import numpy as np
from attitude_simulation import DEG, MG, G, after, simulate
from golden_attitude import BIASES, HEADED, judged, lively, shown, wobble
from golden_data import counted
from golden_run import golden
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Initial
from imud.drivers.sample import POWER_ON, SUSPECT


def spoilt(begin, end, faults, truth=None, estimator="attitude", initial=HEADED):
    """Faults (column, axes, value or None for the last one) from `begin` to `end` s."""
    truth = truth or lively(50.0, 200.0)
    samples = counted(shown(truth))
    k = np.flatnonzero((truth.t >= begin) & (truth.t < end))
    for name, axes, value in faults:
        samples[name][k, axes] = samples[name][k[0], axes] if value is None else value
    return judged(samples, initial, estimator=estimator)


@golden("attitude")
def wrong_initial_attitude():
    return judged(shown(lively()), Initial(roll_deg=-50.0, pitch_deg=40.0, yaw_deg=20.0))


@golden("attitude")
def short_gaps():
    """Of two samples each, about the shortest that count as one."""
    samples = shown(lively(40.0))
    keep = np.ones(len(samples), bool)
    keep[1500::250] = keep[1501::250] = False
    return judged(samples[keep], HEADED)


@golden("attitude")
def stamps_that_scatter():
    """Even samples; one in a hundred comes late, and those behind it at once. Of 1.5 s each second one is lost."""
    truth = lively(60.0, still=5.0, turning=1.5)
    samples = shown(truth)
    rng = np.random.RandomState(5)
    waits = 5.0 * rng.uniform(size=len(samples)) * (rng.uniform(size=len(samples)) < 0.01)
    late = 1e7 * (0.2 * rng.uniform(size=len(samples)) + waits)
    samples["t_ns"] = np.maximum.accumulate(samples["t_ns"] + np.round(late).astype(np.int64))
    samples["t_ns"] += 1000 * np.arange(len(samples))
    kept = np.ones(len(samples), bool)
    kept[2000:2003] = kept[3000:3003] = False
    kept[4000:4150:2] = False
    return judged(samples[kept])


@golden("attitude")
def sample_rate_that_changes():
    """A quarter more from the middle on."""
    samples = shown(lively(30.0, still=5.0, turning=1.5))
    i = np.arange(len(samples))
    even = np.where(i < 1500, i, 1500 + 0.8 * (i - 1500))
    samples["t_ns"] = samples["t_ns"][0] + np.round(1e7 * even).astype(np.int64)
    return judged(samples)


@golden("attitude")
def samples_in_packets():
    """Ten come at once; one of a hundred is lost, later one of ten, and then the rate is a fifth higher and lower."""
    samples = shown(lively(60.0, still=5.0, turning=1.5))
    i = np.arange(len(samples))
    even = np.where(i < 3600, i, 3600 + 0.8 * (i - 3600))
    even = np.where(i < 4800, even, even[4800] + 1.2 * (i - 4800))
    newest = np.minimum(i // 10 * 10 + 9, len(i) - 1)
    samples["t_ns"] = samples["t_ns"][0] + np.round(1e7 * even[newest]).astype(np.int64) + 2000 * (i - newest)
    lost = np.random.RandomState(5).uniform(size=len(samples)) < np.where((i > 2400) & (i < 3600), 0.1, 0.01)
    return judged(samples[~lost])


@golden("attitude")
def power_on():
    """Of another sensor, with other biases, at rest and in motion."""
    truth = lively(60.0)
    samples = shown(truth)
    for begin in (6.0, 40.0):
        samples["w"][truth.t >= begin] += np.array([0.3, -0.2, 0.1]) * DEG
        samples["f"][truth.t >= begin] += np.array([3.0, 5.0, -4.0]) * MG
        samples["flags"][np.searchsorted(truth.t, begin)] |= POWER_ON
    return judged(samples[(truth.t < 5.5) | (truth.t > 6.0 - 1e-6)], HEADED)


@golden("attitude")
def gaps_of_about_a_second():
    """A little longer than the attitude is carried on for; the same of damage."""
    truth = lively(60.0)
    samples = shown(truth)
    samples["flags"][(truth.t >= 40.0) & (truth.t < 41.1)] = SUSPECT
    return judged(samples[(truth.t < 25.0) | (truth.t > 26.1)], HEADED)


@golden("attitude")
def clipping():
    """Beyond the range of the gyro, then of the accelerometer."""
    truth = lively(50.0, 200.0)
    samples = shown(truth)
    samples["w"][4000:4060, 2] += 8.0
    samples["f"][6000:6060, 0] += 50.0
    for name, most in (("w", 300.0 * DEG), ("f", 3.0 * G)):
        samples[name] = np.clip(samples[name], -most, most)
    return judged(samples, HEADED)


@golden("attitude")
def lost_accelerometer():
    return spoilt(20.0, 30.0, [("f", slice(None), 0.0)])


@golden("attitude")
def one_frozen_axis_of_the_accelerometer():
    return spoilt(20.0, 26.0, [("f", 1, None)])


@golden("attitude")
def lost_gyro():
    return spoilt(20.0, 25.0, [("w", slice(None), None)])


@golden("attitude")
def lost_gyro_for_a_moment():
    return spoilt(20.0, 20.5, [("w", 1, np.nan)])


@golden("attitude")
def no_accelerometer_at_the_start():
    return spoilt(-1.0, 8.0, [("f", slice(None), 0.0)])


@golden("attitude")
def gaps():
    truth = lively(60.0)
    keep = np.ones(len(truth.t), bool)
    for begin, end in ((15.0, 15.05), (20.0, 20.3), (25.0, 25.9), (40.0, 43.0)):
        keep &= (truth.t < begin) | (truth.t > end)
    return judged(shown(truth)[keep], HEADED)


@golden("attitude")
def gap_in_strong_motion():
    """It leaves the tilt unknown."""
    truth = simulate(60.0, 100.0, wobble(8, 2.0), wobble(58, 2.0, 1.0, 4.0))
    return judged(shown(truth)[(truth.t < 30.0) | (truth.t > 30.9)])


@golden("attitude")
def damaged_samples():
    samples = shown(lively(40.0))
    for first in range(1200, 3600, 200):
        samples["w"][first : first + 3], samples["f"][first : first + 3] = 1e9, np.nan
        samples["flags"][first : first + 3] = SUSPECT
    samples["w"][1300:1303, 1] = np.nan
    samples["f"][2100:2103, 2] = np.inf
    samples["t_ns"][3000:3010] -= 1_000_000_000
    samples["flags"][:20] = SUSPECT
    return judged(samples, HEADED)


def slipped(angle_deg, truth, flaws=BIASES, profile="m-g350", initial=HEADED):
    """A sensor that slips by this angle after 20 s."""
    samples = shown(truth, flaws)
    slip = Rotation.from_rotvec(angle_deg * DEG * np.array([0.6, 0.8, 0.0]))
    for name in ("w", "f"):
        samples[name][truth.t >= 20.0] = slip.apply(samples[name][truth.t >= 20.0])
    return judged(samples, initial, profile)


@golden("attitude")
def mounting_slip_of_90_degrees():
    return slipped(90.0, lively(70.0))


@golden("attitude")
def wrong_tilt_in_motion():
    truth = simulate(120.0, 50.0, after(5.0, wobble(1, 0.1, 0.5, 4.0)), after(5.0, wobble(2, 0.4, 0.3, 1.5)))
    return slipped(12.0, truth)


@golden("attitude")
def mounting_slip_in_a_hand():
    """Of a body that has proved to be no vehicle."""
    return slipped(15.0, lively(40.0))


@golden("attitude")
def wrong_tilt_at_rest():
    return slipped(5.0, simulate(80.0, 50.0))


@golden("attitude")
def slip_at_rest():
    """By so much that the force would be larger if this were an acceleration."""
    return slipped(20.0, simulate(50.0, 50.0))


@golden("attitude")
def rates_in_degrees():
    """At first unconfirmed, then named; they turn too slowly for it to be named at once."""
    samples = shown(simulate(25.0, 100.0, after(5.0, wobble(1, 0.1)), after(5.0, wobble(2, 0.5, 2.0, 6.0))))
    samples["w"] /= DEG
    return judged(samples, HEADED)
