"""A gyro bias steps in an outage: what the estimate says afterwards is far off, and the fixes begin it anew."""

import numpy as np
import pytest
from in_c import in_c
from navigation_runner import navigate, settings_of
from navigation_simulation import Later, drive, errors, received, sensed

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins.aiding.gnss_reset import attitude_is_lost
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ATTITUDE, COARSE_ALIGNMENT, NAVIGATING, STATES
from imud.estimators.records import HEADING_VALID
from imud.math.kalman import packed_index

RATE, BEGIN_S, BACK_S = 100, 90.0, 170.0
DRIVE = Later(drive, 230.0, speed=12.0)


@pytest.mark.parametrize("step_dps", [(1.5, 0.0, 0.0), (0.0, -1.0, 0.5)])
@pytest.mark.parametrize("velocities", [True, False])
def test_after_an_outage_with_a_step_the_fixes_begin_the_estimate_anew(step_dps, velocities):
    d, rng = DRIVE, np.random.default_rng(3)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.1)
    samples["w"][int(BEGIN_S * RATE) :] += np.radians(step_dps)
    if not velocities:
        fixes["v"] = fixes["speed"] = fixes["course"] = np.nan
    t = fixes["t_ns"] * 1e-9 - 100.0
    out = navigate(samples, fixes[(t < BEGIN_S) | (t > BACK_S)], settings_of("free"))[0]
    off = np.hypot(*errors(d, out)[0][:, :2].T)
    assert off[int((BACK_S - 1.0) * RATE)] > 1000.0
    after = slice(int((BACK_S + 8.0) * RATE), None)
    assert off[after].max() < 40.0
    assert out["sigma_p"][after, :2].max() < 60.0


def test_after_an_outage_positions_that_converge_do_not_end_the_heading():
    """A receiver of 10 Hz and of positions alone, the first ones of which are off by hundreds of metres."""
    d, rng = DRIVE, np.random.default_rng(3)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.1, late=0.1)
    fixes["v"] = fixes["speed"] = fixes["course"] = np.nan
    t = fixes["t_ns"] * 1e-9 - 100.0
    back_s = BEGIN_S + 20.0
    fixes["lat"] += np.where(t > back_s, 300.0 * np.exp(-np.maximum(t - back_s, 0.0)), 0.0) / 6.37e6
    out = navigate(samples, fixes[(t < BEGIN_S) | (t > back_s)], settings_of("free"))[0]
    after = slice(int((back_s + 15.0) * RATE), None)
    assert (out["status"][after] & HEADING_VALID != 0).mean() > 0.9
    assert np.hypot(*errors(d, out)[0][after, :2].T).max() < 40.0


@pytest.mark.parametrize(
    ("mode", "tilt_deg", "lost"),
    [(NAVIGATING, 29.0, False), (NAVIGATING, 31.0, True), (COARSE_ALIGNMENT, 31.0, False)],
)
def test_an_attitude_is_lost_if_its_tilt_is_too_uncertain_for_a_linear_update(mode, tilt_deg, lost):
    settings = configure(Settings(), RATE)
    c = start(settings, Initial())["core"][0, 0]
    c["alignment"]["mode"] = mode
    for i, sigma_deg in enumerate((1.0, tilt_deg)):
        c["cov"]["P"][interpreted(packed_index)(STATES, ATTITUDE + i, ATTITUDE + i)] = np.radians(sigma_deg) ** 2
    assert in_c(attitude_is_lost)(settings[0], c) == lost
