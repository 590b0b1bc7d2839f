"""An accelerometer axis that is stuck at one value: the INS without a receiver keeps its attitude, or says so."""

import numpy as np
import pytest

import imud

RATE, STUCK_S, END_S = 200, 20.0, 40.0


@pytest.mark.filterwarnings("ignore::UserWarning")  # of the findings
@pytest.mark.parametrize(("axis", "value"), [(2, -40.0), (2, 40.0), (0, 40.0), (1, -40.0)])
def test_a_stuck_axis_does_not_tilt_the_attitude(axis, value):
    """Far beyond gravity, as at the end of a range that nobody stated. It rolls to and fro meanwhile."""
    rng = np.random.default_rng(1)
    t = np.arange(int(END_S * RATE)) / RATE
    rate = 0.3 * np.sin(t) * (t > 10.0)
    roll = np.cumsum(rate) / RATE
    gyro = 2e-3 * rng.standard_normal((len(t), 3))
    gyro[:, 0] += rate
    accel = -9.81 * np.column_stack([0.0 * t, np.sin(roll), np.cos(roll)]) + 0.02 * rng.standard_normal((len(t), 3))
    accel[t > STUCK_S, axis] = value
    solution = imud.attitude(t, gyro, accel, estimator="navigation")
    error = np.abs(np.column_stack([solution.roll_deg - np.degrees(roll), solution.pitch_deg]))
    known = solution.attitude_valid & (t > 15.0)
    assert known[-1]
    assert error[known].max() < 2.0
