"""Positions that jump for some seconds: whether the gate rejects them or not, the stated sigma covers them."""

import numpy as np
import pytest
from accuracy_simulated import figures
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed
from scipy.stats import multivariate_normal

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins.integrity.position_jump import state_likely_jump
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start

D = Later(drive, 160.0, speed=12.0)
PARAMETERS = configure(Settings(), 100.0)


def stated(z, variances, least=0.0, before=0.0, outage_s=1.0):
    """Position inflation, m^2, after positions with these innovations."""
    c = start(PARAMETERS, Initial())["core"][0, 0].view(np.recarray)
    c.nav.t_ns, c.gnss.last_used_ns = round(1e9 * outage_s), 0
    c.integrity.position_inflation[:2] = before
    c.scratch.position_innovation[:2] = z
    interpreted(state_likely_jump)(PARAMETERS.view(np.recarray)[0], c, variances, least)
    return c.integrity.position_inflation[:2]


@pytest.mark.parametrize("z", [(0.0, 0.0), (4.0, -3.0), (9.0, 2.0), (-8.0, 8.0), (300.0, 0.0)])
@pytest.mark.parametrize("variances", [(4.0, 6.0), (0.01, 0.02), (900.0, 400.0)])
@pytest.mark.parametrize(("outage_s", "name"), [(1.0, "jump_probability"), (9.0, "reacquired_jump_probability")])
def test_the_expected_square_of_a_jump_is_that_of_bayes(z, variances, outage_s, name):
    tuning = PARAMETERS[0]["tuning"]
    prior, jump2 = tuning[name], tuning["jump_sigma"] ** 2
    log_odds = np.log(prior / (1.0 - prior)) + (
        multivariate_normal.logpdf(z, cov=np.diag(variances) + jump2 * np.eye(2))
        - multivariate_normal.logpdf(z, cov=np.diag(variances))
    )
    probability = 1.0 / (1.0 + np.exp(-log_odds))
    jump = np.linalg.inv(np.diag(1.0 / np.array(variances)) + np.eye(2) / jump2)  # its covariance, if there is one
    mean = jump @ np.diag(1.0 / np.array(variances)) @ z
    square = mean**2 + (np.diag(jump) if outage_s > 5.0 else 0.0)
    assert stated(z, variances, outage_s=outage_s) == pytest.approx(probability * square, rel=1e-9)


def test_the_end_of_an_outage_is_no_jump():
    """The innovation is the estimate's error: 500 m at a sigma of 200 m is likely, and no jump of some metres."""
    assert np.sqrt(stated((500.0, 100.0), (4e4, 4e4), outage_s=60.0)).max() < 4.0


def test_other_positions_may_have_shown_the_jump_and_what_was_stated_stays():
    assert stated((3.0, 0.0), (4.0, 4.0), least=0.5)[0] == pytest.approx(4.5)
    assert stated((3.0, 0.0), (4.0, 4.0), before=100.0)[0] == 100.0


@pytest.mark.parametrize(("vehicle", "seed"), [("walker", 1302), ("boat", 1303), ("ship", 1301), ("robot", 1302)])
def test_multipath_is_never_wrong_and_sure_for_long_where_the_heading_is_not_known(vehicle, seed):
    """From positions alone the filter has little to reject it by; before jumps were stated: 49 to 59 s."""
    run = figures(vehicle, "1 Hz positions", 0.0, seed, error="multipath")
    assert run["position s"] < 6.0


def test_a_first_position_that_was_wrong_is_stated_while_the_right_ones_are_rejected():
    rng = np.random.default_rng(2)
    fixes = received(D, rng, late=0.1, sigma=1.0)
    fixes["lat"][0] += 40.0 / 6.37e6
    out, rows, _ = navigate(sensed(D, rng), fixes)
    rejected = rows[(rows["kind"] == 0) & (rows["used"] == 0)]["t_ns"] * 1e-9 - 100.0
    assert len(rejected) > 3
    p = errors(D, out)[0][:, 0]
    while_rejected = slice(int(100 * (rejected[0] + 3.0)), int(100 * rejected[-1]))
    assert np.abs(p[while_rejected]).min() > 20.0
    assert (np.abs(p) < 4.0 * out["sigma_p"][:, 0])[while_rejected].all()
