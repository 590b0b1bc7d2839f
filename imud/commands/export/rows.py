"""What stands in a row of `imu`, of `gnss` and of an aiding source, whatever the format of the table."""

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...math.arrays import Floats, Records

FIX_COLUMNS = (
    *("t_s", "lat_deg", "lon_deg", "height_m", "arrival_s", "sn_m", "se_m", "sd_m", "hdop"),
    *("vn_mps", "ve_mps", "vd_mps", "speed_mps", "course_deg", "quality", "satellites"),
    *("svn_mps", "sve_mps", "svd_mps"),
)


def fix_cells(fix: "Records") -> list[float]:
    """The cells of a FIX behind `t_s`, `arrival_s` in ns; NaN: not known."""
    row = fix[0]
    cells = [math.degrees(row["lat"]), math.degrees(row["lon"]), float(row["height"]), int(row["arrival_ns"])]
    cells += [*row["sigma"].tolist(), float(row["hdop"]), *row["v"].tolist(), float(row["speed"])]
    return [*cells, math.degrees(row["course"]), int(row["quality"]), int(row["satellites"]), *row["sigma_v"].tolist()]


def source_names() -> list[str]:
    """Of the aiding sources, whose tables an earlier export may have left."""
    from ...estimators import registry

    return [source.name for source in registry.by_name("navigation").sources]


def tilt_deg(down: "Floats") -> "Floats":
    """Roll and pitch, (n, 2), of the verticals (n, 3); NaN where the device gives none."""
    tilt: Floats = np.degrees(
        np.column_stack([np.arctan2(down[:, 1], down[:, 2]), np.arctan2(-down[:, 0], np.hypot(down[:, 1], down[:, 2]))])
    )
    tilt[~down.any(axis=1)] = np.nan
    return tilt
