"""What a power-on of the sensor leaves of an estimate: the attitude and the scale factors, but not the biases.

A sensor's bias changes from one switch-on to the next by the repeatability in its data sheet, which is the standard
deviation with which the filter starts. What was learned before the power-on is worth no more than that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from .error_model import reset_variance
from .last_sample import subtract_biases
from .mechanization import clear_biases
from .state import ACCEL_BIAS, GYRO_BIAS
from .stationarity import reset_rest
from .velocity_hypotheses import drop_yaw_correction

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def reset_biases(p: Parameters, s: State) -> None:
    """Put both biases back to what is known of them at switch-on; rest and the force at rest are determined anew."""
    subtract_biases(s)  # the last sample as this sensor would show it, for the gap that follows it
    clear_biases(s)
    for i in range(3):
        reset_variance(s, GYRO_BIAS + i, p.gyro_bias_var)
        reset_variance(s, ACCEL_BIAS + i, p.accel_bias_var)
    drop_yaw_correction(s)
    reset_rest(s)
