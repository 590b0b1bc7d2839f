"""The names of the kinds of innovation: in `imud status`, in tables, and in recordings."""

from typing import NamedTuple

from .records import (
    HEADING,
    NHC_LATERAL,
    NHC_VERTICAL,
    POSITION_D,
    POSITION_E,
    POSITION_N,
    REST_D,
    REST_E,
    REST_N,
    REST_X,
    REST_Y,
    REST_Z,
    VELOCITY_D,
    VELOCITY_E,
    VELOCITY_N,
)


class Kind(NamedTuple):
    """Names of one kind."""

    key: str  # without a unit, for a pure ratio
    column: str  # with its unit
    words: str


KINDS = {
    POSITION_N: Kind("north", "pn_m", "position north, m"),
    POSITION_E: Kind("east", "pe_m", "position east, m"),
    POSITION_D: Kind("down", "pd_m", "position down, m"),
    VELOCITY_N: Kind("v_north", "vn_mps", "velocity north, m/s"),
    VELOCITY_E: Kind("v_east", "ve_mps", "velocity east, m/s"),
    VELOCITY_D: Kind("v_down", "vd_mps", "velocity down, m/s"),
    HEADING: Kind("heading", "yaw_rad", "heading, rad"),
    REST_N: Kind("rest_north", "rest_vn_mps", "no velocity north at rest, m/s"),
    REST_E: Kind("rest_east", "rest_ve_mps", "no velocity east at rest, m/s"),
    REST_D: Kind("rest_down", "rest_vd_mps", "no velocity down at rest, m/s"),
    REST_X: Kind("rest_x", "rest_wx_radps", "no rate about x at rest, rad/s"),
    REST_Y: Kind("rest_y", "rest_wy_radps", "no rate about y at rest, rad/s"),
    REST_Z: Kind("rest_z", "rest_wz_radps", "no rate about z at rest, rad/s"),
    NHC_LATERAL: Kind("slip", "slip_mps", "no velocity across the vehicle, m/s"),
    NHC_VERTICAL: Kind("hop", "hop_mps", "no velocity off its floor, m/s"),
}
