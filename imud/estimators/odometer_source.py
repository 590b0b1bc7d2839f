"""Speed of a wheel, an odometer or a log, along the forward axis of the vehicle, signed or not: how it is written.

left_mps, right_mps: of the two wheels of an axle; or their mean as the speed, and difference_mps, left less right.
current_mps: the water's own speed, 1 sigma, if it is a speed through the water.
"""

from .aiding_source import AidingSource, Column
from .innovation_kinds import KINDS
from .records import ODOMETER, ODOMETER_SOURCE, WHEEL_YAW_RATE


def _axle(left: float, right: float) -> dict[str, float]:
    """The columns of an axle with two wheels."""
    return {"speed_mps": 0.5 * (left + right), "difference_mps": left - right}


SOURCE = AidingSource(
    "odometer",
    ODOMETER_SOURCE,
    "ODO",
    {"speed_mps": Column(1.0, -200.0, 200.0), "difference_mps": Column(1.0, -100.0, 100.0)},
    {"sigma_mps": Column(1.0, 1e-3, 10.0), "current_mps": Column(1.0, 0.0, 10.0)},
    {kind: KINDS[kind] for kind in (ODOMETER, WHEEL_YAW_RATE)},
    reversed_sign=-1.0,
    optional=("difference_mps",),
    parts=("left_mps", "right_mps"),
    combine=_axle,
)
