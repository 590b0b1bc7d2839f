"""`imud calibrate` on recordings of the emulator, from bytes to what the daemon reads: what was put in comes out."""

import dataclasses

import numpy as np
import pytest
from emulated_recording import record
from scipy.spatial.transform import Rotation

from imud.commands import main
from imud.firmware_sim.motion import Mounted, Trajectory
from imud.firmware_sim.scenarios import SCENARIOS
from imud.sensor_errors import calibration

DPS = np.radians(1.0)
SERIAL = "S0000042"
RIGHT_HANDED = Rotation.create_group("O").as_matrix()
FINE = Rotation.from_euler("ZYX", [4.0, -3.0, 2.0], degrees=True).as_matrix()


def vehicle(scenario, **delay):
    return Trajectory(SCENARIOS[scenario](0.0, 0.0, 0.0), 35.0, 139.0, 60.0, **delay)


class Remembered:
    """A motion that is computed once for all sensors that feel it at the same times."""

    end = float("inf")

    def __init__(self, signal):
        self._signal, self._felt = signal, {}

    def imu(self, t):
        if (key := t.tobytes()) not in self._felt:
            self._felt[key] = self._signal.imu(t)
        return self._felt[key].copy()


@pytest.fixture(scope="module")
def start():
    """A vehicle that rests and then drives off."""
    return Remembered(vehicle("figure8"))


def calibrate(what, path, folder, *more):
    return main(["calibrate", what, str(path), "--state", str(folder), *more])


@pytest.fixture(scope="module")
def warm_up(tmp_path_factory):
    """Seven minutes from switching on."""
    path = tmp_path_factory.mktemp("warm") / "warm.mcap"
    slope, bias = (0.02 * DPS, -0.01 * DPS, 0.005 * DPS), (0.3 * DPS, -0.2 * DPS, 0.1 * DPS)
    record(path, vehicle("rest"), 420.0, gyro_slope=slope, gyro_bias=bias, accel_bias=(0.0, 0.0, 0.0))
    return path, np.array(slope), np.array(bias)


@pytest.mark.thorough
def test_a_warm_up_gives_bias_and_slope(warm_up, tmp_path, capsys):
    path, slope, bias = warm_up
    assert calibrate("temperature", path, tmp_path, "--latitude", "35") == 0
    said = capsys.readouterr()
    assert "its slope: x +0.0" in said.out and f"{SERIAL}: saved in" in said.err
    found = calibration.load(SERIAL, [tmp_path]).gyro
    assert found.slope_radps_per_k == pytest.approx(slope, abs=0.002 * DPS)  # 6 deg/h of in-run bias over 5 K
    assert found.bias_radps == pytest.approx(bias + slope * (found.temperature_c - 25.0), abs=0.01 * DPS)
    assert max(found.slope_sigma_radps_per_k) < 0.002 * DPS


def test_a_still_bias_of_the_same_recording_goes_to_another_name(warm_up, tmp_path):
    path, _, bias = warm_up
    assert calibrate("still", path, tmp_path, "--serial", "other") == 0
    assert calibration.load(SERIAL, [tmp_path]).gyro is None
    assert calibration.load("other", [tmp_path]).gyro.bias_radps == pytest.approx(bias, abs=0.12 * DPS)


@pytest.mark.thorough
@pytest.mark.parametrize("way", range(24))
def test_a_start_forwards_gives_the_mounting_in_all_right_handed_orientations(way, start, tmp_path):
    matrix = RIGHT_HANDED[way] @ FINE
    path = tmp_path / "start.mcap"
    record(path, Mounted(start, matrix), 14.0, gyro_bias=(0.01, -0.01, 0.01), accel_bias=(0.01, 0.0, -0.01))
    assert calibrate("mounting", path, tmp_path) == 0
    found = calibration.load(SERIAL, [tmp_path]).mounting
    turned = Rotation.from_euler("ZYX", found.rpy_deg[::-1], degrees=True).as_matrix()
    left = Rotation.from_matrix(turned @ matrix.T).as_rotvec(degrees=True)
    assert np.abs(left[:2]).max() < 0.6 and abs(left[2]) < 3.0
    assert abs(left[2]) < 4.0 * found.sigma_deg[2]


@dataclasses.dataclass
class Mirrored:
    """A sensor whose y axis points the wrong way for both its gyro and its accelerometer."""

    signal: Trajectory
    end = float("inf")

    def imu(self, t):
        return self.signal.imu(t) * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])


@dataclasses.dataclass
class Broken:
    """A sensor that is all right but for what `harm` does to its values (n x 6) at times t."""

    signal: Trajectory
    harm: object
    end = float("inf")

    def imu(self, t):
        values = self.signal.imu(t)
        self.harm(values, t)
        return values


def frozen(values, t):
    values[t > 0.0, 2] = 0.25


def saturated(values, t):
    values[(t > 12.0) & (t < 16.0), 4] = 40.0


def shaken(values, t):
    values[:, :3] += 0.5 * np.sin(9.0 * t)[:, None]
    values[:, 3:] += 2.0 * np.sin(7.0 * t)[:, None]


@pytest.mark.parametrize(
    ("what", "signal", "ideal", "says"),
    [
        ("mounting", Mirrored(vehicle("figure8")), False, "an axis is mirrored"),
        ("mounting", vehicle("rest"), False, "no acceleration above"),
        ("still", Broken(vehicle("rest"), frozen), True, "is frozen"),
        ("still", Broken(vehicle("rest"), saturated), False, "accelerometer's y is at the end of its range"),
        ("still", Broken(vehicle("rest"), shaken), False, "never at rest"),
        ("temperature", vehicle("rest"), False, "start cold"),
        ("faces", vehicle("rest"), False, "each of its six sides"),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(what, signal, ideal, says, tmp_path, capsys):
    record(tmp_path / "r.mcap", signal, 24.0, ideal=ideal)
    assert calibrate(what, tmp_path / "r.mcap", tmp_path) == 65
    assert says in capsys.readouterr().err
    assert not list(tmp_path.glob("*.toml"))


def test_a_table_needs_a_serial_number(tmp_path, capsys):
    table = tmp_path / "t.csv"
    table.write_text("t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2\n0,0,0,0,0,0,-9.8\n1,0,0,0,0,0,-9.8\n")
    assert calibrate("still", table, tmp_path) == 64
    assert "--serial" in capsys.readouterr().err
