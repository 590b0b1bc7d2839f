"""The modes of the navigation filter follow their table of events."""

import math

import numpy as np
import pytest

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins import ESTIMATOR
from imud.estimators.ins.alignment.modes import ATTITUDE_LOST, EVENTS, HEADING_KNOWN, TRANSITIONS, change_mode
from imud.estimators.ins.state import ATTITUDE, COARSE_ALIGNMENT, GYRO_BIAS, NAVIGATING, STATES
from imud.math.kalman import packed_index, unpack

SIGMA = 0.1  # of the heading that is known
VARIANCE = 0.04  # of each error state before


def record(array):
    """The only element of an array, with its fields as attributes."""
    return array.view(np.recarray)[0]


@pytest.fixture
def parameters():
    return ESTIMATOR.configure(Settings(), 100.0)


@pytest.fixture
def core(parameters):
    c = record(ESTIMATOR.start(parameters, Initial())["core"][0])
    c.imu.f[:], c.nav.bg[:], c.alignment.heading_sigma = (0.0, 0.0, -9.8), 1e-3, SIGMA
    for i in range(STATES):
        c.cov.P[interpreted(packed_index)(STATES, i, i)] = VARIANCE
    return c


@pytest.mark.parametrize("mode", [COARSE_ALIGNMENT, NAVIGATING])
@pytest.mark.parametrize("event", range(EVENTS))
def test_an_event_leads_to_the_mode_of_the_table_and_what_it_ends_is_unknown(parameters, core, mode, event):
    p, c = record(parameters), core
    c.alignment.mode = mode
    interpreted(change_mode)(p, c, event)
    P = unpack(c.cov.P, STATES)
    assert (
        c.alignment.mode == TRANSITIONS[mode][event][0] == (NAVIGATING if event == HEADING_KNOWN else COARSE_ALIGNMENT)
    )
    assert P[ATTITUDE + 2, ATTITUDE + 2] == pytest.approx(SIGMA**2 if event == HEADING_KNOWN else math.pi**2)
    assert P[ATTITUDE, ATTITUDE] == pytest.approx(p.tuning.lost_tilt**2 if event >= ATTITUDE_LOST else VARIANCE)
    cleared = event > ATTITUDE_LOST
    assert c.nav.bg[0] == (0.0 if cleared else 1e-3)
    assert P[GYRO_BIAS, GYRO_BIAS] == pytest.approx(p.gyro_bias_sigma**2 if cleared else VARIANCE)
