"""A rejected position is part of the stated sigma where only the IMU supports the estimate, which may be wrong."""

import numpy as np
from navigation_runner import navigate, without
from test_navigation_faults import at, data, moved

from imud.estimators.records import REJECTING

OUTAGE = (100.0, 112.5)  # s; the next fix is at 113 s and contradicts the estimate
REJECTED_S = 113.7
METRES = 40.0


def without_velocity(fixes):
    fixes = fixes.copy()
    for name in ("v", "speed", "course"):
        fixes[name] = np.nan
    return fixes


def solutions(fixes):
    """Solutions of a drive with an outage, without and with a jump of the positions north after it."""
    samples = data()[0]
    fixes = without(fixes, [(100.0 + OUTAGE[0], 100.0 + OUTAGE[1], 0)])
    return navigate(samples, fixes)[0], navigate(samples, moved(fixes, OUTAGE[1], 115.0, METRES))


def test_a_rejected_position_widens_the_stated_sigma_by_the_velocity_that_explains_it():
    clean, (out, rows, _) = solutions(without_velocity(data()[1]))
    position = rows[rows["kind"] == 0]
    k = at(REJECTED_S)
    used = position[(position["used"] == 1) & (position["t_ns"] < out["t_ns"][at(OUTAGE[1])])]["t_ns"][-1]
    last = position[(position["used"] == 0) & (position["t_ns"] <= out["t_ns"][k])]["t_ns"][-1]
    assert out["status"][k] & REJECTING
    outage_s, since_s = 1e-9 * (last - used), 1e-9 * (out["t_ns"][k] - used)
    speed = np.hypot(*out["v"][np.searchsorted(out["t_ns"], last), :2])
    velocity = min(METRES / outage_s, np.hypot(0.25, 0.05 * speed))
    for field, error in (("sigma_p", velocity * since_s), ("sigma_v", velocity)):
        before = out[field][at(OUTAGE[1]), 0]
        assert np.hypot(error, before) < out[field][k, 0] < 1.2 * np.hypot(error, before), field
    assert (out["sigma_p"][at(118.0), :2] < 1.2 * clean["sigma_p"][at(118.0), :2] + 1.0).all()


def test_a_rejected_position_is_not_stated_where_the_receiver_s_velocity_supports_the_estimate():
    clean, (out, _, _) = solutions(data()[1])
    assert out["status"][at(REJECTED_S)] & REJECTING
    for field in ("sigma_p", "sigma_v"):
        assert (out[field][at(REJECTED_S)] < 1.5 * clean[field][at(REJECTED_S)]).all(), field
