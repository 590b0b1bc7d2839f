"""What the filter has found out of the sources beside GNSS: scale, offset, and why measurements are not used."""

import math

from ...compile.jit import interpreted
from ...math.arrays import Records
from ...math.kalman import packed_index
from ..records import (
    BAROMETER_SOURCE,
    BODY_VELOCITY_SOURCE,
    HEADING_SOURCE,
    MAGNETOMETER_SOURCE,
    ODOMETER_SOURCE,
    POSE_SOURCE,
    VELOCITY_SOURCE,
)
from .aiding.records import CONTRADICTED, NO_DIRECTION, OTHER_FIELD
from .filter_states import velocity_mounting
from .state import BARO_OFFSET, HEADING_BORESIGHT, NAVIGATING, NEVER_NS, ODOMETER_SCALE, STATES

REPEATED_NS = 10_000_000_000  # a barometer that says the same for longer has stopped

_FINDINGS = {
    HEADING_SOURCE: ("heading_aid", "distrusted", "the motion contradicts it"),
    POSE_SOURCE: ("pose", "rejected", "it contradicts the estimate, or repeats itself"),
    VELOCITY_SOURCE: ("external_velocity", "rejected", "it contradicts the estimate"),
    BODY_VELOCITY_SOURCE: ("body_velocity", "rejected", "it contradicts the estimate"),
}
_UNUSED = {
    CONTRADICTED: "it contradicts the estimate",
    NO_DIRECTION: "the vehicle does not move along the forward axis: is imu.mount_rpy_deg right?",
    OTHER_FIELD: "its field is not the earth's, or not steady",
}


def source_estimates(state: Records) -> dict[int, dict[str, float | str]]:
    """See `Estimator`. `finding`: why its measurements are not used now."""
    c = state["core"][0, 0]
    if c["alignment"]["mode"] != NAVIGATING:
        return {}

    def sigma(i: int) -> float:
        return math.sqrt(max(float(c["cov"]["P"][interpreted(packed_index)(STATES, i, i)]), 0.0))

    found: dict[int, dict[str, float | str]] = {
        ODOMETER_SOURCE: {"scale": round(1.0 + float(c["nav"]["odometer_scale"]), 5), "sscale": sigma(ODOMETER_SCALE)},
        BAROMETER_SOURCE: {"offset_m": float(c["nav"]["baro_offset"]), "soffset_m": sigma(BARO_OFFSET)},
    }
    heading = c["heading_aid"]
    if (variance := float(c["cov"]["boresight_covariance"][HEADING_BORESIGHT, HEADING_BORESIGHT])) > 0.0:
        found[HEADING_SOURCE] = {
            "boresight_deg": math.degrees(heading["boresight"]),
            "sboresight_deg": math.degrees(math.sqrt(variance)),
        }
    for name, angle, variance in velocity_mounting(c):
        key = name.removeprefix("velocity_") + "_deg"
        found.setdefault(BODY_VELOCITY_SOURCE, {}).update(
            {key: math.degrees(angle), f"s{key}": math.degrees(math.sqrt(max(variance, 0.0)))}
        )
    if heading["deviation_variance"] > 0.0:
        deviation_deg = math.degrees(math.sqrt(heading["deviation_variance"]))
        found.setdefault(HEADING_SOURCE, {})["deviation_deg"] = deviation_deg
    if heading["last_ns"] > heading["last_used_ns"]:
        found.setdefault(HEADING_SOURCE, {})["finding"] = _UNUSED[CONTRADICTED]
    for kind, (record, key, text) in _FINDINGS.items():
        if c[record][key]:
            found.setdefault(kind, {})["finding"] = text
    if c["magnetometer"]["unused"]:
        found[MAGNETOMETER_SOURCE] = {"finding": _UNUSED[int(c["magnetometer"]["unused"])]}
    barometer = c["barometer"]
    if barometer["changed_ns"] != NEVER_NS and c["nav"]["t_ns"] - barometer["changed_ns"] > REPEATED_NS:
        found[BAROMETER_SOURCE]["finding"] = "it repeats its last reading"
    odometer = c["odometer"]
    if odometer["frozen"]:
        found[ODOMETER_SOURCE]["finding"] = "it repeats its last reading while the speed changes"
    elif odometer["step"] > 0.0:
        found[ODOMETER_SOURCE]["finding"] = "the accelerometer contradicts it"
    elif odometer["unused"]:
        found[ODOMETER_SOURCE]["finding"] = _UNUSED[int(odometer["unused"])]
    return found
