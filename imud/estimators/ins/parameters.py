"""The parameters of the navigation filter: the sensor's noise, the user's settings, and every tunable.

The tunables are in the files that use them, with unit, meaning and source. Together they are the record `tuning`,
which kernels read as `p.tuning.NAME` and users set as `--set navigation.tuning.NAME=…`; `imud reference tuning` prints
them.
"""

import math

import numpy as np

from ...compile.jit import interpreted
from ...configuration.settings import Settings
from ...math.arrays import Records
from ...math.rotation import quat_of_euler
from ...sensor_errors.profiles import profile_of
from ..tuning import Tunable, dtype_of, values_of
from . import (
    bias_changes,
    boresights,
    damaged_readings,
    ekf,
    error_model,
    filter,
    imu_sample,
    noise_density,
    power_on,
    process_noise,
    propagation,
    rest,
    rest_gap,
    setup,
    solution,
    sources,
    stationarity,
    time_evidence,
    velocity_epoch,
)
from .aiding import (
    contradicted_bias,
    course_heading,
    forward_axis_search,
    gnss_gate,
    gnss_noise,
    gnss_position,
    gnss_reset,
    gnss_time,
    gnss_velocity,
    heading_contradiction,
    land_evidence,
    lever_arm_prior,
    nhc_noise,
    non_holonomic,
    position_divergence,
    wheel_check,
    zero_velocity,
)
from .alignment import (
    fix_age,
    fixed_gravity,
    heading_acceptance,
    heading_posterior,
    hypothesis_bank,
    in_motion,
    levelling,
    modes,
    vector_levelling,
    vector_pairs,
    velocity_pairs,
    whitening,
)
from .glr_tests import (
    compass_offset,
    gnss_drift,
    gyro_bias_step,
    imu_bias_step,
    lever_arm_error,
    time_offset_step,
    velocity_drift,
)
from .integrity import (
    alternating_receiver,
    frozen_receiver,
    gravity_monitor,
    heading_monitor,
    position_jump,
    velocity_discrepancy,
    velocity_lag,
)
from .state import AUTO, FREE, LAND

VEHICLES = {"free": FREE, "auto": AUTO, "land": LAND}
TUNABLES = (
    Tunable(
        "bias_walk_time_s",
        100.0,
        "s",
        "Time in which a bias walks by its instability.",
        "Allan variance: K^2 tau / 3 = B^2 where it is flat, at 300 s.",
    ),
    Tunable(
        "limit_sigmas",
        3.0,
        "sigma",
        "Sigmas by which an estimate must be beyond a limit before it counts as beyond it.",
        "Three sigma.",
    ),
    *error_model.TUNABLES,
    *boresights.TUNABLES,
    *noise_density.TUNABLES,
    *bias_changes.TUNABLES,
    *ekf.TUNABLES,
    *propagation.TUNABLES,
    *damaged_readings.TUNABLES,
    *imu_sample.TUNABLES,
    *power_on.TUNABLES,
    *rest_gap.TUNABLES,
    *stationarity.TUNABLES,
    *rest.TUNABLES,
    *time_evidence.TUNABLES,
    *gnss_noise.TUNABLES,
    *lever_arm_prior.TUNABLES,
    *gnss_position.TUNABLES,
    *gnss_velocity.TUNABLES,
    *gnss_gate.TUNABLES,
    *heading_contradiction.TUNABLES,
    *position_divergence.TUNABLES,
    *gnss_reset.TUNABLES,
    *gnss_time.TUNABLES,
    *wheel_check.TUNABLES,
    *zero_velocity.TUNABLES,
    *contradicted_bias.TUNABLES,
    *non_holonomic.TUNABLES,
    *course_heading.TUNABLES,
    *forward_axis_search.TUNABLES,
    *land_evidence.TUNABLES,
    *nhc_noise.TUNABLES,
    *in_motion.TUNABLES,
    *heading_acceptance.TUNABLES,
    *modes.TUNABLES,
    *fixed_gravity.TUNABLES,
    *levelling.TUNABLES,
    *vector_pairs.TUNABLES,
    *vector_levelling.TUNABLES,
    *fix_age.TUNABLES,
    *velocity_pairs.TUNABLES,
    *whitening.TUNABLES,
    *hypothesis_bank.TUNABLES,
    *heading_posterior.TUNABLES,
    *heading_monitor.TUNABLES,
    *gravity_monitor.TUNABLES,
    *alternating_receiver.TUNABLES,
    *position_jump.TUNABLES,
    *frozen_receiver.TUNABLES,
    *gnss_drift.TUNABLES,
    *velocity_drift.TUNABLES,
    *velocity_discrepancy.TUNABLES,
    *velocity_lag.TUNABLES,
    *compass_offset.TUNABLES,
    *time_offset_step.TUNABLES,
    *gyro_bias_step.TUNABLES,
    *imu_bias_step.TUNABLES,
    *lever_arm_error.TUNABLES,
    *process_noise.TUNABLES,
    *velocity_epoch.TUNABLES,
    *filter.TUNABLES,
    *sources.TUNABLES,
    *setup.TUNABLES,
    *solution.TUNABLES,
)

PARAMETERS = np.dtype(
    [
        ("period", "<f8"),  # s, nominal time between samples
        ("gnss_lever_arm", "<f8", (3,)),  # m, antenna from IMU, body
        ("lever_arm_is_set", "<i8"),  # 1: by the user
        ("lever_arm_sigma", "<f8"),  # m, of each of its components; 0: they are not estimated; -1: not set
        ("heading_boresight", "<f8"),  # rad, heading of the compass less that of the body
        ("heading_boresight_sigma", "<f8"),  # rad; 0: not given
        ("odometer_lever_arm", "<f8", (3,)),  # m, wheel from IMU, body
        ("track_width", "<f8"),  # m, between the two wheels; 0: not known
        ("pose_lever_arm", "<f8", (3,)),  # m, point of external poses from IMU, body
        ("velocity_lever_arm", "<f8", (3,)),  # m, point of external velocities from IMU, body
        ("velocity_mount", "<f8", (4,)),  # from the axes of the velocity sensor to the body's
        ("magnetometer", "<i8"),  # 1: its readings are used
        ("vehicle", "<i8"),
        ("assumed_latency", "<f8"),  # s, from epoch to arrival where the epoch is only assumed
        ("gyro_psd", "<f8"),  # rad^2/s
        ("gyro_bias_psd", "<f8"),  # rad^2/s^3
        ("gyro_bias_sigma", "<f8"),  # rad/s, at switch-on
        ("gyro_bias_wide", "<f8"),  # rad/s, the same of the worst parts of the kind: after evidence of such a part
        ("gyro_scale", "<f8"),
        ("gyro_misalignment", "<f8"),  # rad
        ("accel_psd", "<f8"),  # m^2/s^3
        ("accel_bias_psd", "<f8"),  # m^2/s^5
        ("accel_bias_sigma", "<f8"),  # m/s^2, at switch-on
        ("accel_scale", "<f8"),
        ("tuning", dtype_of(TUNABLES)),
    ],
    align=True,
)


def configure(settings: Settings, rate_hz: float) -> Records:
    """Parameters (1 element) for a sensor of `rate_hz`; profile "auto" is consumer-mems."""
    profile = profile_of(settings)
    p = np.zeros(1, PARAMETERS)
    r = p[0]
    p["tuning"] = values_of(TUNABLES, settings.navigation.tuning)
    r["period"] = 1.0 / rate_hz
    r["gnss_lever_arm"] = settings.navigation.lever_arm
    sigma = settings.navigation.lever_arm_sigma_m
    r["lever_arm_is_set"] = settings.navigation.lever_arm_m != "auto"
    r["lever_arm_sigma"] = -1.0 if sigma == "auto" else sigma
    r["heading_boresight"] = math.radians(settings.aiding.heading_boresight_deg)
    boresight_sigma = settings.aiding.heading_boresight_sigma_deg
    r["heading_boresight_sigma"] = 0.0 if boresight_sigma == "auto" else math.radians(boresight_sigma)
    r["odometer_lever_arm"] = settings.aiding.odometer_lever_arm_m
    r["track_width"] = settings.aiding.track_width_m
    r["pose_lever_arm"] = settings.aiding.pose_lever_arm_m
    r["velocity_lever_arm"] = settings.aiding.velocity_lever_arm_m
    mount = [math.radians(angle) for angle in settings.aiding.velocity_mount_rpy_deg]
    r["velocity_mount"] = interpreted(quat_of_euler)(*mount)
    r["magnetometer"] = settings.aiding.magnetometer
    r["vehicle"] = VEHICLES[settings.navigation.vehicle]
    r["assumed_latency"] = settings.gnss.latency_s
    r["gyro_psd"] = profile.gyro_noise**2
    r["gyro_bias_psd"] = profile.gyro_bias_instability**2 / r["tuning"]["bias_walk_time_s"]
    r["gyro_bias_sigma"] = profile.gyro_bias_initial
    r["gyro_bias_wide"] = profile.gyro_bias_wide
    r["gyro_scale"] = profile.gyro_scale
    r["gyro_misalignment"] = profile.gyro_misalignment
    r["accel_psd"] = profile.accel_noise**2
    r["accel_bias_psd"] = profile.accel_bias_instability**2 / r["tuning"]["bias_walk_time_s"]
    r["accel_bias_sigma"] = profile.accel_bias_initial
    r["accel_scale"] = profile.accel_scale
    return p
