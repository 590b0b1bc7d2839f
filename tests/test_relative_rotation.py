"""The rotation between two sensors' axes: against the truth, and against SciPy's solution of Wahba's problem."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_comparison import FAULTS, MOTIONS, PAIRS, RATE, sensed

from imud.sensor_errors.profiles import PROFILES
from imud.sensors.comparison import SensorComparison
from imud.sensors.relative_rotation import RelativeRotation

MOUNTINGS = [(35.0, 0.0, 0.0), (0.0, 0.0, 90.0), (10.0, -20.0, 170.0), (180.0, 0.0, 0.0)]
STRANGE = 0.0524  # rad, three degrees: twice 1 deg of each sensor's three axes


def mounted(samples, rpy_deg):
    """The samples of a sensor that is mounted so, without that being known."""
    turn = Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True)
    for name in ("w", "f"):
        samples[name] = turn.inv().apply(samples[name])
    return turn


def found(first, second, profiles=("m-g350", "m-g350")):
    """The rotation of the second to the first that was found last; checks that the other one is its inverse."""
    comparison = SensorComparison()
    for name, profile in zip("ab", profiles, strict=True):
        comparison.join(name, PROFILES[profile], has_gyros=True)
    last = None
    for begin in range(0, len(first), RATE // 2):
        comparison.add_samples("a", first[begin : begin + RATE // 2])
        comparison.add_samples("b", second[begin : begin + RATE // 2])
        comparison.update(set())
        if rotation := comparison.rotation("b", "a"):
            last = rotation
            assert not comparison.agree("a", "b")
            assert comparison.rotation("a", "b").matrix == pytest.approx(last.matrix.T)
    return last


@pytest.mark.thorough
@pytest.mark.parametrize("profiles", PAIRS, ids="+".join)
@pytest.mark.parametrize(("seed", "rpy_deg"), list(enumerate(MOUNTINGS)), ids=str)
def test_motion_shows_how_a_sensor_is_mounted(seed, rpy_deg, profiles):
    truth = MOTIONS["motion"](seed)
    first = sensed(truth, profiles[0], 2 * seed)
    second = sensed(truth, profiles[1], 2 * seed + 1, place=(0.4, -0.3, 0.2), late_s=0.005)
    turn = mounted(second, rpy_deg)
    rotation = found(first, second, profiles)
    error = (Rotation.from_matrix(rotation.matrix) * turn.inv()).magnitude()
    assert error < STRANGE + 4.0 * rotation.sigma


def test_at_rest_the_turn_about_the_vertical_is_not_known():
    for rpy_deg in MOUNTINGS:
        truth = MOTIONS["rest"](0)
        first, second = sensed(truth, "m-g350", 0), sensed(truth, "m-g350", 1)
        mounted(second, rpy_deg)
        assert found(first, second) is None


@pytest.mark.thorough
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_fault_of_a_sensor_is_no_rotation(motion, fault):
    (field, change), _ = FAULTS[fault]
    for seed in range(3):
        truth = MOTIONS[motion](seed)
        sensors = [sensed(truth, "m-g350", 2 * seed + k) for k in range(2)]
        sensors[1][field][15 * RATE :] += change
        assert found(*sensors) is None


def test_it_solves_wahbas_problem():
    """Two quantities whose biases are zero: SciPy's solution for the same vectors and weights, and its sigma."""
    rng = np.random.default_rng(1)
    turn, sigmas = Rotation.from_euler("ZYX", (70.0, 20.0, -40.0), degrees=True), (0.02, 0.1)
    vectors = [rng.standard_normal((40, 3)) for _ in sigmas]
    measured = [turn.apply(v) + s * rng.standard_normal((40, 3)) for v, s in zip(vectors, sigmas, strict=True)]
    estimate = RelativeRotation((1e-12, 1e-12))
    for k in range(40):
        estimate.add([(v[k], m[k], s**2) for v, m, s in zip(vectors, measured, sigmas, strict=True)])
    rotation = estimate.solve()
    newest_last = 0.995 ** np.arange(39, -1, -1)
    weights = np.concatenate([newest_last / s**2 for s in sigmas])
    oracle, _ = Rotation.align_vectors(np.concatenate(vectors), np.concatenate(measured), weights)
    assert (Rotation.from_matrix(rotation.matrix) * oracle.inv()).magnitude() < 1e-6
    assert (Rotation.from_matrix(rotation.matrix) * turn).magnitude() < 4.0 * rotation.sigma
    assert rotation.sigma == pytest.approx(1.0 / np.sqrt(2.0 * (newest_last.sum()) * (1.0 / sigmas[0] ** 2)), rel=0.3)
