"""The navigation filter: position, velocity, attitude and sensor biases from an inertial sensor and a GNSS receiver.

One idea per file: `strapdown` integrates, `covariance` lets the errors grow, `correction` takes scalar measurements,
`motion` looks for rest, `levelling`, `whitening`, `matching`, `fix_matching`, `posterior`, `alignment` and
`acquisition` start the filter, `supervision` doubts its heading, `gnss`, `zero_velocity` and `non_holonomic` with
`looseness` aid it, `creep` and `admission` decide on fixes that contradict, `stamps` on their epochs, `history` brings
late ones there, `filter` has the entries.
"""

from .. import Estimator
from .filter import step, take_innovations, update
from .parameters import TUNABLES, configure
from .setup import start

ESTIMATOR = Estimator(
    "navigation", configure, start, step, update, told=take_innovations, tunables=TUNABLES, survives_power_on=True
)
