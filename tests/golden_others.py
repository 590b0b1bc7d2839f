"""Recordings for the golden traces of the other estimators: tilt, and those of papers."""

from dataclasses import replace

import msgspec
import numpy as np
from attitude_simulation import DEG, MG, Flaws, G, simulate, steady
from golden_attitude import HEADED, judged, lively, shown
from golden_attitude_faults import spoilt
from golden_run import Recording, golden
from simulated import G350, motion, received, sensed

from imud.configuration.settings import Aiding, Imu, Initial, Navigation, Settings
from imud.drivers.sample import NO_FORCE, NO_RATE, POWER_ON, SUSPECT
from imud.estimators.records import MEASUREMENT, ODOMETER_SOURCE
from imud.firmware_sim.rga300 import RGA300

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


@golden()
def tilt_in_a_hand():
    return judged(shown(lively(40.0)), HEADED, estimator="tilt")


@golden()
def tilt_without_gyros():
    samples = shown(lively(40.0, turning=0.0))
    samples["w"] = 0.0
    return judged(samples, profile="mma7260", estimator="tilt")


@golden()
def tilt_with_faults():
    """Clipped, frozen, damaged and missing samples."""
    samples = spoilt(20.0, 24.0, [("w", slice(None), None)], estimator="tilt").samples
    samples["f"][5500:5520, 0] = 3.0 * G
    samples["flags"][6000:6500] = SUSPECT
    t = np.arange(len(samples)) / 200.0
    return judged(samples[(t < 36.0) | (t > 39.0)], HEADED, estimator="tilt")


@golden()
def gps_track_with_faults():
    return driven("gps-track")


@golden()
def ins9_with_faults():
    return driven("ins9")


def without_height(estimator, scenario="car"):
    """The first fix is the origin, and its height is not known."""
    recording = driven(estimator, Initial(yaw_deg=86.0), scenario)
    recording.fixes["height"] = np.nan
    return recording


@golden()
def ins9_without_height():
    return without_height("ins9")


@golden()
def stationary_without_height():
    """And the last ten seconds come after half an hour without samples."""
    recording = without_height("stationary", "rest")
    recording.samples["t_ns"][-1000:] += 1_800_000_000_000
    return recording


@golden()
def ins9_with_device_tilt():
    """As a Crossbow does: the vertical in the body, beside rates and forces. The receiver reports no height."""
    recording = driven("ins9")
    recording.fixes["height"] = np.nan
    recording.samples["down"] = (-0.02, 0.01, 0.99975)
    return recording


def one_gyro(seconds, scenario="car"):
    """A Crossbow DMU and a receiver: (t of samples, recording)."""
    rng = np.random.RandomState(12)
    m = motion(scenario, seconds, 100.0, rpy=(0.1, -0.05, 1.0) if scenario == "rest" else (0.0, 0.0, 0.0))
    samples, fixes = sensed(m, rng, RGA300)[0], received(m, rng)
    samples["w"][:, :2] = 0.0
    return m.t, Recording("riss", samples, fixes, Settings(imu=Imu(profile="crossbow-dmu")), rows=12)


@golden()
def riss_with_faults():
    """Forces and rates fail, fixes are far off, of no use, old, without velocity, and then of another place."""
    t, recording = one_gyro(150.0)
    samples, fixes, at = recording.samples, recording.fixes, recording.fixes["t_ns"] * 1e-9 - 1.0
    for flag, name, begin in ((NO_RATE, "w", 40.0), (NO_FORCE, "f", 60.0)):
        gone = (t > begin) & (t < begin + 8.0)
        samples["flags"][gone], samples["outage_s"][gone], samples[name][gone] = flag, t[gone] - begin, np.nan
        samples["down"][gone] = -0.02, 0.01, 0.99975
    samples["flags"][3000:3010], samples["flags"][8000] = SUSPECT, POWER_ON
    fixes["quality"][30], fixes["t_ns"][33] = 0, fixes["t_ns"][33] - 5_000_000_000
    fixes["lat"][50] += 1e-4
    fixes["height"][52] += 300.0
    fixes["speed"][54:57] = 40.0
    fixes["course"][70:73] += 1.0
    for name in ("speed", "course"):
        fixes[name][80:90] = np.nan
    fixes["sigma"][20:30], fixes["hdop"][90:95] = 1.0, np.nan
    fixes["lat"][at > 105.0] += 2e-4
    kept = (t < 120.0) | (t > 123.0)
    return replace(recording, samples=samples[kept], fixes=fixes[(at < 94.0) | (at > 104.0)])


@golden()
def riss_with_a_lever_arm():
    """And a receiver that gives its velocity north and east, some of it late, and no height at first."""
    _, recording = one_gyro(100.0, "figure8")
    fixes = recording.fixes
    fixes["v"][:, 0], fixes["v"][:, 1] = (fixes["speed"] * part(fixes["course"]) for part in (np.cos, np.sin))
    fixes["height"][:20] = np.nan
    fixes["arrival_ns"][::3] += 700_000_000
    navigation = Navigation(lever_arm_m=(1.0, 0.5, -1.2))
    return replace(recording, settings=Settings(imu=Imu(profile="crossbow-dmu"), navigation=navigation))


@golden()
def riss_with_wheels():
    """From before the heading is known; without a sign, slipping, late, missing; the receiver is away for a while."""
    _, recording = one_gyro(120.0)
    m = motion("car", 120.0, 100.0)
    at, rng = np.arange(5, len(m.t), 10), np.random.RandomState(7)
    yaw, v = m.truth.rpy[at, 2], m.truth.v_n[at]
    speed = 1.02 * (v[:, 0] * np.cos(yaw) + v[:, 1] * np.sin(yaw)) + 0.05 * rng.standard_normal(len(at))
    rows = np.zeros(len(at), MEASUREMENT)
    rows["t_ns"] = np.round((1.0 + m.t[at]) * 1e9)
    late_ns = np.int64(2_800_000_000)  # numpy's own integers have 32 bits on armhf
    rows["arrival_ns"] = rows["t_ns"] + np.where(np.arange(len(at)) % 50 == 49, late_ns, 60_000_000)
    rows["kind"], rows["sigma"] = ODOMETER_SOURCE, np.nan
    rows["value"][:, 0], rows["sigma"][::2, 0] = np.abs(speed), 0.1
    rows["value"][300:360, 0] += np.linspace(0.0, 1.5, 60)
    rows["value"][400:405, 0] = np.nan
    rows["value"][::7, 0] *= -1.0
    gone = np.abs(recording.fixes["t_ns"] * 1e-9 - 76.0) < 20.0
    settings = msgspec.structs.replace(recording.settings, aiding=Aiding(odometer_lever_arm_m=(0.4, -0.6, 0.3)))
    return replace(recording, fixes=recording.fixes[~gone], measurements=rows, settings=settings)


@golden()
def riss_at_rest():
    """With a heading that the user gives, shaken from the middle on."""
    t, recording = one_gyro(60.0, "rest")
    shaken = t > 30.0
    recording.samples["f"][shaken] += 0.5 * np.random.RandomState(1).standard_normal((shaken.sum(), 3))
    return replace(recording, initial=Initial(yaw_deg=57.0, lat_deg=48.0))


@golden()
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


@golden()
def stationary_damaged_at_the_start():
    return damaged_at_the_start("stationary")


@golden()
def ins9_damaged_at_the_start():
    return damaged_at_the_start("ins9")


@golden()
def suh_standard_turned_over():
    return damaged_at_the_start("suh-standard", HEADED)


@golden()
def suh_adaptive_turned_over():
    return damaged_at_the_start("suh-adaptive", HEADED)


@golden()
def suh_two_step_turned_over():
    return damaged_at_the_start("suh-two-step", HEADED)
