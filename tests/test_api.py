"""The library: the same bits as the commands, in the frames that the user asks for, and clear errors."""

import csv
import dataclasses
import doctest
import importlib
import inspect
import subprocess
import sys
import warnings

import numpy as np
import pytest
from emulated_recording import record

import imud
from imud.commands import main
from imud.errors import ConfigError, InputMissingError
from imud.estimators import registry
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.scenarios import SCENARIOS
from imud.recording import enu

RATE_HZ = 100.0
N = 1500


@pytest.fixture(scope="module")
def drive():
    """A start from rest to the north-east with a fix each half second: (t, gyro, accel) in FRD, columns of fixes."""
    rng = np.random.default_rng(7)
    t = 1000.25 + np.arange(N) / RATE_HZ
    moving = t > t[0] + 5.0
    accel = np.tile([0.0, 0.0, -9.81], (N, 1)) + rng.normal(0.0, 0.02, (N, 3))
    accel[moving, 0] += 1.0
    gyro = rng.normal([2e-3, -1e-3, 5e-4], 1e-3, (N, 3))
    fix_t = np.arange(t[0] + 0.5, t[-1], 0.5)
    along = 0.5 * np.maximum(fix_t - t[0] - 5.0, 0.0) ** 2
    speed = np.maximum(fix_t - t[0] - 5.0, 0.0)
    fixes = {
        "t_s": fix_t,
        "lat_deg": 48.0 + np.degrees(along * np.sqrt(0.5) / 6.36e6),
        "lon_deg": 11.0 + np.degrees(along * np.sqrt(0.5) / 4.27e6),
        "height_m": 500.0 + 0.0 * fix_t,
        **{name: np.full(len(fix_t), 1.0) for name in ("sn_m", "se_m", "sd_m")},
        "vn_mps": speed * np.sqrt(0.5),
        "ve_mps": speed * np.sqrt(0.5),
        "vd_mps": 0.0 * fix_t,
    }
    return (t, gyro, accel), fixes


def write(path, columns):
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        rows.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


def imu_columns(imu):
    t, gyro, accel = imu
    names = ("gx_radps", "gy_radps", "gz_radps", "ax_mps2", "ay_mps2", "az_mps2")
    return {"t_s": t, **dict(zip(names, np.hstack([gyro, accel]).T, strict=True))}


def replayed(folder, imu, fixes, *options):
    """The numbers of est.csv, by column, that the command makes."""
    write(folder / "imu.csv", imu_columns(imu))
    arguments = ["replay", "--imu", str(folder / "imu.csv"), "-o", str(folder / "est.csv"), *options]
    if fixes:
        write(folder / "gnss.csv", fixes)
        arguments += ["--gnss", str(folder / "gnss.csv")]
    assert main(arguments) == 0
    return np.genfromtxt(folder / "est.csv", delimiter=",", names=True)


@pytest.mark.parametrize("with_fixes", [False, True], ids=["attitude", "navigate"])
def test_the_library_computes_what_the_command_computes(tmp_path, drive, with_fixes):
    imu, fixes = drive
    table = replayed(tmp_path, imu, fixes if with_fixes else None, "--set", "imu.profile=m-g350")
    settings = {"imu.profile": "m-g350"}
    solution = imud.navigate(imu, fixes, settings=settings) if with_fixes else imud.attitude(*imu, settings=settings)
    assert len(solution) == N
    for name, column, decimals in (
        ("roll_deg", solution.roll_deg, 5),
        ("yaw_deg", solution.yaw_deg, 5),
        ("q2", solution.q[:, 2], 9),
        ("bgx_radps", solution.gyro_bias_radps[:, 0], 9),
        ("spitch_deg", solution.sigma_rpy_deg[:, 1], 5),
        ("lat_deg", solution.lat_deg, 10),
        ("ve_mps", solution.velocity_mps[:, 1], 5),
        ("svd_mps", solution.sigma_velocity_mps[:, 2], 5),
        ("sn_m", solution.sigma_position_m[:, 0], 4),
        ("status", solution.status, 0),
    ):
        np.testing.assert_allclose(column, table[name], rtol=0.0, atol=0.51 * 10.0**-decimals, err_msg=name)
    assert solution.position_valid[-1] == with_fixes and solution.attitude_valid[-1]


def test_a_filter_stepped_by_hand_agrees_with_the_whole(drive):
    (t, gyro, accel), fixes = drive
    whole = imud.navigate((t, gyro, accel), fixes)
    stepped = imud.NavigationFilter(rate_hz=RATE_HZ)
    rows, innovations, k = [], 0, 0
    for i in range(N):
        while i and k < len(fixes["t_s"]) and fixes["t_s"][k] <= t[i]:
            stepped.fix(**{name: values[k] for name, values in fixes.items()})
            k += 1
        solution = stepped.step(t[i], gyro[i], accel[i])
        rows.append(solution.records)
        innovations += len(solution.innovations.t)
    assert np.concatenate(rows).tobytes() == whole.records.tobytes()
    assert innovations == len(whole.innovations.t) > 3 * k


def test_an_estimator_may_be_the_users_own(drive):
    imu, _ = drive
    own = dataclasses.replace(registry.by_name("tilt"), name="mine")
    for run in (imud.attitude, lambda *imu, estimator: imud.AttitudeFilter(RATE_HZ, estimator=estimator).step(*imu)):
        assert run(*imu, estimator=own).records.tobytes() == run(*imu, estimator="tilt").records.tobytes()


def test_robotics_frames(drive):
    (t, gyro, accel), fixes = drive
    flu = np.array([1.0, -1.0, -1.0])
    ours = imud.navigate((t, gyro, accel), fixes)
    theirs = imud.navigate((t, gyro * flu, accel * flu), fixes, frames="enu-flu")
    assert ours.records.tobytes() == theirs.records.tobytes()
    k = N - 1
    q = np.array(enu.attitude(ours.q[k]))
    np.testing.assert_allclose(theirs.q[k] * np.sign(theirs.q[k] @ q), q, atol=1e-12)
    np.testing.assert_allclose(theirs.velocity_mps[k], enu.world(ours.velocity_mps[k]))
    np.testing.assert_allclose(theirs.rate_radps[k], enu.body(ours.rate_radps[k]))
    w, x, y, z = theirs.q[k]
    yaw = np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    assert abs((theirs.yaw_deg[k] - yaw + 180.0) % 360.0 - 180.0) < 1e-9


def test_a_recording_is_read_as_arrays_that_the_filters_take(tmp_path):

    record(tmp_path / "still.mcap", Trajectory(SCENARIOS["rest"](0.0, 0.0, 0.0), 35.0, 139.0, 60.0), 3.0)
    recording = imud.read(tmp_path / "still.mcap")
    n = len(recording.estimates)
    assert n > 300 and recording.imu["gyro"].shape == (n, 3) and len(recording.gnss["t_s"]) == 0
    solution = imud.attitude(recording.imu["t"], recording.imu["gyro"], recording.imu["accel"])
    np.testing.assert_allclose(solution.t, recording.estimates.t, atol=1e-6)
    assert np.abs(solution.roll_deg - recording.estimates.roll_deg)[-1] < 0.1
    with pytest.raises(InputMissingError):
        imud.read(tmp_path / "absent.mcap")


def test_what_is_printed_of_a_solution_is_one_line():
    t = np.arange(300) / 100.0
    solution = imud.attitude(t, np.zeros((300, 3)), np.tile([0.0, 0.0, -9.8], (300, 1)))
    share = 100.0 * solution.attitude_valid.mean()
    assert 50.0 < share <= 100.0
    said = f"<Solution: 300 rows in 3.0 s, attitude valid {share:.0f} %, heading valid 0 %, position valid 0 %, "
    assert repr(solution) == f"{said}{len(solution.innovation_records)} innovations, ned-frd>"


def test_what_the_filter_estimates_beside_its_solution(drive):
    (t, gyro, accel), fixes = drive
    stepped = imud.NavigationFilter(rate_hz=RATE_HZ)
    assert stepped.filter_states() == {}
    stepped.step(t[:300], gyro[:300], accel[:300])
    assert "heading_boresight_deg" not in stepped.filter_states()
    for k in range(300, N, 50):
        row = {name: values[np.searchsorted(fixes["t_s"], t[k]) - 1] for name, values in fixes.items()}
        stepped.fix(**row)
        stepped.aid("heading", t_s=t[k - 1], heading_deg=45.0, sigma_deg=1.0)
        solution = stepped.step(t[k : k + 50], gyro[k : k + 50], accel[k : k + 50])
    found = stepped.filter_states()
    assert found["cov_pn_pn"] ** 0.5 == pytest.approx(solution.sigma_position_m[-1, 0])
    assert 0.0 < found["sheading_boresight_deg"] < 3.0
    assert {"time_offset_s", "stime_offset_s", "heading_boresight_deg", "age_heading_s"} <= set(found)


def test_heading_as_an_aiding_source(drive):
    imu, fixes = drive
    compass = {"t_s": imu[0][::20], "heading_deg": np.full(N // 20, 123.0), "sigma_deg": np.full(N // 20, 1.0)}
    solution = imud.navigate(imu, fixes, {"heading": compass})
    assert abs(solution.yaw_deg[400] - 123.0) < 1.0 and solution.heading_valid[400]
    assert "yaw_rad" in solution.innovations.kind


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"t": [0.0, 1.0, 1.0]}, r"t\[2\] is not later"),
        ({"t": [0.0, 1e10, 2e10]}, r"t\[2\] is 2e\+10 s after t\[0\]: is it in s"),
        ({"t": np.array([0, 10, 20], "datetime64[ms]")}, r"t has dates or time spans \(datetime64\[ms\]\)"),
        ({"t": ["a", "b", "c"]}, "t: could not convert"),
        ({"gyro": [[None] * 3] * 3}, r"gyro\[0\] is not finite"),
        ({"accel": [[object()] * 3] * 3}, "accel: "),
        ({"t": [], "gyro": np.zeros((0, 3)), "accel": np.zeros((0, 3))}, "0 samples; at least two"),
        ({"gyro": np.zeros((3, 2))}, r"gyro has the shape \(3, 2\)"),
        ({"accel": np.full((3, 3), np.nan)}, r"accel\[0\] is not finite"),
        ({"frames": "enu"}, "frames"),
        ({"estimator": "nothing"}, "nothing"),
        ({"t": [0.0], "gyro": np.zeros((1, 3)), "accel": np.zeros((1, 3))}, "at least two"),
    ],
)
def test_what_is_wrong_is_said(change, says):
    arguments = {"t": [0.0, 0.01, 0.02], "gyro": np.zeros((3, 3)), "accel": np.tile([0, 0, -9.8], (3, 1))} | change
    with pytest.raises(ValueError, match=says):
        imud.attitude(**arguments)


@pytest.mark.parametrize(
    ("t_scale", "gyro_scale", "accel_scale", "frames", "says"),
    [
        (1e3, 1.0, 1.0, "ned-frd", "is their time in s"),
        (1.0, 57.3, 1.0, "ned-frd", "is it in rad/s"),
        (1.0, 1.0, 1 / 9.81, "ned-frd", "is it in m/s"),
        (1.0, 1.0, 1.0, "enu-flu", "upside down"),
    ],
)
def test_values_in_other_units_or_axes_give_a_warning(t_scale, gyro_scale, accel_scale, frames, says):
    t, gyro = np.arange(300) / 100.0, np.random.default_rng(1).normal(0.0, 0.06, (300, 3))
    accel = np.tile([0.0, 0.0, -9.81], (300, 1)) + gyro
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        imud.attitude(t, gyro, accel)
    with pytest.warns(UserWarning, match=says):
        imud.attitude(t * t_scale, gyro * gyro_scale, accel * accel_scale, frames=frames)


def test_fixes_outside_the_time_of_the_samples_give_a_warning(drive):
    imu, fixes = drive
    with pytest.warns(UserWarning, match="no fix lies within the time of the samples"):
        imud.navigate(imu, fixes | {"t_s": fixes["t_s"] + 1e6})


def test_what_is_wrong_with_tables_and_settings_is_said(drive):
    imu, fixes = drive
    with pytest.raises(ValueError, match="imu is a path"):
        imud.navigate("imu.csv", fixes)
    for no_table in ([{"t_s": 1.0}], np.zeros((3, 4)), 5):
        with pytest.raises(ValueError, match="gnss is of the type"):
            imud.navigate(imu, no_table)
    with pytest.raises(ValueError, match="t_s has dates"):
        imud.navigate(imu, fixes | {"t_s": fixes["t_s"].astype("datetime64[s]")})
    with pytest.raises(ValueError, match="gnss, row 0: ve_mps without vn_mps"):
        imud.navigate(imu, fixes | {"vn_mps": np.full(len(fixes["t_s"]), np.nan), "ve_mps": 0.0 * fixes["t_s"]})
    with pytest.raises(ValueError, match="lat_deg"):
        imud.navigate(imu, {"t_s": [1.0]})
    with pytest.raises(ValueError, match=r"gnss, row 0: lat_deg is 95\.0"):
        imud.navigate(imu, fixes | {"lat_deg": np.full(len(fixes["t_s"]), 95.0)})
    with pytest.raises(ValueError, match="no aiding source 'compas'"):
        imud.navigate(imu, fixes, {"compas": {}})
    with pytest.raises(ConfigError, match="vehicl"):
        imud.attitude(*imu, settings={"navigation.vehicl": "land"})
    with pytest.raises(ValueError, match="first"):
        imud.NavigationFilter(100.0).fix(t_s=0.0, lat_deg=0.0, lon_deg=0.0, height_m=0.0)


def test_a_misspelt_name_of_a_measurement_is_no_unknown_value():
    stepped = imud.NavigationFilter(RATE_HZ)
    stepped.step(0.0, [0.0, 0.0, 0.0], [0.0, 0.0, -9.8])
    with pytest.raises(ValueError, match=r"fix\(\) takes no v_n; it takes t_s, lat_deg"):
        stepped.fix(t_s=0.0, lat_deg=48.0, lon_deg=11.0, height_m=500.0, v_n=3.0)
    with pytest.raises(ValueError, match=r"aid\('heading'\) takes no sigma; it takes t_s, heading_deg, sigma_deg"):
        stepped.aid("heading", t_s=0.0, heading_deg=3.0, sigma=1.0)


def test_a_fix_that_the_settings_forbid_is_not_used_by_a_filter_stepped_by_hand():
    stepped = imud.NavigationFilter(RATE_HZ, settings={"gnss.min_satellites": 5})
    stepped.step(0.0, [0.0, 0.0, 0.0], [0.0, 0.0, -9.8])
    with pytest.warns(UserWarning, match="a fix is not used: 4 satellites, fewer than gnss.min_satellites = 5"):
        stepped.fix(t_s=0.0, lat_deg=48.0, lon_deg=11.0, height_m=500.0, satellites=4)
    assert not len(stepped.step(0.01, [0.0, 0.0, 0.0], [0.0, 0.0, -9.8]).innovations.t)


def test_settings_may_be_numbers_and_arrays_of_numpy():
    t, still = np.arange(300) / 100.0, np.zeros((300, 3))
    numpys = {"noise.gyro_scale_percent": np.float64(0.5), "imu.mount_rpy_deg": np.array([180.0, 0.0, 0.0])}
    plain = {"noise.gyro_scale_percent": 0.5, "imu.mount_rpy_deg": [180.0, 0.0, 0.0]}
    down = np.tile([0.0, 0.0, 9.81], (300, 1))
    of_numpys, of_plain = (imud.attitude(t, still, down, settings=given) for given in (numpys, plain))
    assert of_numpys.records.tobytes() == of_plain.records.tobytes()


def test_the_public_names():
    """Change them on purpose only: programs of users depend on them."""
    assert set(imud.__all__) == {
        *("attitude", "navigate", "read"),
        *("AttitudeFilter", "NavigationFilter", "Solution", "Innovations", "Recording"),
    }
    assert all(getattr(imud, name).__doc__ for name in imud.__all__)
    assert set(imud.__all__) <= set(dir(imud))
    with pytest.raises(AttributeError):
        imud.nothing  # noqa: B018


_COMMON = "settings=None initial=None frames='ned-frd'"
_FILTER = f"rate_hz * {_COMMON} estimator=None"
_PUBLIC = {
    "attitude": f"t gyro accel temperature=None * {_COMMON} estimator='attitude' smooth=False",
    "navigate": f"imu gnss aiding=None * {_COMMON} estimator='navigation' smooth=False",
    "read": "paths",
    "AttitudeFilter": _FILTER,
    "AttitudeFilter.estimator": "",
    "AttitudeFilter.filter_states": "self",
    "AttitudeFilter.step": "self t gyro accel temperature=None",
    "NavigationFilter": _FILTER,
    "NavigationFilter.estimator": "",
    "NavigationFilter.filter_states": "self",
    "NavigationFilter.step": "self t gyro accel temperature=None",
    "NavigationFilter.aid": "self source **columns",
    "NavigationFilter.fix": "self **columns",
    "Solution": "records innovation_records origin frames='ned-frd'",
    "Solution.frames": "",
    "Solution.to_pandas": "self",
    "Recording": "imu gnss estimates settings notes",
    "Innovations": "t kind value sigma used",
    **{f"Innovations.{name}": "" for name in ("t", "kind", "value", "sigma", "used", "count", "index")},
    **{f"Solution.{name}_valid": "" for name in ("attitude", "heading", "position", "height")},
    **{
        f"Solution.{name}": ""
        for name in (
            *("t", "status", "at_rest", "q", "roll_deg", "pitch_deg", "yaw_deg", "sigma_rpy_deg", "lat_deg", "lon_deg"),
            *("height_m", "sigma_position_m", "velocity_mps", "sigma_velocity_mps", "rate_radps", "force_mps2"),
            *("gyro_bias_radps", "sigma_gyro_bias_radps", "accel_bias_mps2", "sigma_accel_bias_mps2", "innovations"),
        )
    },
}


def test_the_public_signatures():
    """Nobody's call breaks by accident: names, parameters with their defaults, what is keyword-only."""

    def parameters(function):
        found = [str(p.replace(annotation=p.empty)) for p in inspect.signature(function).parameters.values()]
        kinds = [p.kind for p in inspect.signature(function).parameters.values()]
        if inspect.Parameter.KEYWORD_ONLY in kinds:
            found.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
        return " ".join(found)

    found = {}
    for name in imud.__all__:
        public = getattr(imud, name)
        found[name] = parameters(public)
        if inspect.isclass(public):
            for member in (member for member in dir(public) if not member.startswith("_")):
                value = inspect.getattr_static(public, member)
                found[f"{name}.{member}"] = parameters(value) if inspect.isfunction(value) else ""
    assert found == _PUBLIC


def test_importing_imud_imports_nothing_else():
    code = "import sys, imud; print({'numpy', 'msgspec', 'imud.api'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


@pytest.mark.parametrize("module", ["filters", "solution", "whole"])
def test_the_examples_in_the_docstrings(module):
    result = doctest.testmod(importlib.import_module(f"imud.api.{module}"))
    assert result.attempted > 3 and not result.failed
