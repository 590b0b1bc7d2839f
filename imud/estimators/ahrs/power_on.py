"""What a power-on of the sensor leaves of an estimate: the attitude and the scale factors, but not the biases.

A sensor's bias changes from one switch-on to the next by the repeatability in its data sheet, which is the standard
deviation with which the filter starts. What was learned before the power-on is worth no more than that.
"""

from typing import Any

from ...compile.jit import kernel
from ...math.kalman import reset
from .state import ACCEL_BIAS, GYRO_BIAS, STATES
from .stationarity import restart_means_at_last


@kernel
def reopen_biases(p: Any, s: Any) -> None:
    """Put both biases back to what is known of them at switch-on; rest and the force at rest are judged anew."""
    for i in range(3):
        s.imu.w[i] -= s.nav.bg[i]  # the last sample as this sensor would show it, for the gap that follows it
        s.imu.f[i] -= s.nav.ba[i]
        s.nav.bg[i] = s.nav.ba[i] = 0.0
        reset(s.cov.P, STATES, GYRO_BIAS + i, p.gyro_bias_var)
        reset(s.cov.P, STATES, ACCEL_BIAS + i, p.accel_bias_var)
    restart_means_at_last(s)
    s.stationarity.bias_mismatch_s = 0.0
    s.stationarity.gravity_checked = 0
