"""Every aiding source with every fault leaves the rest unharmed: `fault_matrix.py` beside limits for each cell."""

from functools import cache

import numpy as np
import pytest
from fault_matrix import FAULTS, OF_COMPASSES, OF_POSES, SOURCES, cell, harm, judged, scene, settings_of, together
from navigation_simulation import errors, received, sensed
from test_navigation_aiding import estimated, live
from test_navigation_odometer import ramped, readings
from vehicle_simulation import LAND, vehicle

from imud.estimators.records import REJECTING

MOST = 2.0  # times the RMS error without the source


def test_all_sources_in_blocks_give_what_each_measurement_by_itself_does():
    d, samples, fixes = scene(1)
    rows = np.concatenate([make(d, np.random.default_rng(1)) for make in SOURCES.values()])
    settings = settings_of("two wheels")
    for one_by_one, in_blocks in zip(
        live(samples, fixes, rows, settings), estimated(samples, fixes, rows, settings), strict=True
    ):
        assert one_by_one.tobytes() == in_blocks.tobytes()


@cache
def alone(seed):
    return cell(seed)


@pytest.mark.thorough
@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_source_harms_little_and_is_never_believed_wrongly(name, fault):
    found = cell(1, name, fault)
    ratio, worst = harm(found, alone(1))
    assert found.sure_s == 0.0, found.worst
    assert ratio < MOST, worst


@pytest.mark.parametrize("name", SOURCES)
def test_without_a_fault_each_source_is_honest(name):
    found = cell(1, name)
    assert found.sure_s == 0.0 and harm(found, alone(1))[0] < 1.1


@pytest.mark.thorough
@pytest.mark.parametrize("where", LAND)
@pytest.mark.parametrize("fault", ["jumping", "frozen", "wrong units"])
def test_wheels_that_the_accelerometer_contradicts_are_not_believed(where, fault):
    """Also without a receiver; they were, and position and velocity were wrong and sure for 25 s."""
    found = cell(11, "odometer", fault, where)
    assert found.sure_s == 0.0, found.worst
    assert harm(found, cell(11, where=where))[0] < 3.0


def test_wheels_that_jump_while_there_is_no_receiver_are_not_believed():
    assert cell(12, "odometer", "jumping").sure_s == 0.0


WARMS_UP = pytest.mark.xfail(
    strict=True, reason="while a gyro's bias may warm up, slow vehicles give way to a fault: docs/limits.md"
)
GIVE_WAY = {("odometer", "frozen", 12), ("odometer", "frozen", 13), ("two wheels", "wrong units", 13)}  # robots


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [11, 12, 13])
@pytest.mark.parametrize(
    ("where", "name", "fault"),
    [
        ("robot", "odometer", "frozen"),  # near standstill, where the accelerometer says little
        ("motorway", "pose", "clock of its own"),  # 8 m along the way
        ("motorway", "pose", "late"),
        ("robot", "heading", "late at once"),  # 30 deg in turns
        ("boat", "heading", "late at once"),
        ("drone", "barometer", "frozen"),
        ("robot", "two wheels", "wrong units"),  # they agree near standstill
        ("walk", "velocity", "wrong units"),
    ],
)
def test_of_other_vehicles_none_is_wrong_and_sure(where, name, fault, seed, request):
    if where == "robot" and (name, fault, seed) in GIVE_WAY:
        request.applymarker(WARMS_UP)
    found, without_it = cell(seed, name, fault, where), cell(seed, where=where)
    assert found.sure_s <= without_it.sure_s, found.worst
    assert harm(found, without_it)[0] < 3.0


@pytest.mark.thorough
@pytest.mark.parametrize("where", [*LAND, "drone"])
@pytest.mark.parametrize("fault", ["wrong units", *OF_COMPASSES])
def test_a_compass_that_gave_a_wrong_heading_is_found_out(where, fault):
    """By the motion; it was believed for minutes, and with wheels the receiver was rejected instead."""
    assert cell(11, "heading", fault, where).sure_s == 0.0
    assert together(11, "heading", fault, where).sure_s == 0.0


@pytest.mark.parametrize("where", LAND)
@pytest.mark.parametrize("fault", OF_POSES)
def test_a_map_that_is_turned_is_found_out(where, fault):
    """Its yaw gives the heading at rest, and was believed for the whole drive; now until the vehicle has moved."""
    found = cell(11, "pose", fault, where)
    assert found.sure_s == 0.0, found.worst
    assert found.rms["yaw"] < 3.0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("where", "seed", "direction"),
    [
        ("robot", 32, 4.5),
        pytest.param("robot", 703, 1.3, marks=WARMS_UP),
        ("robot", 706, 0.3),
        pytest.param("boat", 705, 5.5, marks=WARMS_UP),
        ("boat", 706, 2.4),
    ],
)
def test_a_receiver_that_drifts_turns_no_heading_and_nothing_of_it_is_left_when_it_is_found(where, seed, direction):
    """At walking pace it was taken for steps of the gyro's bias; of boats the velocity kept what it had done."""
    rng, d = np.random.default_rng(seed), vehicle(where, seed, 200.0)
    samples = sensed(d, rng, bg=(0.002, -0.001, 0.0015), ba=(0.03, -0.02, 0.02))
    fixes = ramped(received(d, rng, late=0.1, sigma=1.2), 60.0, direction)
    wheel = SOURCES["odometer"] if where in LAND else readings
    out, _ = estimated(samples, fixes, wheel(d, np.random.default_rng(100 + seed)), settings_of(None, where))
    assert (out["status"][(d.t > 70.0) & (d.t < 120.0)] & REJECTING).all()
    position, _, attitude = errors(d, out)[:3]
    for error, sigma, large in (
        (position[:, :2], out["sigma_p"][:, :2], 5.0),
        (attitude[:, 2:], out["sigma_rpy"][:, 2:], np.radians(5.0)),
    ):
        assert not ((np.abs(error) > 4.0 * sigma) & (np.abs(error) > large))[(d.t > 60.0) & (d.t < 120.0)].any()


@pytest.mark.parametrize("where", ["city", "robot", "drone"])
def test_poses_that_state_that_nothing_is_known_cost_nothing(where):
    """A yaw whose sigma is 180 deg gave the heading again and again, which was never valid."""
    d, samples, fixes = scene(801, where)
    rows = SOURCES["pose"](d, np.random.default_rng(901))
    rows["sigma"][:, :3], rows["sigma"][:, 3] = 1e4, np.pi
    found, alone = judged(d, estimated(samples, fixes, rows, settings_of(None, where))[0]), cell(801, where=where)
    assert found.sure_s == 0.0 and harm(found, alone)[0] < 1.1
