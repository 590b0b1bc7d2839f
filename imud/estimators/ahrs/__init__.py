"""Attitude without GNSS or magnetometer (AHRS): an error-state Kalman filter on gyro and accelerometer alone.

Every sample is integrated; the covariance follows at about 20 Hz whatever the sample rate. The accelerometer is not
averaged: its integral, a velocity, is held to be about zero, which tells gravity from acceleration. Roll and pitch are
absolute. Yaw counts from the start, or from the heading that the user gives; nothing corrects it and its sigma grows.

docs/ahrs.md derives it.

Source: Solà, Quaternion kinematics for the error-state Kalman filter (2017), sec. 7 (global angular error).
"""

from .. import Estimator
from .filter import step
from .filter_states import attitude, filter_states
from .parameters import TUNABLES
from .setup import backward_tuning, checkpoint, configure, restore_biases, resume, start

__all__ = ["ESTIMATOR"]

ESTIMATOR = Estimator(
    "attitude",
    configure,
    start,
    step,
    None,
    survives_power_on=True,
    restore_biases=restore_biases,
    checkpoint=checkpoint,
    resume=resume,
    backward_tuning=backward_tuning,
    rates_of_interval=True,
    tunables=TUNABLES,
    filter_states=filter_states,
    attitude=attitude,
)
