"""The modes of the navigation filter follow their table of events."""

import math

import numpy as np
import pytest

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins import ESTIMATOR
from imud.estimators.ins.alignment.modes import (
    ATTITUDE_LOST,
    EVENTS,
    GIVEN_HEADING_WRONG,
    HEADING_KNOWN,
    HEADING_WRONG,
    TRANSITIONS,
    change_mode,
)
from imud.estimators.ins.state import ATTITUDE, COARSE_ALIGNMENT, COMPASS_FAULT, GYRO_BIAS, NAVIGATING, STATES
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
    unknown = event in (HEADING_WRONG, GIVEN_HEADING_WRONG)  # no less than VARIANCE is known before the first sample
    assert c.nav.bg[0] == (0.0 if unknown else 1e-3)
    assert P[GYRO_BIAS, GYRO_BIAS] == pytest.approx(p.gyro_bias_sigma**2 if unknown else VARIANCE)


def test_a_given_heading_that_is_wrong_costs_of_the_gyro_biases_what_it_may_have_done_to_them(parameters, core):
    """At most two times what a radian does; no more than was known before the first sample; a least sigma."""
    p, c = record(parameters), core
    for i, sensitivity in enumerate((0.0, 5e-3, 1.0)):  # rad/s per rad
        c.faults.sensitivity[GYRO_BIAS + i, COMPASS_FAULT] = sensitivity
        c.cov.P[interpreted(packed_index)(STATES, GYRO_BIAS + i, GYRO_BIAS + i)] = 1e-6
    interpreted(change_mode)(p, c, GIVEN_HEADING_WRONG)
    P = np.diag(unpack(c.cov.P, STATES))[GYRO_BIAS : GYRO_BIAS + 3]
    assert pytest.approx((p.tuning.kept_gyro_bias_sigma**2, 1.01e-4, p.gyro_bias_sigma**2)) == P
    assert (c.nav.bg == (1e-3, 1e-3, 0.0)).all()  # of the last one no more is known than before the first sample
