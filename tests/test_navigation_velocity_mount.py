"""How a sensor of the velocity in the body is turned, and boresights as error states beside P."""

from functools import cache

import numpy as np
import pytest
from fault_matrix import SOURCES, judged, scene, settings_of
from in_c import in_c
from msgspec.structs import replace
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation
from test_navigation_aiding import estimated, headings
from test_navigation_covariance import made

from imud.configuration.settings import Aiding
from imud.estimators.ins.boresights import set_velocity_row
from imud.estimators.ins.ekf import set_jacobian
from imud.estimators.ins.filter_states import velocity_mounting
from imud.estimators.ins.fusion import correlated_update
from imud.estimators.ins.state import (
    ATTITUDE,
    BODY_VELOCITY_AXIS,
    BORESIGHTS,
    COMPASS_FAULT,
    OTHER_AXIS,
    STATES,
    VELOCITY,
    VELOCITY_BORESIGHT,
)
from imud.estimators.records import EXTERNAL_VN, EXTERNAL_VX
from imud.math.kalman import unpack

set_velocity_row, set_jacobian, correlated_update = (
    in_c(k) for k in (set_velocity_row, set_jacobian, correlated_update)
)
SEED = 11


@cache
def turned(where, rpy_deg, seed=SEED, compass=None, knock_deg=0.0, **aiding):
    """(core, solutions, innovations of x) of a vehicle whose velocity sensor is turned by these angles."""
    d, samples, fixes = scene(seed, where)
    rows = SOURCES["body_velocity"](d, np.random.default_rng(seed)).copy()
    axes = Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True)
    rows["value"][:, :3] = axes.inv().apply(rows["value"][:, :3])
    knocked = Rotation.from_euler("Z", knock_deg, degrees=True)
    rows["value"][500:, :3] = knocked.inv().apply(rows["value"][500:, :3])
    if compass is not None:
        rows = np.concatenate([rows, headings(d, np.random.default_rng(seed), sigma=np.radians(0.5))])
        rows["value"][-len(headings(d, np.random.default_rng(seed))) :, 0] += compass
        rows = rows[np.argsort(rows["arrival_ns"], kind="stable")]
    settings = replace(settings_of(None, where), aiding=Aiding(**aiding))
    filter_ = new_filter("navigation", samples, settings)
    out, innovations = replay(filter_, samples, fixes, rows)
    core = filter_.state["core"][0, 0].copy()
    return core, judged(d, out), innovations[innovations["kind"] == EXTERNAL_VX]


def once_trusted(innovations):
    """Whether each was used, after the first seconds, in which all have to agree before any is used."""
    t_s = 1e-9 * (innovations["t_ns"] - innovations["t_ns"][0])
    assert not innovations["used"][t_s < 3.5].any()
    return innovations["used"][t_s > 8.0]


def mounting(core):
    """Angles, deg, and their sigmas."""
    return np.degrees([[angle, np.sqrt(variance)] for _, angle, variance in velocity_mounting(core)]).T


@pytest.mark.thorough
@pytest.mark.parametrize("where", ["drive", "robot", "walk", "drone"])
@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.0, 0.0, 10.0), (3.0, -5.0, 30.0)])
def test_how_the_sensor_is_turned_is_found(where, rpy):
    core, found, innovations = turned(where, rpy)
    angles, sigmas = mounting(core)
    assert (np.abs(angles - rpy) < 4.0 * sigmas + 0.1).all(), (angles, sigmas)
    assert sigmas[2] < 2.0
    assert found.sure_s == 0.0, found.worst
    assert once_trusted(innovations).mean() > 0.98
    straight = turned(where, (0.0, 0.0, 0.0))[1]
    assert found.rms["velocity"] < 1.3 * straight.rms["velocity"]
    assert found.rms["yaw"] < 1.3 * straight.rms["yaw"] + 0.2


def test_axes_that_the_settings_say_are_those_of_the_velocities():
    core, found, innovations = turned("drone", (90.0, 0.0, 90.0), velocity_mount_rpy_deg=(90.0, 0.0, 90.0))
    assert mounting(core)[0] == pytest.approx((90.0, 0.0, 90.0), abs=1.0)
    assert once_trusted(innovations).mean() > 0.98 and found.sure_s == 0.0


def test_a_sensor_that_is_turned_on_the_way_is_found_anew():
    """By 45 deg: what was known of it is forgotten once most of its velocities are rejected."""
    core, found, innovations = turned("drone", (0.0, 0.0, 0.0), knock_deg=45.0)
    assert 0.9 < once_trusted(innovations).mean() < 0.97 and innovations["used"][-300:].all()
    assert mounting(core)[0][2] == pytest.approx(45.0, abs=2.0)
    assert found.sure_s == 0.0, found.worst


@pytest.mark.parametrize("where", ["walk", "drone"])
def test_axes_that_are_others_are_no_turn(where):
    """Forward, left, up, as many programs have them: no small turn explains it, and a wrong one is not believed."""
    found, innovations = turned(where, (180.0, 0.0, 0.0), seed=501)[1:]
    assert found.sure_s == 0.0, found.worst
    assert innovations["used"].mean() < 0.3


def test_velocities_of_one_system_that_are_wrong_do_not_touch_those_of_another():
    d, samples, fixes = scene(SEED, "city")
    good = SOURCES["body_velocity"](d, np.random.default_rng(1))
    bad = SOURCES["velocity"](d, np.random.default_rng(2))
    bad["value"][:, :3] *= 3.6
    rows = np.concatenate([good, bad])
    rows = rows[np.argsort(rows["arrival_ns"], kind="stable")]
    used = {}
    out, innovations = estimated(samples, fixes, rows, settings_of(None, "city"))
    for kind in (EXTERNAL_VX, EXTERNAL_VN):
        used[kind] = innovations["used"][innovations["kind"] == kind][200:].mean()
    assert used[EXTERNAL_VX] > 0.98 and used[EXTERNAL_VN] < 0.2
    assert judged(d, out).sure_s == 0.0


def test_the_effect_of_a_compass_that_is_off_is_predicted():
    """Against the difference of two runs, one with a compass that is off by a thousandth of a degree."""
    off = np.radians(1e-3)
    core, changed = (
        turned("drive", (0.0, 0.0, 0.0), compass=wrong, heading_boresight_sigma_deg=0.01)[0] for wrong in (0.0, off)
    )
    v = core["faults"]["boresight_sensitivity"][:, COMPASS_FAULT]
    yaw = np.radians(mounting(changed)[0][2] - mounting(core)[0][2]) / off
    assert v[BORESIGHTS - 1] == pytest.approx(yaw, abs=0.1)


def joint(seed):
    """(core, covariance of error states and boresights, generator)."""
    _, _, c, P, _, rng = made(seed)
    n = STATES + BORESIGHTS
    root = rng.standard_normal((n, n)) * np.append(np.sqrt(np.diag(P)), np.full(BORESIGHTS, 0.1))[:, None]
    joint = root @ root.T / n
    c["cov"]["P"] = joint[:STATES, :STATES][np.triu_indices(STATES)]
    c["cov"]["boresight"], c["cov"]["boresight_covariance"] = joint[:STATES, STATES:], joint[STATES:, STATES:]
    return c, joint, rng


@pytest.mark.parametrize("axis", [BODY_VELOCITY_AXIS, OTHER_AXIS])
def test_an_update_is_that_of_a_filter_with_the_boresights_among_its_states(axis):
    c, P, _ = joint(3)
    c["nav"]["velocity_mount"] = 1.0, 0.0, 0.0, 0.0
    h, z, r = np.zeros(STATES + BORESIGHTS), 1e-4, 0.3
    h[[VELOCITY, ATTITUDE + 1]] = 1.0, 2.0
    set_velocity_row(c, (3.0, 4.0, 5.0), 1)
    if axis == BODY_VELOCITY_AXIS:  # across, of a sensor that is turned about x and z
        h[STATES + VELOCITY_BORESIGHT], h[STATES + VELOCITY_BORESIGHT + 2] = 5.0, -3.0
        assert (c["scratch"]["boresight_row"] == h[STATES:]).all()
    m = set_jacobian(c, set_jacobian(c, 0, VELOCITY, 1.0), ATTITUDE + 1, 2.0)
    _, s, _ = correlated_update(c, m, z, r, 0.0, 0.0, axis)
    gain = P @ h / (h @ P @ h + r)
    expected = P - np.outer(gain, h @ P)
    assert s == pytest.approx(h @ P @ h + r)
    assert unpack(c["cov"]["P"], STATES) == pytest.approx(expected[:STATES, :STATES], abs=1e-10)
    assert c["cov"]["boresight"] == pytest.approx(expected[:STATES, STATES:], abs=1e-10)
    assert c["cov"]["boresight_covariance"] == pytest.approx(expected[STATES:, STATES:], abs=1e-10)
    found = [c["heading_aid"]["boresight"], *2.0 * c["nav"]["velocity_mount"][1:]]
    assert np.append(c["scratch"]["x"], found) == pytest.approx(gain * z, rel=1e-5, abs=1e-12)
