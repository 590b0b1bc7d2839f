"""The rotation kernels against scipy's Rotation, and Euler angle variances against a numerical Jacobian."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imud.math import rotation

unit = st.floats(-1.0, 1.0)
quaternions = (
    st.tuples(unit, unit, unit, unit)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: tuple(float(x) for x in np.array(q) / np.linalg.norm(q)))
)
vectors = st.tuples(*[st.floats(-100.0, 100.0)] * 3)
angles = st.floats(-math.pi, math.pi)


def of(q):
    """scipy's Rotation of a scalar-first quaternion."""
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


def same_rotation(q, wanted: Rotation, tolerance=1e-12):
    assert math.isclose(np.linalg.norm(q), 1.0, abs_tol=1e-12)
    assert (of(q) * wanted.inv()).magnitude() < tolerance


@given(quaternions, quaternions)
def test_the_product_is_that_of_scipy(a, b):
    same_rotation(rotation.quat_product(a, b), of(a) * of(b))


@given(quaternions, st.floats(1e-3, 1e3))
def test_normalising_keeps_the_rotation(q, factor):
    same_rotation(rotation.quat_normalised(tuple(factor * x for x in q)), of(q))


@given(quaternions, st.floats(-1e-8, 1e-8))
def test_renormalising_restores_unit_length(q, off):
    got = rotation.quat_renormalised(tuple(x * (1.0 + off) for x in q))
    assert got == pytest.approx(q, abs=1e-15)
    assert abs(np.linalg.norm(got) - 1.0) < 1e-15


@given(vectors.map(lambda v: tuple(x / 20.0 for x in v)))
def test_the_exponential_is_the_rotation_of_a_vector(v):
    same_rotation(rotation.quat_exp(*v), Rotation.from_rotvec(v))


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-9, 0.99e-4, 1.01e-4, 1e-2])
def test_exponential_of_small_angles(angle):
    c, x, y, z = rotation.quat_exp(0.0, angle, 0.0)
    assert (c, x, y, z) == (pytest.approx(math.cos(angle / 2), abs=2e-16), 0.0, y, 0.0)
    assert y == pytest.approx(math.sin(angle / 2), rel=1e-14, abs=0.0)


@given(quaternions, vectors)
def test_rotate_and_back(q, v):
    np.testing.assert_allclose(rotation.quat_rotate(q, v), of(q).apply(v), atol=1e-11)
    np.testing.assert_allclose(rotation.quat_rotate_back(q, v), of(q).inv().apply(v), atol=1e-11)


@given(quaternions)
def test_the_matrix_is_that_of_scipy(q):
    np.testing.assert_allclose(np.reshape(rotation.dcm_of_quat(q), (3, 3)), of(q).as_matrix(), atol=1e-14)


@given(angles, st.floats(-1.57, 1.57), angles)
def test_euler_angles_there_and_back(roll, pitch, yaw):
    q = rotation.quat_of_euler(roll, pitch, yaw)
    same_rotation(q, Rotation.from_euler("ZYX", [yaw, pitch, roll]), 1e-11)
    if abs(pitch) < 1.5:
        back = np.array(rotation.euler_of_quat(q)) - (roll, pitch, yaw)
        assert np.all(np.abs((back + math.pi) % (2 * math.pi) - math.pi) < 1e-9)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
@pytest.mark.parametrize("roll, yaw", [(0.0, 0.0), (0.3, 1.0), (-2.0, 3.0)])
def test_euler_angles_at_the_poles_still_give_the_rotation(pitch, roll, yaw):
    q = rotation.quat_of_euler(roll, pitch, yaw)
    got = rotation.euler_of_quat(q)
    assert got[0] == 0.0 and got[1] == pytest.approx(pitch, abs=1e-6) and abs(got[2]) <= math.pi
    same_rotation(q, Rotation.from_euler("ZYX", got[::-1]), 1e-6)


@given(angles, st.floats(-1.5, 1.5), st.floats(0.1, 30.0))
def test_levelling_by_gravity(roll, pitch, g):
    force = Rotation.from_euler("ZYX", [0.0, pitch, roll]).inv().apply([0.0, 0.0, -g])
    same_rotation(rotation.quat_of_gravity(*force), Rotation.from_euler("ZYX", [0.0, pitch, roll]), 1e-9)


def numerical_jacobian(q):
    """d(roll, pitch, yaw) / d(small rotation in NED), by central differences with scipy."""
    step = 1e-6
    J = np.empty((3, 3))
    for k in range(3):
        turn = np.zeros(3)
        turn[k] = step
        ends = [(Rotation.from_rotvec(sign * turn) * of(q)).as_euler("ZYX")[::-1] for sign in (1.0, -1.0)]
        difference = (ends[0] - ends[1] + math.pi) % (2 * math.pi) - math.pi
        J[:, k] = difference / (2 * step)
    return J


@given(angles, st.floats(-1.4, 1.4), angles, st.integers(0, 2**32 - 1))
def test_euler_variances(roll, pitch, yaw, seed):
    root = 0.01 * np.random.default_rng(seed).normal(size=(3, 3))
    P = root @ root.T
    q = rotation.quat_of_euler(roll, pitch, yaw)
    J = numerical_jacobian(q)
    got = rotation.euler_variances(q, P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2])
    np.testing.assert_allclose(got, np.diag(J @ P @ J.T), rtol=1e-5, atol=1e-12)


def test_euler_variances_stop_at_those_of_a_uniform_angle():
    q = rotation.quat_of_euler(0.2, math.pi / 2, 0.1)
    roll, pitch, yaw = rotation.euler_variances(q, 1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
    assert roll == pytest.approx(math.pi**2 / 3) and yaw == pytest.approx(math.pi**2 / 3)
    assert pitch == pytest.approx(1e-4)
