"""A receiver whose velocity and positions contradict each other from the start. Oracle: the drive that is simulated."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed
from nmea_lines import gga, rmc

from imud.configuration.settings import Gnss
from imud.drivers.registry import by_name
from imud.estimators.records import FIX, POSITION_VALID
from imud.sensors.fix_consistency import FixConsistency, consistent
from imud.sensors.receiver import Receiver
from imud.tables.fixes import fixes_of_file

D = Later(drive, 130.0, speed=10.0)
SECOND = 1_000_000_000


def fixes(seed=1, factor=1.0, **how):
    rows = received(D, np.random.default_rng(seed), late=0.1, **how)
    rows["speed"] *= factor
    return rows


def judged(rows):
    """Of each fix whether its velocity is wrong, whether the position is frozen; and the words at the end."""
    consistency, found = FixConsistency(), []
    for k in range(len(rows)):
        consistency.add(rows[k : k + 1])
        found.append((consistency.velocity_ratio is not None, consistency.is_frozen))
    return *np.transpose(found), consistency.fault


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.852, "km/h in place of knots"),
        (1 / 1.852, "knots in place of km/h"),
        (1.9438, "knots in place of m/s"),
        (3.6, "km/h in place of m/s"),
        (2.5, "is not used"),
    ],
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_velocity_in_wrong_units_is_found_within_a_few_hundred_metres(seed, factor, words):
    wrong, frozen, fault = judged(fixes(seed, factor))
    assert not wrong[:13].any() and wrong[40:].all() and not frozen.any()
    if factor > 1.0:  # the next best unit is 5 % away
        assert words in fault
    stated = float(re.search(r"velocity is ([\d.]+) times", fault)[1])
    assert stated == pytest.approx(factor, rel=0.03)


def test_so_is_one_that_comes_with_every_second_fix_only():
    rows = fixes(1, 1.852)
    rows["speed"][1::2] = rows["course"][1::2] = math.nan
    wrong, frozen, fault = judged(rows)
    assert wrong[60:].all() and not frozen.any()
    assert "km/h in place of knots" in fault


@pytest.mark.parametrize("sigma", [1.0, 5.0])
@pytest.mark.parametrize("every", [0.2, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_receiver_with_noise_drifts_and_latency_is_left_alone(seed, every, sigma):
    rows = fixes(seed, every=every, sigma=sigma, lag=0.5, hdop=sigma)
    late = rows["t_ns"] > 160 * SECOND
    rows["lat"][late] += 1e-5  # a jump of 64 m
    rows["lon"] += 1e-7 * np.arange(len(rows)) * every  # 0.4 m/s
    wrong, frozen, fault = judged(rows)
    assert not wrong.any() and not frozen.any() and fault == ""


def test_a_velocity_that_is_right_again_is_used_again():
    rows = fixes(factor=1.852)
    rows["speed"][60:] /= 1.852
    wrong = judged(rows)[0]
    assert wrong[40:60].all() and not wrong[-20:].any()


@pytest.mark.parametrize("seed", [1, 2])
def test_estimates_with_km_per_hour_in_place_of_knots_are_right_after_a_while(seed):
    rows, notes = fixes(seed, 1.852), []
    used = consistent(rows, notes.append)
    assert len(used) == len(rows) and "without their velocity" in notes[0]
    samples = sensed(D, np.random.default_rng(seed), bg=(0.002, -0.001, 0.0015))

    def judge(rows):
        """How long the position is wrong and sure, samples, and the RMS error of the velocity, m/s."""
        out = navigate(samples, rows)[0]
        p, v, _ = (np.abs(error[:, :2]) for error in errors(D, out))
        wrong = ((p > 4.0 * out["sigma_p"][:, :2]) & (p > 5.0)).any(axis=1) & ((out["status"] & POSITION_VALID) != 0)
        return wrong[4000:].sum(), np.sqrt(np.mean(v[4000:] ** 2))

    for judged_fixes in (used, rows):  # the filter alone finds it, too, without the units
        wrong, error = judge(judged_fixes)
        assert wrong == 0
        assert error < 0.15


def test_positions_that_never_change_are_not_used_while_the_velocity_says_that_it_moves():
    rows, notes = fixes(), []
    for name in ("lat", "lon"):
        rows[name][:60] = rows[name][0]
    wrong, frozen, _ = judged(rows)
    assert not wrong.any() and frozen[30:60].all() and not frozen[60:].any()
    assert len(consistent(rows, notes.append)) == len(rows) - frozen.sum() and "never changed" in notes[0]
    parked = rows[:60].copy()
    parked["speed"] = np.abs(0.1 * np.random.default_rng(1).standard_normal(60))
    assert not judged(parked)[1].any()


def sentences(second, factor=1.0, frozen=False):
    """North at 10 m/s."""
    minutes = 7.0 + (0.0 if frozen else second * 10.0 / 1852.0)
    position = {"lat": f"48{minutes:08.5f},N"}
    time = f"12{second // 60:02d}{second % 60:02d}.000"
    moving = rmc(time, motion=f"{10.0 / 0.514444 * factor:.2f},0.0")
    return gga(time, **position) + moving.replace(b"4807.038,N", position["lat"].encode())


def received_by_daemon(**how):
    receiver, rows, messages = Receiver(by_name("nmea"), Gnss(require_checksum=False), 0), [], []
    for second in range(40):
        text = sentences(second, **how).replace(b"*", b"\r\n#")  # without a checksum
        rows += receiver.feed(text, (second + 5) * SECOND)
        messages.append(receiver.message)
        receiver.message = ""
    return receiver, rows, [message for message in messages if message]


def test_the_daemon_says_so_and_does_not_use_the_velocity():
    receiver, rows, _ = received_by_daemon(factor=1.852)
    assert any("km/h in place of knots" in fault for fault in receiver.faults(45 * SECOND))
    assert math.isfinite(rows[0]["speed"][0]) and math.isnan(rows[-1]["speed"][0]) and math.isnan(rows[-1]["course"][0])
    receiver, rows, _ = received_by_daemon()
    assert receiver.faults(45 * SECOND) == () and math.isfinite(rows[-1]["speed"][0])


def test_the_daemon_says_so_and_does_not_use_the_frozen_fixes():
    receiver, rows, messages = received_by_daemon(frozen=True)
    assert len(rows) < 10 and receiver.refused["frozen"] > 25
    assert any("never changed" in message for message in messages)
    assert any("never changed" in fault for fault in receiver.faults(45 * SECOND))


def test_so_does_the_replay_of_a_table(tmp_path):
    rows, notes, table = fixes(factor=1.852), [], tmp_path / "gnss.csv"
    columns = {"t_s": rows["t_ns"] * 1e-9, "lat_deg": np.degrees(rows["lat"]), "lon_deg": np.degrees(rows["lon"])}
    columns |= {"height_m": rows["height"], "speed_mps": rows["speed"], "course_deg": np.degrees(rows["course"])}
    np.savetxt(
        table, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.9f"
    )
    used = fixes_of_file(table, 0, 0, Gnss(), notes.append)
    assert np.isnan(used["speed"][-1]) and "km/h in place of knots" in notes[0]


@given(st.lists(st.tuples(*[st.floats() | st.sampled_from([0.0, 20.0, 1e300, -1e300])] * 8), min_size=2, max_size=12))
def test_no_number_raises(values):
    rows = np.zeros(len(values), FIX)
    for k, (lat, lon, north, east, speed, course, sigma, hdop) in enumerate(values):
        rows[k]["lat"], rows[k]["lon"], rows[k]["v"] = lat, lon, (north, east, 0.0)
        rows[k]["speed"], rows[k]["course"], rows[k]["sigma"], rows[k]["hdop"] = speed, course, sigma, hdop
        rows[k]["t_ns"] = k * SECOND
    judged(rows)
