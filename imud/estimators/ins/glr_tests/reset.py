"""All tests begin anew where the estimate has changed otherwise than by updates: what they have added up is of another.

Not that of a compass's offset, which begins with the compass.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel
from .gnss_drift import reset_drift
from .gyro_bias_step import reset_gyro_bias_step
from .imu_bias_step import interrupt_imu_bias_step
from .lever_arm_error import reset_lever_arm_error
from .time_offset_step import reset_time_offset_step
from .velocity_drift import reset_velocity_drift

if TYPE_CHECKING:
    from ..types import Core


@kernel
def reset_glr_tests(c: Core) -> None:
    """Close all onsets, and clear a detected drift."""
    reset_drift(c)
    reset_time_offset_step(c)
    reset_gyro_bias_step(c)
    interrupt_imu_bias_step(c)
    reset_velocity_drift(c)
    reset_lever_arm_error(c)
