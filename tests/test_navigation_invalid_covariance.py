"""A variance that is negative or no number ends no run: the filter is started anew, and says so."""

import numpy as np
import pytest
from navigation_simulation import drive, errors, received, sensed
from replay_in_process import new_filter, replay
from simulated_errors import part

from imud.batch import play
from imud.compile.jit import interpreted
from imud.configuration.settings import Initial
from imud.estimators.ins.setup import is_valid
from imud.estimators.ins.state import ATTITUDE, POSITION, STATES
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, POSITION_VALID, SOLUTION
from imud.math.kalman import packed_index
from imud.pipeline import Stored

RATE, BEGIN_S = 100, 60.0


def parts():
    """(drive, filter after a minute, the samples and fixes that follow)."""
    rng, d = np.random.default_rng(3), drive(120.0)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.1, sigma=0.5)
    begin_ns = (100.0 + BEGIN_S) * 1e9
    filter_ = new_filter("navigation", samples)
    before = samples["t_ns"] < begin_ns, fixes["arrival_ns"] < begin_ns
    replay(filter_, samples[before[0]], fixes[before[1]])
    return d, filter_, samples[~before[0]], fixes[~before[1]]


def spoil(filter_, value):
    for core in ("core", "snapshots"):
        filter_.state[core]["cov"]["P"][..., 0] = value


@pytest.mark.parametrize("value", [-1.0, np.nan])
def test_a_table_goes_on_with_the_filter_started_anew(value):
    d, filter_, samples, fixes = parts()
    spoil(filter_, value)
    rows = []
    play(filter_, samples, fixes, lambda block: rows.append(block.copy()))
    out = np.concatenate(rows)
    assert filter_.restarts == 1
    assert "started anew" in filter_.findings()[-1]
    later = part(d, slice(-10 * RATE, None))
    assert np.hypot(*errors(later, out[-10 * RATE :])[0][:, :2].T).max() < 5.0
    valid = ATTITUDE_VALID | POSITION_VALID
    assert (out["status"][-10 * RATE :] & valid == valid).all()


def test_live_each_fix_is_looked_at():
    _, filter_, _, fixes = parts()
    spoil(filter_, np.nan)
    filter_.update(fixes[:1])
    assert filter_.restarts == 1
    assert is_valid(filter_.state)


@pytest.mark.parametrize(("first", "value"), [(POSITION, -1.0), (POSITION, np.nan), (ATTITUDE, np.nan)])
def test_nothing_counts_as_valid_whose_variance_is_none(first, value):
    _, filter_, samples, _ = parts()
    filter_.state["core"]["cov"]["P"][..., interpreted(packed_index)(STATES, first, first)] = value
    out = np.zeros(1, SOLUTION)
    filter_.run(samples[:1].copy(), out)
    assert out["status"][0] & (ATTITUDE_VALID | HEADING_VALID | POSITION_VALID) == 0


def test_a_checkpoint_that_is_not_valid_is_not_resumed():
    _, filter_, samples, _ = parts()
    spoil(filter_, -1.0)
    stored = Stored(checkpoint=filter_.checkpoint())
    other = new_filter("navigation", samples, initial=Initial(lat_deg=48.0, lon_deg=11.0, yaw_deg=30.0))
    before = other.state.copy()
    assert not other.restore(stored)
    assert other.state.tobytes() == before.tobytes()
