"""Rotations of arrays, by numpy; quaternions [n, 4] are those of `rotation`, which kernels use. Angles are in rad."""

import math

import numpy as np

from .arrays import Floats
from .rotation import GIMBAL_LOCK_SINE


def wrapped(angle: Floats) -> Floats:
    """To [-pi, pi)."""
    turned: Floats = np.mod(angle + math.pi, 2.0 * math.pi) - math.pi
    return turned


def matrices(q: Floats) -> Floats:
    """Direction cosine matrices [n, 3, 3], body to navigation frame."""
    w, x, y, z = np.moveaxis(q, 1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def roll_and_pitch(q: Floats) -> Floats:
    """[n, 2]; roll means nothing with the nose straight up or down."""
    w, x, y, z = q.T
    roll = np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    return np.column_stack([roll, np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))])


def of_euler(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """Quaternions of ZYX Euler angles."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(0.5 * angle), np.sin(0.5 * angle)) for angle in (roll, pitch, yaw))
    parts = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return np.stack(parts, axis=1)


def of_rotation_vectors(rotations: Floats) -> Floats:
    """Quaternions of rotation vectors [n, 3]."""
    angle = np.linalg.norm(rotations, axis=1)[:, None]
    return np.concatenate([np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi) * rotations], axis=1)


def about_down(angles: Floats) -> Floats:
    """Quaternions of turns about the vertical."""
    zero = np.zeros(len(angles))
    return np.stack([np.cos(0.5 * angles), zero, zero, np.sin(0.5 * angles)], axis=1)


def products(a: Floats, b: Floats) -> Floats:
    """Of two quaternions, or of each pair of two arrays of them."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    scalar = aw * bw - np.sum(av * bv, axis=-1, keepdims=True)
    product: Floats = np.concatenate([scalar, aw * bv + bw * av + np.cross(av, bv)], axis=-1)
    return product


def euler_sigmas(q: Floats, var: Floats) -> Floats:
    """Roots of `rotation.euler_variances` [n, 3]. var: covariances [n, 3, 3] of rotation errors in NED."""
    w, x, y, z = np.moveaxis(q, 1, 0)
    sine = np.clip(2.0 * (w * y - x * z), -1.0, 1.0)
    north, east = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    locked = np.abs(sine) > GIMBAL_LOCK_SINE
    north, east = np.where(locked, w * w - z * z, north), np.where(locked, 2.0 * w * z, east)
    level = 1.0 / (north * north + east * east)
    steep = 1.0 / np.maximum((1.0 - sine) * (1.0 + sine), 1e-12)
    p00, p01, p02, p11, p12, p22 = (var[:, i, j] for i in range(3) for j in range(i, 3))
    along = level * (north * north * p00 + 2.0 * north * east * p01 + east * east * p11)
    across = level * (east * east * p00 - 2.0 * north * east * p01 + north * north * p11)
    vertical = p22 + 2.0 * sine * level * (north * p02 + east * p12) + sine * sine * steep * along
    variances = np.stack([steep * along, across, vertical], axis=1)
    sigmas: Floats = np.sqrt(np.clip(variances, 0.0, math.pi**2 / 3.0))
    return sigmas
