"""A vehicle that brakes without a fix before its heading is known: the sigma has what the force shows."""

import numpy as np
from navigation_runner import navigate
from navigation_simulation import errors, moved, received, sensed
from scipy.spatial.transform import Rotation

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins import ekf
from imud.estimators.ins.alignment.velocity_change import add_velocity_change
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import NAVIGATING, VELOCITY
from imud.estimators.records import HEADING_VALID

SPEED, BRAKES_S, BRAKED_S, LAST_FIX_S, END_S, RATE = 15.0, 14.0, 34.0, 12.0, 80.0, 100


def variance_after(force, psd=0.0, mode=None, seconds=10.0, fix_s=()):
    """Variance of the velocity north, m^2/s^2, from 0, after level specific forces (n, 2), m/s^2, in intervals."""
    c = start(configure(Settings(), 100.0), Initial())["core"][0, 0].view(np.recarray)
    c.cov.P[:] = 0.0
    if mode is not None:
        c.alignment.mode = mode
    dt = seconds / len(force)
    c.scratch.transition.velocity_psd, c.scratch.transition.interval = psd, dt
    for i, a in enumerate(force):
        c.nav.t_ns = round(1e9 * dt * (i + 1))
        if any(abs(c.nav.t_ns * 1e-9 - t) < 0.5 * dt for t in fix_s):
            c.gnss.last_used_ns = c.nav.t_ns
        c.alignment.integrals[0] += np.asarray(a) * dt
        interpreted(add_velocity_change)(c, c.scratch.transition)
    return interpreted(ekf.variance)(c, VELOCITY)


def test_it_is_half_the_square_of_the_change_in_an_unknown_direction():
    """Oracle: the mean over all directions of a change of 12 m/s."""
    angles = np.arange(0.0, 2.0 * np.pi, 1e-3)
    oracle = np.mean((12.0 * np.cos(angles)) ** 2)
    np.testing.assert_allclose(variance_after(np.tile([0.72, 0.96], (500, 1))), oracle, rtol=0.02)


def test_a_change_that_is_undone_leaves_its_variance_and_a_fix_begins_anew():
    there_and_back = np.vstack([np.tile([1.0, 0.0], (250, 1)), np.tile([-1.0, 0.0], (250, 1))])
    np.testing.assert_allclose(variance_after(there_and_back), 12.5, rtol=0.02)
    np.testing.assert_allclose(variance_after(np.tile([1.0, 0.0], (500, 1)), fix_s=(5.0,)), 25.0, rtol=0.02)


def test_the_process_noise_counts_and_navigation_needs_none():
    force = np.tile([1.0, 0.0], (500, 1))
    np.testing.assert_allclose(variance_after(force, psd=3.0), 50.0 - 30.0, rtol=0.02)
    assert variance_after(force, psd=6.0) == 0.0
    assert variance_after(force, mode=NAVIGATING) == 0.0


def test_a_car_that_stops_without_a_fix():
    """Before, it went on at its last velocity: after 80 s 820 m off, and 3.5 to 3.8 sigma."""
    t = np.arange(END_S * RATE) / RATE
    speed = np.interp(t, [BRAKES_S, BRAKED_S], [SPEED, 0.0])
    heading = Rotation.from_euler("z", 40.0, degrees=True)
    d = moved(t, heading.apply(np.column_stack([speed, 0.0 * t, 0.0 * t])), Rotation.concatenate([heading] * len(t)))
    rng = np.random.default_rng(1)
    fixes = received(d, rng)
    out = navigate(sensed(d, rng), fixes[fixes["t_ns"] < 1e9 * (100.0 + LAST_FIX_S)])[0]
    assert not (out["status"] & HEADING_VALID).any()
    p = np.hypot(*errors(d, out)[0][:, :2].T)
    sigma = np.hypot(*out["sigma_p"][:, :2].T)
    assert p[t > LAST_FIX_S + 5.0].max() > 10.0  # nothing shows the direction of the force
    assert (p / sigma)[t > LAST_FIX_S].max() < 2.5
    assert p[-1] < 200.0
