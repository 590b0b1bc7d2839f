"""Biases kept over a restart are used only while they are surely those of the sensor; any other file is as none."""

import json

import numpy as np
import pytest

from imud.configuration.settings import Imu, Initial, Settings
from imud.estimators import registry
from imud.estimators.ahrs import state as ahrs
from imud.estimators.ins import state as ins
from imud.math.kalman import unpack
from imud.pipeline import Filter
from imud.sensor_errors import stored_biases
from imud.sensor_errors.calibration import Calibration, correction
from imud.sensor_errors.profiles import PROFILES
from imud.sensor_errors.stored_biases import MAX_AGE_S, Biases

PROFILE = PROFILES["m-g350"]
FOUND = Biases((0.01, -0.02, 0.003), (1e-4, 2e-4, 3e-4), (0.05, -0.06, 0.07), (0.01, 0.02, 0.03))
AS_IT_IS = correction(Calibration(""), (0.0, 0.0, 0.0))
SAVED_NS = 10**12


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    stored_biases.save("W1", AS_IT_IS, SAVED_NS, FOUND)
    return tmp_path / "imud"


def load(serial="W1", age_s=3.0, as_corrected=AS_IT_IS):
    return stored_biases.load(serial, as_corrected, SAVED_NS + round(age_s * 1e9), PROFILE)


def test_what_was_found_comes_back_less_sure(folder):
    back = load()
    assert (back.gyro_radps, back.accel_mps2) == (FOUND.gyro_radps, FOUND.accel_mps2)
    for now, then in ((back.gyro_sigma_radps, FOUND.gyro_sigma_radps), (back.accel_sigma_mps2, FOUND.accel_sigma_mps2)):
        assert all(new >= 2.0 * old for new, old in zip(now, then, strict=True))
    assert min(load(age_s=50.0).gyro_sigma_radps) > min(back.gyro_sigma_radps)
    assert [path.name for path in folder.iterdir()] == ["biases-5731.json"]  # and nothing half written


@pytest.mark.parametrize(
    "asked",
    [
        {"serial": "W2"},
        {"age_s": MAX_AGE_S + 1.0},
        {"age_s": -1.0},
        {"as_corrected": correction(Calibration(""), (0.0, 0.0, 90.0))},
    ],
)
def test_biases_of_another_sensor_time_or_mounting_are_not_used(folder, asked):
    assert load() is not None
    assert load(**asked) is None


def change(document, **parts):
    return json.dumps(json.loads(document) | parts)


@pytest.mark.parametrize(
    "broken",
    [
        lambda document: "",
        lambda document: document[: len(document) // 2],
        lambda document: "\x00" * 100,
        lambda document: change(document, boot_id="of another boot"),
        lambda document: change(document, serial="W2"),
        lambda document: change(document, biases={}),
        lambda document: document.replace("0.0001", "-0.0001"),
        lambda document: document.replace("0.0001", "0.0"),
        lambda document: document.replace("0.0001", "1e999"),
        lambda document: document.replace("0.0001", "1.0"),  # less than the profile knows
    ],
)
def test_a_file_that_is_not_what_was_written_is_as_none(folder, broken):
    path = folder / "biases-5731.json"
    path.write_text(broken(path.read_text()))
    assert load() is None


@pytest.mark.parametrize("estimator", ["attitude", "navigation"])
def test_a_filter_begins_with_them(estimator):
    settings = Settings(imu=Imu(profile="m-g350"))
    filter_ = Filter(registry.by_name(estimator), settings, Initial(), 100.0)
    state = filter_.state["core"][0] if estimator == "navigation" else filter_.state
    indices = ins if estimator == "navigation" else ahrs
    before = unpack(state["cov"]["P"][0], indices.STATES)
    filter_.restore_biases(FOUND)
    assert tuple(state["nav"]["bg"][0]) == FOUND.gyro_radps
    assert tuple(state["nav"]["ba"][0]) == FOUND.accel_mps2
    after = unpack(state["cov"]["P"][0], indices.STATES)
    for first, sigmas in ((indices.GYRO_BIAS, FOUND.gyro_sigma_radps), (indices.ACCEL_BIAS, FOUND.accel_sigma_mps2)):
        np.testing.assert_allclose(np.sqrt(np.diag(after)[first : first + 3]), sigmas)
        after[range(first, first + 3), range(first, first + 3)] = before[first, first]
    np.testing.assert_allclose(np.diag(after), np.diag(before))
