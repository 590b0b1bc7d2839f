"""Speed of a wheel, an odometer or a log, along the forward axis of the vehicle, signed or not: how it is written.

current_mps: the water's own speed, 1 sigma, if it is a speed through the water.
"""

from .aiding_source import AidingSource, Column
from .innovation_kinds import KINDS
from .records import ODOMETER, ODOMETER_SOURCE

SOURCE = AidingSource(
    "odometer",
    ODOMETER_SOURCE,
    "ODO",
    {"speed_mps": Column(1.0, -200.0, 200.0)},
    {"sigma_mps": Column(1.0, 1e-3, 10.0), "current_mps": Column(1.0, 0.0, 10.0)},
    {ODOMETER: KINDS[ODOMETER]},
    reversed_sign=-1.0,
)
