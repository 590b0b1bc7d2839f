"""The names of the kinds of innovation: in `imud status`, in tables, and in recordings."""

from typing import NamedTuple

from .records import (
    BAROMETER,
    EXTERNAL_VD,
    EXTERNAL_VE,
    EXTERNAL_VN,
    EXTERNAL_VX,
    EXTERNAL_VY,
    EXTERNAL_VZ,
    HEADING,
    MAGNETOMETER,
    NHC_LATERAL,
    NHC_VERTICAL,
    ODOMETER,
    POSE_D,
    POSE_E,
    POSE_N,
    POSE_YAW,
    POSITION_D,
    POSITION_E,
    POSITION_N,
    REST_D,
    REST_E,
    REST_N,
    REST_POSITION_X,
    REST_POSITION_Y,
    REST_POSITION_Z,
    REST_X,
    REST_Y,
    REST_Z,
    VELOCITY_D,
    VELOCITY_E,
    VELOCITY_N,
    WHEEL_YAW_RATE,
)


class InnovationKind(NamedTuple):
    """Names of one kind."""

    key: str  # without a unit, for a pure ratio
    column: str  # with its unit
    words: str


KINDS = {
    POSITION_N: InnovationKind("north", "pn_m", "position north, m"),
    POSITION_E: InnovationKind("east", "pe_m", "position east, m"),
    POSITION_D: InnovationKind("down", "pd_m", "position down, m"),
    VELOCITY_N: InnovationKind("v_north", "vn_mps", "velocity north, m/s"),
    VELOCITY_E: InnovationKind("v_east", "ve_mps", "velocity east, m/s"),
    VELOCITY_D: InnovationKind("v_down", "vd_mps", "velocity down, m/s"),
    HEADING: InnovationKind("heading", "yaw_rad", "heading, rad"),
    REST_N: InnovationKind("rest_north", "rest_vn_mps", "no velocity north at rest, m/s"),
    REST_E: InnovationKind("rest_east", "rest_ve_mps", "no velocity east at rest, m/s"),
    REST_D: InnovationKind("rest_down", "rest_vd_mps", "no velocity down at rest, m/s"),
    REST_X: InnovationKind("rest_x", "rest_wx_radps", "no rate about x at rest, rad/s"),
    REST_Y: InnovationKind("rest_y", "rest_wy_radps", "no rate about y at rest, rad/s"),
    REST_Z: InnovationKind("rest_z", "rest_wz_radps", "no rate about z at rest, rad/s"),
    NHC_LATERAL: InnovationKind("nhc_lateral", "nhc_lateral_mps", "no lateral velocity of the vehicle, m/s"),
    NHC_VERTICAL: InnovationKind("nhc_vertical", "nhc_vertical_mps", "no vertical velocity of the vehicle, m/s"),
    ODOMETER: InnovationKind("odometer", "odometer_mps", "speed by the wheels, m/s"),
    BAROMETER: InnovationKind("barometer", "barometer_m", "height by air pressure, m"),
    REST_POSITION_X: InnovationKind("rest_position_x", "rest_px_m", "no motion along x at rest, m"),
    REST_POSITION_Y: InnovationKind("rest_position_y", "rest_py_m", "no motion along y at rest, m"),
    REST_POSITION_Z: InnovationKind("rest_position_z", "rest_pz_m", "no motion along z at rest, m"),
    POSE_N: InnovationKind("pose_north", "pose_pn_m", "position north of an external pose, m"),
    POSE_E: InnovationKind("pose_east", "pose_pe_m", "position east of an external pose, m"),
    POSE_D: InnovationKind("pose_down", "pose_pd_m", "position down of an external pose, m"),
    POSE_YAW: InnovationKind("pose_yaw", "pose_yaw_rad", "yaw of an external pose, rad"),
    EXTERNAL_VN: InnovationKind("external_v_north", "external_vn_mps", "external velocity north, m/s"),
    EXTERNAL_VE: InnovationKind("external_v_east", "external_ve_mps", "external velocity east, m/s"),
    EXTERNAL_VD: InnovationKind("external_v_down", "external_vd_mps", "external velocity down, m/s"),
    EXTERNAL_VX: InnovationKind("external_v_x", "external_vx_mps", "external velocity along x, m/s"),
    EXTERNAL_VY: InnovationKind("external_v_y", "external_vy_mps", "external velocity along y, m/s"),
    EXTERNAL_VZ: InnovationKind("external_v_z", "external_vz_mps", "external velocity along z, m/s"),
    MAGNETOMETER: InnovationKind("magnetometer", "magnetometer_rad", "heading by the earth's magnetic field, rad"),
    WHEEL_YAW_RATE: InnovationKind("wheel_yaw_rate", "wheel_yaw_rate_radps", "yaw rate by two wheels, rad/s"),
}
