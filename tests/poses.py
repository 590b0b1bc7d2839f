"""The sign table's poses: all 24 ways in which axes lie along axes, and what a turning, moving body feels in each."""

import itertools

import numpy as np

from imud.estimators.records import HEIGHT_VALID, SOLUTION

G = 9.8
NED_IN_ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_IN_FLU = np.diag([1, -1, -1])


def poses():
    """All rotations that take axes to axes."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                yield matrix


POSES = list(poses())


def quaternion(r):
    """Scalar first, of a rotation matrix: the eigenvector of Bar-Itzhack's K."""
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    return np.linalg.eigh(k)[1][:, -1]


def solution(r_nb):
    """At rest in that pose, but turning about the vertical and moving."""
    row = np.zeros(1, SOLUTION)[0]
    row["t_ns"], row["status"] = 1_500_000_000, 7 | HEIGHT_VALID
    row["lat"], row["lon"], row["height"] = 0.6, 2.4, 50.0
    row["q_nb"] = quaternion(r_nb)
    row["f"] = r_nb.T @ [0, 0, -G]
    row["w"] = r_nb.T @ [0, 0, 0.5]  # clockwise seen from above
    row["v"] = 1.0, 2.0, 3.0
    row["sigma_p"], row["sigma_v"], row["sigma_rpy"] = (1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (0.01, 0.02, 0.03)
    return row
