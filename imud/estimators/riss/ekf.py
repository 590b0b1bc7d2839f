"""Scalar updates of the reduced inertial estimator, and the process between its steps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.earth import displaced
from ...math.kalman import measure, packed_index, scale, shear, update
from ...math.rotation import UNKNOWN_ANGLE, wrap_angle
from .state import (
    ACCEL,
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    DOWN,
    EAST,
    FIX_NORTH,
    GYRO_BIAS,
    GYRO_SCALE,
    LEAN,
    NORTH,
    PITCH,
    RING,
    ROLL,
    SINK,
    SPEED,
    SQUAT,
    STATES,
    TIME_OFFSET,
    TRAVEL_DOWN,
    TRAVEL_EAST,
    TRAVEL_NORTH,
    TRAVEL_SPEED,
    TRAVEL_YAW,
    TRAVELS,
    UNKNOWN_SPEED,
    YAW,
)

if TYPE_CHECKING:
    from .types import RissParameters, RissState

MIN_COS_PITCH = 0.1
AROUND_NS = 100_000_000  # two steps


@kernel
def variance(s: RissState, i: int) -> float:
    """P[i, i]."""
    return float(s.P[packed_index(STATES, i, i)])


@kernel
def add_variance(s: RissState, i: int, more: float) -> None:
    """P[i, i] += more."""
    s.P[packed_index(STATES, i, i)] += more


@kernel
def roll_of(s: RissState) -> float:
    """Roll of the body, rad: that of the road, and a lean outwards in a curve."""
    return float(s.x[ROLL] - s.x[LEAN] * s.x[SPEED] * s.yaw_rate)


@kernel
def pitch_of(s: RissState) -> float:
    """Pitch of the body, rad: that of the road, and squat when the vehicle accelerates, dive when it brakes."""
    return float(s.x[PITCH] + s.x[SQUAT] * s.x[ACCEL])


@kernel
def set_jacobian(s: RissState, k: int, column: int, value: float) -> int:
    """Set element k of the Jacobian; returns k + 1."""
    s.columns[k], s.row[k] = column, value
    return k + 1


@kernel
def innovation_variance(s: RissState, n: int, r: float) -> float:
    """Innovation variance h P h' + r of the Jacobian of n elements; stores P h in s.d."""
    return measure(s.P, STATES, s.columns, s.row, n, s.d) + r


@kernel
def fuse(s: RissState, n: int, z: float, r: float) -> float:
    """Fuse innovation z of noise variance r by the Jacobian of n elements; returns the innovation variance.

    The error estimate is in s.dx until `inject_error`.
    """
    for i in range(n):
        z -= s.row[i] * s.dx[s.columns[i]]
    total = innovation_variance(s, n, r)
    update(s.P, STATES, s.dx, s.d, total, z)
    return total


@kernel
def inject_error(s: RissState) -> None:
    """Add the error estimate in s.dx to the nominal state and clear it."""
    s.lat, s.lon = displaced(s.lat, s.lon, s.height, s.dx[NORTH], s.dx[EAST])
    s.height -= s.dx[DOWN]
    for i in range(SPEED, STATES):
        s.x[i] += s.dx[i]
    for i in range(STATES):
        s.dx[i] = 0.0
    s.x[YAW], s.x[ROLL] = wrap_angle(s.x[YAW]), wrap_angle(s.x[ROLL])
    s.x[PITCH] = min(max(s.x[PITCH], -1.5), 1.5)


@kernel
def store_travel(s: RissState) -> None:
    """Store the present integrals in the ring, for fixes that arrive late."""
    s.ring_at = (s.ring_at + 1) % RING
    s.ring_ns[s.ring_at] = s.step_ns
    for i in range(TRAVELS):
        s.ring[s.ring_at, i] = s.travel[i]


@kernel
def travelled_since(s: RissState, t_ns: int, i: int) -> float:
    """Change of the integral travel[i] since t_ns, interpolated; at most since the oldest stored step."""
    at, after, after_ns = s.ring_at, s.travel[i], s.step_ns
    for _ in range(RING - 1):
        if s.ring_ns[at] > t_ns:
            after, after_ns = s.ring[at, i], s.ring_ns[at]
            at = (at + RING - 1) % RING
    share = (t_ns - s.ring_ns[at]) / max(after_ns - s.ring_ns[at], 1)
    before = s.ring[at, i]
    return float(s.travel[i] - before - min(max(share, 0.0), 1.0) * (after - before))


@kernel
def rate_around(s: RissState, t_ns: int, i: int) -> float:
    """Rate of the integral travel[i] around t_ns: its mean over 2 AROUND_NS, or what there is of them."""
    begin_ns, end_ns = t_ns - AROUND_NS, min(t_ns + AROUND_NS, s.step_ns)
    if end_ns - begin_ns < AROUND_NS:
        begin_ns = end_ns - AROUND_NS
    return (travelled_since(s, begin_ns, i) - travelled_since(s, end_ns, i)) / (1e-9 * (end_ns - begin_ns))


@kernel
def propagate(p: RissParameters, s: RissState, rate: float, outage_s: float, T: float) -> None:
    """Propagate state and P over T s with the measured mean yaw rate; outage_s: time without a rate so far."""
    x, P, tuning = s.x, s.P, p.tuning
    cos_pitch = max(elementary.cos(pitch_of(s)), MIN_COS_PITCH)
    c = elementary.cos(roll_of(s)) / cos_pitch
    s.yaw_rate = c * (rate * (1.0 - x[GYRO_SCALE]) - x[GYRO_BIAS])
    middle = x[YAW] + 0.5 * T * s.yaw_rate
    cy, sy = elementary.cos(middle), elementary.sin(middle)
    distance = T * (x[SPEED] + 0.5 * T * x[ACCEL])
    north, east = (distance * cy, distance * sy) if s.aligned == 1 else (T * s.v[0], T * s.v[1])
    s.lat, s.lon = displaced(s.lat, s.lon, s.height, north, east)
    s.height -= T * x[SINK]
    decay = elementary.exp(-T / tuning.accel_time_s)
    speed_change = T * x[ACCEL]
    s.travel[TRAVEL_NORTH] += north
    s.travel[TRAVEL_EAST] += east
    s.travel[TRAVEL_DOWN] += T * x[SINK]
    s.travel[TRAVEL_SPEED] += speed_change
    s.travel[TRAVEL_YAW] += T * s.yaw_rate
    if s.aligned == 1:
        shear(P, STATES, NORTH, SPEED, T * cy)
        shear(P, STATES, NORTH, YAW, -distance * sy)
        shear(P, STATES, EAST, SPEED, T * sy)
        shear(P, STATES, EAST, YAW, distance * cy)
    shear(P, STATES, DOWN, SINK, T)
    shear(P, STATES, SPEED, ACCEL, T)
    shear(P, STATES, YAW, GYRO_BIAS, -c * T)
    shear(P, STATES, YAW, GYRO_SCALE, -c * rate * T)
    scale(P, STATES, ACCEL, decay)
    x[SPEED] += speed_change
    x[ACCEL] *= decay
    x[YAW] = wrap_angle(x[YAW] + T * s.yaw_rate)
    add_process_noise(p, s, (cy, sy), c, cos_pitch, outage_s, T)
    limit_sigmas(s)


@kernel
def add_process_noise(
    p: RissParameters,
    s: RissState,
    course: tuple[float, float],
    yaw_gain: float,
    cos_pitch: float,
    outage_s: float,
    T: float,
) -> None:
    """Add the process noise of T s to P, and let the bias of the fixes decay.

    course: cosine and sine of the yaw; yaw_gain: yaw rate by rate of the z gyro; outage_s: as in `propagate`.
    """
    x, P, tuning = s.x, s.P, p.tuning
    cy, sy = course
    walk = tuning.tilt_walk**2 * T
    decay = elementary.exp(-T / tuning.accel_time_s)
    add_variance(s, ACCEL, (1.0 - decay * decay) * tuning.accel_sigma**2)
    add_variance(s, ROLL, walk)
    add_variance(s, PITCH, walk)
    # a pitch rate, which is not measured, turns a rolled vehicle about the vertical
    add_variance(s, YAW, yaw_gain * yaw_gain * p.gyro_psd * T + elementary.sin(roll_of(s)) ** 2 / cos_pitch**2 * walk)
    if outage_s > 0.0:
        add_variance(s, YAW, tuning.fault_rate**2 * (outage_s**2 - max(outage_s - T, 0.0) ** 2))
    add_variance(s, SINK, tuning.sink_walk**2 * T)
    add_variance(s, ACCEL_BIAS_X, p.accel_bias_psd * T)
    add_variance(s, ACCEL_BIAS_Y, p.accel_bias_psd * T)
    add_variance(s, GYRO_BIAS, p.gyro_bias_psd * T)
    add_variance(s, TIME_OFFSET, tuning.time_offset_walk**2 * T)
    lateral_var = tuning.lateral_sigma**2 * T
    if s.aligned == 1:
        add_variance(s, NORTH, lateral_var * (T + sy * sy))
        add_variance(s, EAST, lateral_var * (T + cy * cy))
    else:
        lost = tuning.accel_sigma**2 * T
        add_variance(s, NORTH, lost)
        add_variance(s, EAST, lost)
    kept = elementary.exp(-T / tuning.fix_time_s)
    for i in range(3):
        scale(P, STATES, FIX_NORTH + i, kept)
        x[FIX_NORTH + i] *= kept
        add_variance(s, FIX_NORTH + i, (1.0 - kept * kept) * s.fix_var[i])


@kernel
def limit_sigmas(s: RissState) -> None:
    """Keep the sigmas of speed and angles within what these can be, where nothing measures them."""
    limit_sigma(s, SPEED, UNKNOWN_SPEED)
    limit_sigma(s, YAW, UNKNOWN_ANGLE)
    limit_sigma(s, ROLL, UNKNOWN_ANGLE)
    limit_sigma(s, PITCH, UNKNOWN_ANGLE)


@kernel
def limit_sigma(s: RissState, i: int, most: float) -> None:
    """Limit the sigma of state i to `most`."""
    excess = variance(s, i) / (most * most)
    if excess > 1.0:
        scale(s.P, STATES, i, 1.0 / math.sqrt(excess))
