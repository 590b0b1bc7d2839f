"""Prasanna's GPS filter: the position and velocity of a track, north and east, at constant velocity between fixes.

Source: Prasanna, Vehicle Localisation Using GPS and IMU (2009), "GPS Kalman Filter": X = [x, vx, y, vy], positions are
measured, Q = 0.2, R = 0.5. Inertial samples only ask for the time at which the solution is wanted.

What is built instead of the print:
- the gain W = P H' (H P H' + R) lacks the inverse: W = P H' (H P H' + R)^-1;
- P(k) = (I - W H) P(k-1): it is the predicted P that is updated, here as a packed triangle that stays symmetric;
- x = (long2 - long1) R_earth: angles in radians, times cos(latitude), on the ellipsoid's two radii. The state keeps
  latitude and longitude themselves, so that the track may be as long as it likes;
- G = columns of ones: discrete white-noise acceleration, [dt^2 / 2, dt] per axis, of variance Q.
P(0) is not printed: the first fix is the first position with the variance R; speed has INITIAL_SPEED_SIGMA.
Q in (m/s^2)^2 and R in m^2 are `gps_track` in the settings; a receiver that reports its sigma is believed instead of R.
Height, attitude and biases are not in his state and stay unknown.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary

from ...compile.jit import kernel
from ...configuration.settings import Initial, Settings
from ...math.arrays import Records
from ...math.earth import MIN_COS, displaced, radii
from ...math.kalman import measure, shear, update
from ...math.rotation import wrap_angle
from .. import Estimator
from ..blank_solution import blank
from ..records import COASTING, POSITION_E, POSITION_N, POSITION_VALID

if TYPE_CHECKING:
    from ...math.arrays import Floats
    from ..types import Fix, Innovation, Sample, Solution
    from .types import TrackParameters, TrackState

NORTH, VELOCITY_N, EAST, VELOCITY_E, STATES = 0, 1, 2, 3, 4
PACKED = STATES * (STATES + 1) // 2
INITIAL_SPEED_SIGMA = 30.0  # m/s, 1 sigma at the first fix
COASTING_S = 2.5

PARAMETERS = np.dtype([("acceleration_var", "<f8"), ("position_var", "<f8")], align=True)

STATE = np.dtype(
    [
        ("fixes", "<i8"),
        ("fix_ns", "<i8"),  # time of lat, lon, v and P
        ("lat", "<f8"),
        ("lon", "<f8"),
        ("v", "<f8", (2,)),  # m/s, north and east
        ("P", "<f8", (PACKED,)),
        ("predicted_P", "<f8", (PACKED,)),  # P at the newest sample
        ("x", "<f8", (STATES,)),
        ("d", "<f8", (STATES,)),
        ("column", "<i8", (1,)),
        ("one", "<f8", (1,)),
    ],
    align=True,
)


def configure(settings: Settings, rate_hz: float) -> Records:
    """Parameters (PARAMETERS): Q and R."""
    p = np.zeros(1, PARAMETERS)
    p["acceleration_var"] = settings.gps_track.acceleration_var
    p["position_var"] = settings.gps_track.position_var
    return p


def start(parameters: Records, initial: Initial) -> Records:
    """A state (STATE) that waits for its first fix. A position given by the user has no use here."""
    s = np.zeros(1, STATE)
    s["one"] = 1.0
    return s


@kernel
def predict(P: Floats, T: float, acceleration_var: float) -> None:
    """P <- F P F' + G Q G' over T s."""
    for i in (NORTH, EAST):
        shear(P, STATES, i, i + 1, T)
    pp, pv, vv = 0.25 * T**4 * acceleration_var, 0.5 * T**3 * acceleration_var, T * T * acceleration_var
    P[0] += pp
    P[1] += pv
    P[4] += vv
    P[7] += pp
    P[8] += pv
    P[9] += vv


@kernel
def ned_difference(s: TrackState, fix: Fix) -> tuple[float, float]:
    """The distance north and east, m, from the estimate to the fix."""
    meridian, prime_vertical = radii(s.lat)
    return (fix.lat - s.lat) * meridian, wrap_angle(fix.lon - s.lon) * prime_vertical * max(
        elementary.cos(s.lat), MIN_COS
    )


@kernel
def fix_variance(p: TrackParameters, fix: Fix, axis: int) -> float:
    """R of one axis, m^2."""
    return float(fix.sigma[axis] ** 2 if fix.sigma[axis] > 0.0 else p.position_var)


@kernel
def initialise(p: TrackParameters, s: TrackState, fix: Fix) -> None:
    """The first fix is the first position; the velocity is unknown."""
    s.lat, s.lon = fix.lat, fix.lon
    s.v[0] = s.v[1] = 0.0
    for i in range(PACKED):
        s.P[i] = 0.0
    s.P[0], s.P[7] = fix_variance(p, fix, 0), fix_variance(p, fix, 1)
    s.P[4] = s.P[9] = INITIAL_SPEED_SIGMA**2


@kernel
def fuse_fix(p: TrackParameters, s: TrackState, fix: Fix, innovations: list[Innovation]) -> int:
    """Fuse the fix at its epoch; returns the rows of `innovations` written."""
    T = (fix.t_ns - s.fix_ns) * 1e-9
    s.lat, s.lon = displaced(s.lat, s.lon, 0.0, T * s.v[0], T * s.v[1])
    predict(s.P, T, p.acceleration_var)
    z = ned_difference(s, fix)
    for i in range(STATES):
        s.x[i] = 0.0
    for axis in range(2):
        s.column[0] = 2 * axis
        variance = measure(s.P, STATES, s.column, s.one, 1, s.d) + fix_variance(p, fix, axis)
        innovation = z[axis] - s.x[2 * axis]
        update(s.P, STATES, s.x, s.d, variance, innovation)
        row = innovations[axis]
        row.t_ns, row.value, row.variance, row.used = fix.t_ns, innovation, variance, 1
        row.kind = POSITION_N if axis == 0 else POSITION_E
    s.lat, s.lon = displaced(s.lat, s.lon, 0.0, s.x[NORTH], s.x[EAST])
    s.v[0] += s.x[VELOCITY_N]
    s.v[1] += s.x[VELOCITY_E]
    return 2


@kernel
def update_track(p: TrackParameters, s: TrackState, fix: Fix, innovations: list[Innovation]) -> int:
    """One fix in. Fixes without a position, dead reckoned ones and those older than the last are not used."""
    usable = math.isfinite(fix.lat + fix.lon) and fix.quality != 0 and fix.quality != 6
    if not usable or (s.fixes > 0 and fix.t_ns <= s.fix_ns):
        return 0
    rows = 0
    if s.fixes == 0:
        initialise(p, s, fix)
    else:
        rows = fuse_fix(p, s, fix, innovations)
    s.fixes += 1
    s.fix_ns = fix.t_ns
    return rows


@kernel
def step(p: TrackParameters, s: TrackState, sample: Sample, solution: Solution) -> None:
    """Write a row of SOLUTION for the time of the sample: the last fix's state, extrapolated."""
    blank(solution, sample.t_ns, sample)
    if s.fixes == 0:
        return
    T = max((sample.t_ns - s.fix_ns) * 1e-9, 0.0)
    for i in range(PACKED):
        s.predicted_P[i] = s.P[i]
    predict(s.predicted_P, T, p.acceleration_var)
    solution.status |= POSITION_VALID | (COASTING if T > COASTING_S else 0)
    solution.lat, solution.lon = displaced(s.lat, s.lon, 0.0, T * s.v[0], T * s.v[1])
    for axis in range(2):
        solution.v[axis] = s.v[axis]
        solution.sigma_p[axis] = math.sqrt(s.predicted_P[0 if axis == 0 else 7])
        solution.sigma_v[axis] = math.sqrt(s.predicted_P[4 if axis == 0 else 9])


ESTIMATOR = Estimator("gps-track", configure, start, step, update_track, needs_gyros=False)
