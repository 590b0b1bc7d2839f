"""Recordings for the golden traces of the other estimators: tilt, and those of papers."""

import numpy as np
from attitude_simulation import DEG, MG, Flaws, G, simulate, steady
from golden_attitude import HEADED, judged, lively, shown, spoilt
from golden_run import Recording
from simulated import G350, motion, received, sensed

from imud.configuration.settings import Initial
from imud.drivers.sample import SUSPECT

GIVEN = Initial(roll_deg=2.0, pitch_deg=-3.0, yaw_deg=86.0, lat_deg=48.0, lon_deg=11.0, height_m=500.0)


def driven(estimator, initial=GIVEN, scenario="car"):
    """An M-G350 and a receiver, some of whose fixes are no good, some of whose samples are missing."""
    rng = np.random.RandomState(8)
    m = motion(scenario, 60.0, 100.0)
    samples, fixes = sensed(m, rng)[0], received(m, rng)
    fixes["quality"][10:12] = 6
    fixes["t_ns"][20] -= 5_000_000_000
    fixes["lat"][30] = np.nan
    samples["flags"][2000:2010] = SUSPECT
    return Recording(estimator, np.delete(samples, slice(4000, 4150)), fixes, G350, initial)


def tilt_in_a_hand():
    return judged(shown(lively(40.0)), HEADED, estimator="tilt")


def tilt_without_gyros():
    samples = shown(lively(40.0, turning=0.0))
    samples["w"] = 0.0
    return judged(samples, profile="mma7260", estimator="tilt")


def tilt_with_faults():
    """Clipped, frozen, damaged and missing samples."""
    samples = spoilt(20.0, 24.0, [("w", slice(None), None)], estimator="tilt").samples
    samples["f"][5500:5520, 0] = 3.0 * G
    samples["flags"][6000:6500] = SUSPECT
    t = np.arange(len(samples)) / 200.0
    return judged(samples[(t < 36.0) | (t > 39.0)], HEADED, estimator="tilt")


def gps_track_with_faults():
    return driven("gps-track")


def ins9_with_faults():
    return driven("ins9")


def without_height(estimator, scenario="car"):
    """The first fix is the origin, and its height is not known."""
    recording = driven(estimator, Initial(yaw_deg=86.0), scenario)
    recording.fixes["height"] = np.nan
    return recording


def ins9_without_height():
    return without_height("ins9")


def stationary_without_height():
    return without_height("stationary", "rest")


def ins9_on_a_device_that_tells_its_tilt():
    """As a Crossbow does: the vertical in the body, beside rates and forces. The receiver reports no height."""
    recording = driven("ins9")
    recording.fixes["height"] = np.nan
    recording.samples["down"] = (-0.02, 0.01, 0.99975)
    return recording


def stationary_with_faults():
    """It is moved after all, first slowly, then by a knock. The receiver reports no height."""
    recording = driven("stationary", scenario="rest")
    recording.fixes["height"] = np.nan
    recording.samples["f"][3000:3300, 0] += 20.0 * MG
    recording.samples["f"][4500:4510, 1] += 5.0
    return recording


def damaged_at_the_start(estimator, initial=GIVEN):
    """And then turned over, through a pitch of 90 deg."""
    rates = steady((0.0, 60.0 * DEG, 0.0), 5.0, 9.0)
    samples = shown(simulate(20.0, 100.0, rates, rpy_deg=(0.0, 5.0, 0.0)), Flaws())
    samples["flags"][:10] = SUSPECT
    return judged(samples, initial, estimator=estimator)


def stationary_damaged_at_the_start():
    return damaged_at_the_start("stationary")


def ins9_damaged_at_the_start():
    return damaged_at_the_start("ins9")


def suh_standard_turned_over():
    return damaged_at_the_start("suh-standard", HEADED)


def suh_adaptive_turned_over():
    return damaged_at_the_start("suh-adaptive", HEADED)


def suh_two_step_turned_over():
    return damaged_at_the_start("suh-two-step", HEADED)


CLASSES = (
    tilt_in_a_hand, tilt_without_gyros, tilt_with_faults, gps_track_with_faults, ins9_with_faults,
    ins9_without_height, stationary_without_height,
    ins9_on_a_device_that_tells_its_tilt, ins9_damaged_at_the_start, stationary_with_faults,
    stationary_damaged_at_the_start, suh_standard_turned_over, suh_adaptive_turned_over, suh_two_step_turned_over,
)  # fmt: skip
