"""The modes of the filter as one table: which event leads from one to another, and what is done on the way.

| mode                | event         | mode afterwards  | what is done |
|---------------------|---------------|------------------|--------------|
| COARSE_ALIGNMENT    | HEADING_KNOWN | NAVIGATING       | the heading's variance is set; position and velocity: from the antenna to the IMU |
| COARSE_ALIGNMENT    | HEADING_LOST  | COARSE_ALIGNMENT | the heading is unknown |
| NAVIGATING          | HEADING_KNOWN | NAVIGATING       | the heading's variance is set |
| NAVIGATING          | HEADING_LOST  | COARSE_ALIGNMENT | position and velocity: from the IMU to the antenna; the heading is unknown |
| any                 | ATTITUDE_LOST | COARSE_ALIGNMENT | as HEADING_LOST; roll and pitch from gravity, the vehicle's axis is unknown |
| any                 | HEADING_WRONG | COARSE_ALIGNMENT | as ATTITUDE_LOST; sensor errors are cleared, because they were learned with it |
| any                 | GIVEN_HEADING_WRONG | COARSE_ALIGNMENT | the same, but for the gyro biases: what the heading has done to them is added to P |

Every event also resets the tests of drift and of steps; HEADING_KNOWN clears what learns the process noise, and the
pairs. Sensor errors are the biases, gyro_scale and the learned process noise; the lever arm is forgotten with them. A
velocity's boresight is forgotten with every event that leads to COARSE_ALIGNMENT.
The filter begins in COARSE_ALIGNMENT.
"""  # noqa: E501 a table's row is one line

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ....compile.jit import kernel
from ....math.rotation import quat_of_gravity
from ...tuning import Tunable
from ..aiding.lever_arm_prior import forget_lever_arm
from ..aiding.non_holonomic import reset_nhc
from ..boresights import forget_velocity_boresight, share_boresight
from ..ekf import add_variance, combine, combine3, decorrelate, innovation_variance, variance
from ..error_model import reset_gyro_scale
from ..fusion import propagate_errors
from ..glr_tests.compass_offset import close_compass_offset, sensitivity_to_compass
from ..glr_tests.reset import reset_glr_tests
from ..glr_tests.velocity_drift import reset_confirmations
from ..lever_arm import (
    antenna_position,
    antenna_velocity,
    arm_position_row,
    arm_velocity_row,
    attitude_row,
    gyro_bias_row,
)
from ..mechanization import clear_gyro_bias, clear_sensor_errors, displace, set_attitude, set_velocity
from ..process_noise import clear_learning, reset_process_noise
from ..state import (
    ACCEL_BIAS,
    ATTITUDE,
    COARSE_ALIGNMENT,
    GNSS_LEVER_ARM,
    GYRO_BIAS,
    NAVIGATING,
    NEVER_NS,
    POSITION,
    TIME_OFFSET,
    VELOCITY,
)
from .velocity_pairs import restart_in_motion_alignment, vertical_bias_jacobian

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "min_heading_sigma",
        math.radians(3.0),
        "rad",
        "Least heading sigma to start navigation with.",
        "Linearization errors of alignment.",
    ),
    Tunable(
        "kept_gyro_bias_sigma",
        math.radians(0.2),
        "rad/s",
        "Least sigma of a gyro bias that is kept where a heading that was given is wrong.",
        "Simulated helicopters: the tilt, which has to be found anew in motion, is not sure too soon.",
    ),
    Tunable(
        "lost_tilt", math.radians(20.0), "rad", "Tilt sigma from which the alignment starts again.", "Linearization."
    ),
)
EVENTS = 5
HEADING_KNOWN, HEADING_LOST, ATTITUDE_LOST, HEADING_WRONG, GIVEN_HEADING_WRONG = range(EVENTS)
SET_HEADING, TO_IMU, TO_ANTENNA, RESET_HEADING, RESET_TILT, RESET_ERRORS = 1, 2, 4, 8, 16, 32  # what is done
KEEP_GYRO_BIASES = 64  # with RESET_ERRORS
RESET_WITH_GIVEN = RESET_HEADING | RESET_TILT | RESET_ERRORS | KEEP_GYRO_BIASES
TRANSITIONS = {  # mode: for each event the mode afterwards, and what is done
    COARSE_ALIGNMENT: {
        HEADING_KNOWN: (NAVIGATING, SET_HEADING | TO_IMU),
        HEADING_LOST: (COARSE_ALIGNMENT, RESET_HEADING),
        ATTITUDE_LOST: (COARSE_ALIGNMENT, RESET_HEADING | RESET_TILT),
        HEADING_WRONG: (COARSE_ALIGNMENT, RESET_HEADING | RESET_TILT | RESET_ERRORS),
        GIVEN_HEADING_WRONG: (COARSE_ALIGNMENT, RESET_WITH_GIVEN),
    },
    NAVIGATING: {
        HEADING_KNOWN: (NAVIGATING, SET_HEADING),
        HEADING_LOST: (COARSE_ALIGNMENT, TO_ANTENNA | RESET_HEADING),
        ATTITUDE_LOST: (COARSE_ALIGNMENT, TO_ANTENNA | RESET_HEADING | RESET_TILT),
        HEADING_WRONG: (COARSE_ALIGNMENT, TO_ANTENNA | RESET_HEADING | RESET_TILT | RESET_ERRORS),
        GIVEN_HEADING_WRONG: (COARSE_ALIGNMENT, TO_ANTENNA | RESET_WITH_GIVEN),
    },
}
NEXT_MODE, ACTIONS = np.array([TRANSITIONS[mode][event] for mode in TRANSITIONS for event in range(EVENTS)]).T.copy()


@kernel
def change_mode(p: Parameters, c: Core, event: int) -> None:
    """Follow the table above after an event."""
    row = EVENTS * c.alignment.mode + event
    actions = ACTIONS[row]
    if actions & SET_HEADING:
        set_heading_covariance(p, c)
    if actions & TO_IMU:
        transfer_lever_arm(c, 1.0)
    if actions & TO_ANTENNA:
        transfer_lever_arm(c, -1.0)
    c.alignment.mode = NEXT_MODE[row]
    reset_glr_tests(c)
    reset_confirmations(c)
    if NEXT_MODE[row] == COARSE_ALIGNMENT:
        forget_velocity_boresight(c)
    if actions & RESET_HEADING:
        c.alignment.heading_sigma = 0.0
        close_compass_offset(c)
        decorrelate(c, ATTITUDE + 2, math.pi**2)
    if actions & RESET_TILT:
        reset_tilt(p, c)
    if actions & SET_HEADING:
        clear_learning(c)
        restart_in_motion_alignment(c)
    if actions & RESET_ERRORS:
        reset_sensor_errors(p, c, actions & KEEP_GYRO_BIASES != 0)
        forget_lever_arm(c)


@kernel
def set_heading_accuracy(p: Parameters, c: Core, sigma: float, bias_gain: float) -> None:
    """Store sigma (rad) of a heading that was found or given; bias_gain: s, its error per frame rate,
    which is minus that per vertical gyro bias.
    """
    c.alignment.heading_sigma = max(sigma, p.tuning.min_heading_sigma)
    c.alignment.heading_bias_gain = bias_gain


@kernel
def set_heading_covariance(p: Parameters, c: Core) -> None:
    """P of the heading from alignment.heading_sigma.

    An error of the vertical gyro bias has turned the heading by minus heading_bias_gain times itself: the two are
    correlated. One that a compass gave before the first fix has the error of its boresight.
    """
    of_compass = c.alignment.mode == COARSE_ALIGNMENT and c.cov.boresight[ATTITUDE + 2, 0] != 0.0
    propagate_errors(p, c)
    bias_part = c.alignment.heading_bias_gain**2 * innovation_variance(c, vertical_bias_jacobian(c))
    decorrelate(c, ATTITUDE + 2, max(c.alignment.heading_sigma**2 - bias_part, p.tuning.min_heading_sigma**2))
    for k in range(vertical_bias_jacobian(c)):
        combine(c, ATTITUDE + 2, c.scratch.columns[k], -c.alignment.heading_bias_gain * c.scratch.values[k])
    if of_compass:
        share_boresight(c)
    c.alignment.heading_bias_gain = 0.0


@kernel
def reset_tilt(p: Parameters, c: Core) -> None:
    """Roll and pitch from the newest force, the vehicle's axis in the body unknown."""
    reset_nhc(p, c)
    restart_in_motion_alignment(c)
    set_attitude(c, quat_of_gravity(c.imu.f[0], c.imu.f[1], c.imu.f[2] - 1e-3))
    for i in range(2):
        decorrelate(c, ATTITUDE + i, p.tuning.lost_tilt**2)


@kernel
def reset_sensor_errors(p: Parameters, c: Core, keep_gyro_biases: bool) -> None:
    """Biases, gyro_scale and the process noise as before the first sample.

    keep_gyro_biases: a heading that was given is wrong. By how much is not known; at most it has moved them by what a
    heading does that is the wrong way round, whose velocities differ by two times themselves. Those of which less is
    known than before the first sample are not kept.
    """
    clear_sensor_errors(c)
    for i in range(3):
        prior = p.gyro_bias_sigma**2
        moved = variance(c, GYRO_BIAS + i) + (2.0 * sensitivity_to_compass(c, GYRO_BIAS + i)) ** 2
        if keep_gyro_biases and moved < prior:
            decorrelate(c, GYRO_BIAS + i, max(moved, p.tuning.kept_gyro_bias_sigma**2))
        else:
            clear_gyro_bias(c, i)
            decorrelate(c, GYRO_BIAS + i, prior)
        decorrelate(c, ACCEL_BIAS + i, p.accel_bias_sigma**2)
    reset_gyro_scale(p, c)
    reset_process_noise(p, c)


@kernel
def transfer_lever_arm(c: Core, sign: float) -> None:
    """Move position and velocity from the antenna at the epoch of the fixes to the IMU now (sign 1), or back (-1).

    During coarse alignment they are the antenna's and the time offset is no error of it, because all of it comes
    from fixes. A position given by the user, before any fix, is that of the IMU.
    """
    if c.gnss.last_used_ns == NEVER_NS:
        return
    arm, antenna, time_offset_var = antenna_position(c), antenna_velocity(c), variance(c, TIME_OFFSET)
    displace(c, -sign * arm[0], -sign * arm[1], -sign * arm[2])
    for i in range(3):
        of_imu = c.nav.v_n[i] - (antenna[i] if sign > 0.0 else 0.0)
        set_velocity(c, i, c.nav.v_n[i] - sign * antenna[i])
        row = attitude_row(arm, i)
        combine3(c, POSITION + i, ATTITUDE, -sign * row[0], -sign * row[1], -sign * row[2])
        row = attitude_row(antenna, i)
        combine3(c, VELOCITY + i, ATTITUDE, -sign * row[0], -sign * row[1], -sign * row[2])
        row = gyro_bias_row(c, c.nav.gnss_lever_arm, i)
        combine3(c, VELOCITY + i, GYRO_BIAS, -sign * row[0], -sign * row[1], -sign * row[2])
        row = arm_position_row(c, i)
        combine3(c, POSITION + i, GNSS_LEVER_ARM, -sign * row[0], -sign * row[1], -sign * row[2])
        row = arm_velocity_row(c, i)
        combine3(c, VELOCITY + i, GNSS_LEVER_ARM, -sign * row[0], -sign * row[1], -sign * row[2])
        combine(c, POSITION + i, TIME_OFFSET, sign * of_imu)
        add_variance(c, VELOCITY + i, time_offset_var * c.imu.accel_n[i] ** 2)
