"""Flights of multicopters: thrust along one axis of the body, and drag across it in proportion to the airspeed."""

import numpy as np
from attitude_simulation import G, Truth
from scipy.spatial.transform import Rotation

RATE_HZ = 100.0


def thrust_borne(v, drag, wind, yaw, mount=(0.0, 0.0, 0.0)):
    """A Truth of velocities v (n, 3), m/s, NED, at RATE_HZ.

    drag: 1/s, over the mass. wind: m/s, NED. yaw: rad (n,). mount: rotation vector of the sensor in the body.
    """
    t = np.arange(len(v)) / RATE_HZ
    force = np.gradient(v, t, axis=0) - [0.0, 0.0, G]
    thrust = force
    for _ in range(4):  # drag is across the thrust
        along = thrust / np.linalg.norm(thrust, axis=1)[:, None]
        air = v - wind
        thrust = force + drag * (air - along * np.sum(air * along, axis=1)[:, None])
    down = -thrust / np.linalg.norm(thrust, axis=1)[:, None]
    right = np.cross(down, np.column_stack([np.cos(yaw), np.sin(yaw), 0.0 * t]))
    right /= np.linalg.norm(right, axis=1)[:, None]
    body = Rotation.from_matrix(np.stack([np.cross(right, down), right, down], axis=2))
    attitude = body * Rotation.from_rotvec(mount).inv()
    steps = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    w = np.vstack([np.zeros(3), steps * RATE_HZ])
    middle = attitude * Rotation.from_rotvec(-0.5 * w / RATE_HZ)
    return Truth(t, attitude, w, middle.inv().apply(np.vstack([force[:1], 0.5 * (force[1:] + force[:-1])])))


def smooth_step(x):
    """From 0 at x = 0 to 1 at x = 1, with two derivatives that do not jump."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def flight(wobble, seed, drag, seconds=120.0, leaves_s=10.0, speed=6.0, turns=0.3):
    """A Truth: it hovers from 8 s on and then flies to and fro, in a wind that has gusts, and yaws.

    wobble: as `attitude_simulation.wobble`.
    """
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    aloft, leaves = (smooth_step((t - begin) / 3.0)[:, None] for begin in (8.0, leaves_s))
    v = 0.1 * aloft * wobble(seed, 1.0, 0.3, 1.5)(t) + leaves * wobble(seed + 1, speed, 0.03, 0.4)(t)
    v[:, 2] *= 0.2
    wind = aloft * (np.array([3.0, -1.0, 0.0]) + wobble(seed + 2, 0.5, 0.2, 3.0)(t))
    yaw = np.cumsum(aloft[:, 0] * wobble(seed + 3, turns, 0.1, 0.5)(t)[:, 0]) / RATE_HZ
    return thrust_borne(v, drag, wind, yaw, (0.03, -0.02, 0.4))
