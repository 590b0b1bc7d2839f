"""FIX, a class of our own that a client must ask for: the receiver's last fix that was used, before any filter.

Names and units are those of `imud export`'s gnss.csv, but `uSat`: libgps expects a list of `satellites`. `time` is the
receiver's own.
"""

import math

import numpy as np

from ..estimators.records import FIX
from .gpsd_objects import Numbers, head, iso
from .view import View

_FIX = Numbers(
    lat_deg="%.12g", lon_deg="%.12g", height_m="%.9g", sn_m="%.4g", se_m="%.4g", sd_m="%.4g", hdop="%.4g",
    vn_mps="%.7g", ve_mps="%.7g", vd_mps="%.7g", speed_mps="%.7g", course_deg="%.7g",
    svn_mps="%.4g", sve_mps="%.4g", svd_mps="%.4g",
)  # fmt: skip


def fix_object(view: View) -> str:
    """One fix differs from the next by its `t_mono_ns`. Without a fix there is nothing but the class and the device."""
    if view.gnss is None or not view.gnss.fix:
        return f"{head('FIX', view)}}}"
    fix, reported = np.frombuffer(view.gnss.fix, FIX)[0], view.gnss.reported
    utc_ns = reported.utc_ns(round(view.utc_s * 1e9)) if reported and view.utc_s and iso(view.utc_s) else None
    text = iso(None if utc_ns is None else utc_ns * 1e-9)
    time = f',"time":{text}' if text else ""
    numbers = _FIX(
        math.degrees(fix["lat"]), math.degrees(fix["lon"]), fix["height"], *fix["sigma"], fix["hdop"],
        *fix["v"], fix["speed"], math.degrees(fix["course"]), *fix["sigma_v"],
    )  # fmt: skip
    return (
        f'{head("FIX", view)}{time},"t_mono_ns":{fix["t_ns"]},"arrival_mono_ns":{fix["arrival_ns"]}'
        f',"quality":{fix["quality"]},"uSat":{fix["satellites"]}{numbers}}}'
    )
