"""A heading that pairs of fixes contradict: what the heading monitor does by the alignment's verdict, given here."""

import numpy as np
import pytest
from test_navigation_jacobians import fix_near, nominal, record

from imud.compile.jit import interpreted
from imud.estimators.ins.integrity import heading_monitor
from imud.estimators.ins.solution import write_solution
from imud.estimators.ins.state import ATTITUDE, STATES
from imud.estimators.records import HEADING_VALID, SOLUTION
from imud.math.kalman import packed_index
from imud.math.rotation import euler_of_quat

OFF, YAW = 1.7, interpreted(packed_index)(STATES, ATTITUDE + 2, ATTITUDE + 2)


@pytest.fixture
def contradicted(monkeypatch):
    """contradicted(sigma) -> (turn of the heading in rad, its sigma, and HEADING_VALID after each of three pairs)."""

    def run(sigma):
        p, s = nominal(3)
        c = record(s).core[0]
        c.cov.P[YAW] = 0.01**2
        parameters, bank = p[0].view(np.recarray), record(s).bank[0]

        def match(p, c, b, *fix):
            b.weight += 1.0

        monkeypatch.setattr(heading_monitor, "match_pair", match)
        monkeypatch.setattr(heading_monitor, "solve_heading", lambda *a: (OFF, sigma, 0.0, 0.0, 0.0))
        row, valid = np.zeros(1, SOLUTION), []
        before = euler_of_quat(c.nav.q_nb)[2]
        for _ in range(3):
            interpreted(heading_monitor.monitor_heading)(parameters, c, bank, fix_near(c, np.random.default_rng(1)))
            interpreted(write_solution)(parameters, c, record(row))
            valid.append(bool(row["status"][0] & HEADING_VALID))
        return (euler_of_quat(c.nav.q_nb)[2] - before + np.pi) % (2 * np.pi) - np.pi, np.sqrt(c.cov.P[YAW]), valid

    return run


def test_a_sure_alignment_turns_the_heading(contradicted):
    turned, sigma, _ = contradicted(0.1)
    assert turned == pytest.approx(OFF)
    assert 0.05 < sigma < 0.2


def test_an_unsure_alignment_inflates_the_heading_only(contradicted):
    """98 deg off but with a sigma of 23 deg: no heading that navigation would start with."""
    turned, sigma, _ = contradicted(0.4)
    assert turned == pytest.approx(0.0)
    assert sigma == pytest.approx(np.hypot(0.01, np.radians(20.0)), rel=1e-3)


def test_while_pairs_contradict_it_the_heading_is_not_valid(contradicted):
    assert contradicted(0.4)[2][:2] == [True, False]


@pytest.mark.parametrize("rejected", [0, 1, 2])
def test_with_two_rejected_velocities_in_a_row_the_heading_is_not_valid(rejected):
    """A wrong heading rejects them, as a turn that the gyro has not seen; one alone may be an outlier."""
    p, s = nominal(3)
    c = record(s).core[0]
    c.cov.P[YAW], c.integrity.velocity_reject_count = 0.01**2, rejected
    row = np.zeros(1, SOLUTION)
    interpreted(write_solution)(p[0].view(np.recarray), c, record(row))
    assert bool(row["status"][0] & HEADING_VALID) == (rejected < 2)
