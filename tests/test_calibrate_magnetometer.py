"""`imud calibrate mag`: hard and soft iron from readings, refused where they do not suffice, then applied."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from test_navigation_aiding import estimated
from test_navigation_magnetometer import EARTH, ON, readings, recorded, yaw

from imud.commands import main
from imud.configuration.settings import Initial
from imud.estimators import registry
from imud.estimators.records import HEADING_VALID, SOLUTION
from imud.pipeline import Filter
from imud.sensor_errors import calibration
from imud.sensor_errors.magnetometer import coverage, iron
from imud.sensor_errors.rest import UnfitError

STRENGTH = float(np.linalg.norm(EARTH))
BIAS = np.array([20e-6, -35e-6, 12e-6])
SOFT = np.array([[1.10, 0.05, -0.02], [0.05, 0.95, 0.03], [-0.02, 0.03, 1.02]])


def turned(seed=1, n=1500, noise=0.3e-6, most_deg=180.0):
    """Readings while something is turned by up to `most_deg` about level axes, and all the way about the vertical."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-1.0, 1.0, (n, 3)) * (180.0, most_deg, most_deg)
    fields = Rotation.from_euler("ZYX", angles, degrees=True).inv().apply(EARTH)
    return fields @ np.linalg.inv(SOFT).T + BIAS + noise * rng.standard_normal((n, 3))


def test_hard_and_soft_iron_are_found():
    found = iron(turned(), STRENGTH)
    assert found.bias == pytest.approx(BIAS, abs=0.1e-6)
    assert found.matrix == pytest.approx(SOFT, abs=3e-3)
    assert found.residual == pytest.approx(0.3e-6, rel=0.1)
    assert found.residual <= found.sigma < 0.6e-6
    assert found.coverage > 0.95


def test_they_are_those_of_a_general_optimizer():
    fields = turned(2, noise=1e-6)

    def strengths(x):
        matrix = np.array([[x[3], x[6], x[7]], [x[6], x[4], x[8]], [x[7], x[8], x[5]]])
        return np.linalg.norm((1e6 * fields - x[:3]) @ matrix.T, axis=1) / (1e6 * STRENGTH) - 1.0

    best = least_squares(strengths, [0, 0, 0, 1, 1, 1, 0, 0, 0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    found = iron(fields, STRENGTH)
    assert 1e6 * found.bias == pytest.approx(best[:3], abs=1e-4)
    assert [found.matrix[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))] == pytest.approx(
        best[3:], abs=1e-6
    )


def test_the_error_of_the_bias_lies_within_its_sigma():
    z = []
    for seed in range(20):
        found = iron(turned(seed, n=120, noise=0.5e-6), STRENGTH)
        bias_sigma = np.sqrt(found.sigma**2 - found.residual**2)
        z.append(np.linalg.norm(found.bias - BIAS) / np.sqrt(3.0) / bias_sigma)
    assert 0.1 < np.sqrt(np.mean(np.square(z))) < 1.2


def test_without_a_strength_the_mean_scale_is_taken_as_right():
    matrix = iron(turned()).matrix
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    assert matrix / matrix[0, 0] == pytest.approx(SOFT / SOFT[0, 0], abs=3e-3)


@pytest.mark.parametrize("most_deg", [0.0, 20.0])
def test_turns_on_level_ground_alone_are_refused_with_advice(most_deg):
    with pytest.raises(UnfitError, match=r"cover \d+ % of all directions.*about all its axes"):
        iron(turned(most_deg=most_deg), STRENGTH)


def test_a_motor_that_runs_now_and_then_is_refused():
    fields = turned()
    fields[400:900, 1] += 15e-6
    with pytest.raises(UnfitError, match="motors"):
        iron(fields, STRENGTH)


@pytest.mark.parametrize("fields", [np.zeros((0, 3)), np.full((500, 3), 2e-5), np.full((500, 3), np.nan)])
def test_nothing_to_fit_is_refused(fields):
    with pytest.raises(UnfitError):
        iron(fields, STRENGTH)


def test_coverage_of_a_hemisphere_and_its_rim():
    """Of a sphere the part within 30 deg of a hemisphere is (1 + sin 30) / 2."""
    rng = np.random.default_rng(3)
    vectors = rng.standard_normal((5000, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    assert coverage(vectors) == pytest.approx(0.75, abs=0.02)


def test_the_command_saves_it_and_the_filter_applies_it(tmp_path, capsys):
    table = tmp_path / "mag.csv"
    lines = (f"{0.1 * k:.1f},{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(1e6 * turned()))
    table.write_text("t_s,mx_ut,my_ut,mz_ut\n" + "\n".join(lines) + "\n")
    command = ["calibrate", "mag", str(table), "--serial", "S1", "--state", str(tmp_path)]
    assert main([*command, "--strength", f"{1e6 * STRENGTH}"]) == 0
    said = capsys.readouterr()
    assert "hard iron: x +19.9" in said.out and "residual: 0.3" in said.out and "sigma of a heading" in said.out
    saved = calibration.load("S1", [tmp_path])
    assert saved.magnetometer.matrix[0] == pytest.approx(SOFT[0], abs=3e-3)

    d, samples, fixes, rng = recorded(1, seconds=20.0, rest=20.0)
    rows = readings(d, rng)
    rows["value"][:, :3] = rows["value"][:, :3] @ np.linalg.inv(SOFT).T + BIAS
    out, _ = estimated(samples, fixes, rows, ON)
    assert not (out["status"] & HEADING_VALID).any()  # uncalibrated it is no earth's field
    filter_ = Filter(registry.by_name("navigation"), ON, Initial(), 100.0)
    filter_.calibrate(saved)
    out = np.zeros(len(samples), SOLUTION)
    for k in range(0, len(samples), 10):
        filter_.run(samples[k : k + 10].copy(), out[k : k + 10])
        due = rows[(rows["arrival_ns"] > samples["t_ns"][k]) & (rows["arrival_ns"] <= samples["t_ns"][k + 9])]
        filter_.aid(due)
        for fix in fixes[(fixes["arrival_ns"] > samples["t_ns"][k]) & (fixes["arrival_ns"] <= samples["t_ns"][k + 9])]:
            filter_.update(np.array([fix]))
    e, sigma = yaw(d, out)
    assert out["status"][-1] & HEADING_VALID and abs(e[-1]) < np.radians(2.0) and sigma[-1] < np.radians(8.0)


def test_readings_that_do_not_suffice_end_the_command_and_change_nothing(tmp_path, capsys):
    table = tmp_path / "mag.csv"
    lines = (f"{0.1 * k:.1f},{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(1e6 * turned(most_deg=5.0)))
    table.write_text("t_s,mx_ut,my_ut,mz_ut\n" + "\n".join(lines) + "\n")
    assert main(["calibrate", "mag", str(table), "--serial", "S1", "--state", str(tmp_path)]) == 65
    assert "each side down once" in capsys.readouterr().err
    assert not list(tmp_path.glob("calibration*"))
    assert main(["calibrate", "mag", str(table), "--serial", "S1", "--strength", "0.5"]) == 64
