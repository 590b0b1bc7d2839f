"""Before the first rest: what the hypotheses of how the body moves say of the tilt error."""

import numpy as np
import pytest
from test_attitude_step import Fields

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ahrs.setup import configure, start
from imud.estimators.ahrs.state import ATTITUDE, STATES
from imud.estimators.ahrs.velocity_hypotheses import HANDS, measure_hypotheses, start_hypotheses
from imud.math.kalman import packed_index


def possible_tilt_error(hypothesis, tilt, sigma):
    """rad; of a body that is known to be of this hypothesis, with a tilt error about one axis; sigma: the filter's."""
    parameters = configure(Settings(), 100.0)
    state = start(parameters, Initial())
    p, s = Fields(parameters[0]), Fields(state[0])
    interpreted(start_hypotheses)(p, s)
    s.cov.P[:] = 0.0
    for axis in range(2):
        s.cov.P[interpreted(packed_index)(STATES, ATTITUDE + axis, ATTITUDE + axis)] = sigma**2
    bank = s.hypotheses
    bank.log_likelihood[:] = -100.0
    bank.log_likelihood[hypothesis] = 0.0
    bank.P[:] = 0.0
    bank.x[:, 0] = tilt
    bank.time = 1.0
    interpreted(measure_hypotheses)(p, s)
    return float(bank.possible_tilt_error)


@pytest.mark.parametrize(("hypothesis", "contradiction"), [(0, 4.0), (HANDS, 1.0)])
def test_a_hand_counts_from_where_its_tilt_contradicts_the_filter_and_a_vehicle_from_the_filters_own_sigma(
    hypothesis, contradiction
):
    variance = 2.0 * 0.01**2  # of both axes
    within, beyond = 0.9 * np.sqrt(contradiction * variance), 0.2
    assert possible_tilt_error(hypothesis, within, 0.01) < 0.003
    expected = np.sqrt(0.5 * (beyond**2 - contradiction * variance))
    np.testing.assert_allclose(possible_tilt_error(hypothesis, beyond, 0.01), expected, rtol=0.02)
