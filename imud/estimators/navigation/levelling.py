"""Roll and pitch from the specific force, while the heading is unknown: at rest it is gravity, in motion nearly so.

Both are one measurement of the mean specific force over a window, with the sigma of rest or that of a vehicle's
accelerations; the gyro, whose bias is estimated at the same time, carries the attitude between.
"""

from typing import Any

from ...kernels.earth import gravity
from ...kernels.jit import kernel
from ...kernels.rotation import dcm_of_quat
from .correction import correct, row, take
from .state import ACCEL_BIAS, ATTITUDE

REST_FORCE = 0.02  # m/s^2
MOTION_FORCE = 1.5  # m/s^2, accelerations last for several windows


@kernel
def level(c: Any, resting: bool) -> None:
    """Fuse the mean specific force of a window (call at its end, before it is cleared)."""
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    fx, fy, fz = c.sum_n[0] / c.n, c.sum_n[1] / c.n, c.sum_n[2] / c.n
    sigma = REST_FORCE if resting else MOTION_FORCE
    for i in range(3):
        # C f + phi x C f - C ba = (0, 0, -g); heading error has no part in it
        k = row(c, 0, ACCEL_BIAS, -m[3 * i])
        k = row(c, k, ACCEL_BIAS + 1, -m[3 * i + 1])
        k = row(c, k, ACCEL_BIAS + 2, -m[3 * i + 2])
        if i == 0:
            k = row(c, k, ATTITUDE + 1, fz)
            z = -fx
        elif i == 1:
            k = row(c, k, ATTITUDE, -fz)
            z = -fy
        else:
            k = row(c, k, ATTITUDE, fy)
            k = row(c, k, ATTITUDE + 1, -fx)
            z = -gravity(c.lat, c.height) - fz
        take(c, k, z, sigma * sigma, 0.0)
    correct(c)
