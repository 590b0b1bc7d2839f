"""The checkpoint: the part of the state with which the filter continues after a restart of the program.

It is the core, without the hypothesis bank and the rings: to the filter the restart is a gap in the samples, and the
first sample after a gap begins the alignment's integrals and pairs anew. Of the ring of samples the last is restored.
"""

import numpy as np

from ...math.arrays import Records
from ..records import SOURCE_KINDS
from .aiding.records import SOURCE_AGE
from .core import SNAPSHOT
from .integrity.records import VELOCITY_LAG
from .state import IMU_RING

_TIMES = ("last_epoch_ns", "last_time_offset", "last_fusion_ns")
_KEPT = (*_TIMES, "source_ages", "velocity_lag")
CHECKPOINT = np.dtype(
    [
        ("core", SNAPSHOT),
        *zip(_TIMES, ("<i8", "<f8", "<i8"), strict=True),
        ("source_ages", SOURCE_AGE, (SOURCE_KINDS,)),
        ("velocity_lag", VELOCITY_LAG),
    ],
    align=True,
)


def checkpoint(state: Records) -> Records:
    """What `resume` needs (1 element)."""
    s, saved = state[0], np.zeros(1, CHECKPOINT)
    for name, size in (("core", SNAPSHOT.itemsize), ("source_ages", None)):  # as bytes, a fifth of the time
        saved[name].view(np.uint8)[:] = s[name].view(np.uint8)[:size]
    for name in (*_TIMES, "velocity_lag"):
        saved[name] = s[name]
    return saved


def resume(state: Records, saved: Records) -> None:
    """Continue from a checkpoint in a state before its first sample."""
    s, core = state[0], saved["core"][0]
    for name in SNAPSHOT.names or ():
        s["core"][name] = core[name]
    for name in _KEPT:
        s[name] = saved[name][0]
    s["sample_count"], s["aiding_start"] = core["imu"]["sample_count"], core["nav"]["fused_count"]
    last = s["imu_ring"][(s["sample_count"] - 1) % IMU_RING]
    last["t_ns"], last["w"], last["f"] = core["nav"]["t_ns"], core["imu"]["w"], core["imu"]["f"]
    s["last_w"], s["last_f"], s["initial_rpy"] = core["imu"]["w"], core["imu"]["f"], np.nan
