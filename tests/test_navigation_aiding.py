"""Measurements of other sources than GNSS: fused at their own epochs, in whatever order they come."""

from itertools import pairwise

import numpy as np
from navigation_simulation import drive, errors, received, sensed
from replay_in_process import replay

from imud.configuration.settings import Aiding, Initial, Settings
from imud.estimators import registry
from imud.estimators.innovation_kinds import KINDS
from imud.estimators.records import HEADING, HEADING_SOURCE, HEADING_VALID, MEASUREMENT, SOLUTION
from imud.pipeline import Filter, innovation_buffer

SIGMA = np.radians(0.3)
OF_FIXES_AND_SAMPLES = ("north", "east", "down", "v_north", "v_east", "v_down", "nhc_lateral", "nhc_vertical")
OF_MEASUREMENTS = [
    code for code, kind in KINDS.items() if not kind.key.startswith("rest_") and kind.key not in OF_FIXES_AND_SAMPLES
]


def headings(d, rng, every_s=0.2, late_s=0.0, sigma=SIGMA):
    """MEASUREMENT rows of a compass of `sigma` rad, known `late_s` after their epochs."""
    step = round(every_s / (d.t[1] - d.t[0]))
    t, yaw = d.t[step::step], d.attitude.as_euler("ZYX")[step::step, 0]
    rows = np.zeros(len(t), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + t))
    rows["arrival_ns"] = rows["t_ns"] + np.round(1e9 * late_s * np.ones(len(t))).astype(np.int64)
    rows["kind"], rows["sigma"] = HEADING_SOURCE, np.nan
    rows["value"][:, 0], rows["sigma"][:, 0] = yaw + sigma * rng.standard_normal(len(t)), sigma
    return rows


# a boresight that is known: of an unknown one the heading is the fixes', which depend on the snapshots
KNOWN = Settings(aiding=Aiding(heading_boresight_sigma_deg=0.001))


def live(samples, fixes, measurements, settings=Settings()):  # noqa: B008 a frozen value
    """As `estimated`, each measurement by itself, when it came."""
    filter_ = Filter(registry.by_name("navigation"), settings, Initial(), 100.0)
    samples, out = samples.copy(), np.zeros(len(samples), SOLUTION)
    fixes = fixes[np.argsort(fixes["arrival_ns"], kind="stable")]
    measurements = measurements[np.argsort(measurements["arrival_ns"], kind="stable")]
    places = np.searchsorted(samples["t_ns"], fixes["arrival_ns"]).astype(np.int64)
    aided = np.searchsorted(samples["t_ns"], measurements["arrival_ns"])
    innovations = []
    for start, stop in pairwise(np.unique([0, *aided[aided < len(samples)], len(samples)])):
        innovations.append(filter_.aid(measurements[aided == start]).copy())
        due = slice(*np.searchsorted(places, [start, stop]))
        filter_.feed(
            samples[start:stop], out[start:stop], fixes[due], places[due] - start, innovation_buffer(len(fixes[due]))
        )
    return out, np.concatenate(innovations)


def played(samples, fixes, measurements, settings=Settings()):  # noqa: B008 a frozen value
    """The same by whole blocks: (solutions, all innovations)."""
    filter_ = Filter(registry.by_name("navigation"), settings, Initial(), 100.0)
    return replay(filter_, samples, fixes, measurements[np.argsort(measurements["arrival_ns"], kind="stable")])


def found_of_sources(samples, fixes, measurements, settings):
    """What the filter has found out of the sources at the end, by their codes."""
    filter_ = Filter(registry.by_name("navigation"), settings, Initial(), 100.0)
    replay(filter_, samples, fixes, measurements)
    return filter_.estimator.source_estimates(filter_.state)


def estimated(samples, fixes, measurements, settings=Settings()):  # noqa: B008 a frozen value
    """(solutions, innovations of the measurements), everything in the order in which it became known."""
    out, innovations = played(samples, fixes, measurements, settings)
    return out, innovations[np.isin(innovations["kind"], OF_MEASUREMENTS)]


def apart(one, other):
    """The largest difference of attitude, velocity and place, in sigmas."""
    turn = 2.0 * np.abs(one["q_nb"] - other["q_nb"]).max(axis=1) / other["sigma_rpy"].min(axis=1)
    velocity = (np.abs(one["v"] - other["v"]) / other["sigma_v"]).max(axis=1)
    return max(turn.max(), velocity.max(), (6.4e6 * np.abs(one["lat"] - other["lat"]) / other["sigma_p"][:, 0]).max())


def recorded(seed, seconds=60.0, rest=30.0):
    rng = np.random.default_rng(seed)
    d = drive(seconds, rest=rest)
    return d, sensed(d, rng), received(d, rng), rng


def test_that_headings_contradict_the_estimate_is_said_at_once():
    d, samples, fixes, rng = recorded(9, rest=15.0)
    rows = headings(d, rng)
    assert "finding" not in found_of_sources(samples, fixes, rows, KNOWN)[HEADING_SOURCE]
    rows["value"][rows["t_ns"] > 158e9, 0] += 0.7
    assert "contradicts" in found_of_sources(samples, fixes, rows, KNOWN)[HEADING_SOURCE]["finding"]


def test_before_the_first_fix_headings_know_no_more_than_their_boresight():
    """It was lost with the first fix, and headings then seemed to have errors of their own: 2.1 deg instead of 3."""
    d, samples, fixes, rng = recorded(9, seconds=20.0, rest=20.0)
    out, _ = estimated(samples, fixes[fixes["t_ns"] > 104e9], headings(d, rng))
    known = out["status"] & HEADING_VALID != 0
    assert known[-1] and np.degrees(out["sigma_rpy"][known, 2]).min() > 2.95


def test_headings_that_come_after_the_fix_of_their_epoch_are_as_good_as_before_it():
    """The fix is then fused again; its acceleration was that of velocities which it had corrected itself.

    That gave a time offset that was wrong and certain, and a yaw with twice the error (4 deg for an emulated receiver).
    """
    d, rms = drive(60.0, speed=7.0, rest=0.0, fast_start=True), []
    for late_s in (0.15, 0.19):
        rng = np.random.default_rng(72)
        samples, fixes = sensed(d, rng), received(d, rng, late=0.17, sigma=1.2, every=0.2, stamp=-0.05)
        rows = headings(d, rng, late_s=late_s)
        rows["t_ns"] -= 50_000_000
        out, _ = estimated(samples, fixes, rows)
        rms.append(np.sqrt(np.mean(errors(d, out)[2][d.t > 30.0, 2] ** 2)))
    assert rms[1] < 1.2 * rms[0]


def test_measurements_of_a_block_are_those_taken_one_by_one():
    d, samples, fixes, rng = recorded(9, rest=15.0)
    late = np.concatenate([headings(d, rng, 0.1, late_s) for late_s in (0.0, 0.3, -500.0, 500.0)])
    fixes = fixes[np.argsort(fixes["arrival_ns"], kind="stable")]
    one_by_one, theirs = live(samples, fixes, late)
    in_blocks, the_same = estimated(samples, fixes, late)
    assert one_by_one.tobytes() == in_blocks.tobytes()
    assert theirs.tobytes() == the_same.tobytes() and len(theirs) > 1000


def test_a_compass_gives_a_standing_vehicle_its_heading():
    d, samples, fixes, rng = recorded(1)
    out, innovations = estimated(samples, fixes, headings(d, rng))
    yaw = errors(d, out)[2][:, 2]
    standing = (d.t > 10.0) & (d.t < 30.0)
    assert (out["status"][d.t > 3.0] & HEADING_VALID).all()
    assert np.sqrt(np.mean(yaw[standing] ** 2)) < SIGMA
    assert np.mean((yaw[d.t > 5.0] / out["sigma_rpy"][d.t > 5.0, 2]) ** 2) < 4.0
    assert (innovations["kind"] == HEADING).all() and innovations["used"].all()
    assert 0.5 < np.mean(innovations["value"] ** 2 / innovations["variance"]) < 1.5


def test_measurements_in_any_order_within_the_horizon_give_what_those_in_order_give():
    """But for the acceleration at a fix, which is fitted to snapshots of other times: a fraction of the sigmas."""
    d, samples, _, rng = recorded(2)
    fixes = received(d, rng, late=0.5)  # so late that the velocity after each is known, whenever it is fused
    in_order = headings(d, rng, late_s=0.02)[:-10]  # 2 s before the end all have come, late or not
    shuffled = in_order.copy()
    shuffled["arrival_ns"] += (1.5e9 * np.random.default_rng(3).random(len(shuffled))).astype(np.int64)
    prompt, _ = estimated(samples, fixes, in_order, KNOWN)
    late, innovations = estimated(samples, fixes, shuffled, KNOWN)
    assert innovations["used"].all() and len(innovations) > 200
    assert (np.diff(innovations["t_ns"]) < 0).any()
    assert apart(late[-1:], prompt[-1:]) < 0.3


def test_one_late_measurement_is_fused_at_its_epoch_with_the_fixes_after_it_fused_again():
    """The filter then is where it would be if it had come in time: fixes lie between it and now."""
    d, samples, _, rng = recorded(4)
    fixes = received(d, rng, late=0.5)
    one = headings(d, rng, late_s=0.02)[200:201]
    late = one.copy()
    late["arrival_ns"] += 1_800_000_000
    first, _ = estimated(samples, fixes, one, KNOWN)
    second, innovations = estimated(samples, fixes, late, KNOWN)
    assert innovations["used"].all() and len(innovations) == 1
    after = d.t > late["arrival_ns"][0] * 1e-9 - 99.98
    assert apart(second[after], first[after]) < 0.12
    before = d.t < late["arrival_ns"][0] * 1e-9 - 100.02
    assert apart(second[before], first[before]) > 0.5  # what had not come could not be known


def test_a_measurement_from_before_the_horizon_is_rejected_and_changes_nothing():
    d, samples, fixes, rng = recorded(5)
    old = headings(d, rng)[100:101]
    old["arrival_ns"] += 8_000_000_000
    without, _ = estimated(samples, fixes, old[:0])
    out, innovations = estimated(samples, fixes, old)
    assert len(innovations) == 1 and not innovations["used"][0] and innovations["kind"][0] == HEADING
    assert out.tobytes() == without.tobytes()
