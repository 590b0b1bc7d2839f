"""The textbook in numpy, for comparison: frames unpacked one by one, and an error-state filter with dense matrices.

It has as many states as the attitude filter, and the same inputs. Every sample propagates the covariance, Phi P Phi' +
Q, and fuses a zero velocity in Joseph's form. It is a baseline, not an optimised implementation.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from ...math.arrays import Floats
from ...math.earth import STANDARD_GRAVITY
from .signals import ACCEL_LSB, FRAME, GYRO_LSB

_UNPACK = struct.Struct(">B9hHB").unpack
STATES = 28


def skew(v: Floats) -> Floats:
    """The matrix of a cross product."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


class Naive:
    """Attitude, velocity, biases, gyro matrix, scale factors and a time offset, as one error state."""

    def __init__(self) -> None:
        self.q = np.array([1.0, 0.0, 0.0, 0.0])
        self.v, self.bg, self.ba = np.zeros(3), np.zeros(3), np.zeros(3)
        self.P = np.diag(np.full(STATES, 1e-2))
        self._Q = np.diag(np.full(STATES, 1e-9))
        self._R = np.eye(3) * 0.01
        self._H = np.zeros((3, STATES))
        self._H[:, 6:9] = np.eye(3)

    def feed(self, frame: bytes) -> Floats:
        """One frame of an M-G350; returns q."""
        words = _UNPACK(frame)
        self._step(np.array(words[3:6]) * GYRO_LSB - self.bg, np.array(words[6:9]) * ACCEL_LSB - self.ba, 1e-3)
        return self.q

    def _step(self, w: Floats, f: Floats, dt: float) -> None:
        W, X, Y, Z = self.q
        x, y, z = 0.5 * dt * w
        rotation = np.array([[1.0, -x, -y, -z], [x, 1.0, z, -y], [y, -z, 1.0, x], [z, y, -x, 1.0]])
        self.q = rotation @ self.q
        self.q /= np.linalg.norm(self.q)
        r = np.array([X, Y, Z])
        C = np.eye(3) + 2.0 * W * skew(r) + 2.0 * skew(r) @ skew(r)
        self.v = self.v + (C @ f + np.array([0.0, 0.0, STANDARD_GRAVITY])) * dt
        F = np.eye(STATES)
        F[0:3, 3:6] = -C * dt
        F[6:9, 0:3] = -skew(C @ f) * dt
        F[6:9, 9:12] = -C * dt
        for i in range(3):
            F[0:3, 12 + 3 * i : 15 + 3 * i] = -C[:, i : i + 1] * w * dt
        F[6:9, 21:24] = -C * f * dt
        F[6:9, 24] = C @ np.cross(f, w) * dt
        self.P = F @ self.P @ F.T + self._Q
        self._update()

    def _update(self) -> None:
        H, P = self._H, self.P
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + self._R)
        x = K @ -self.v
        A = np.eye(STATES) - K @ H
        self.P = A @ P @ A.T + K @ self._R @ K.T
        self.q = self.q + 0.5 * np.concatenate(
            [[-x[0:3] @ self.q[1:]], self.q[0] * x[0:3] - np.cross(self.q[1:], x[0:3])]
        )
        self.bg, self.v, self.ba = self.bg + x[3:6], self.v + x[6:9], self.ba + x[9:12]


def run(frames: NDArray[np.uint8]) -> Floats:
    """Frames (n x 22 bytes) one by one; returns the last q."""
    filter_ = Naive()
    wire = frames.tobytes()
    for at in range(0, len(wire), FRAME):
        filter_.feed(wire[at : at + FRAME])
    return filter_.q
