"""Fixes whose columns hold something else than their names say: named before they are blamed on the receiver."""

import numpy as np
import pytest

from imud.commands import main
from imud.sensors.misread_columns import misread_columns
from imud.tables.inputs import FIX_COLUMNS, checked_fix, fixes_of

RADIUS_M = 6_378_137.0
PLACES = [(47.3, 8.5), (-33.9, 151.2), (52.0, -179.999), (64.1, -21.9)]


def drive(lat=47.3, lon=8.5, seed=1, noise_m=2.0, radius_m=300.0, speed_mps=10.0, seconds=120):
    """Rows of a car on a circle, with the noise of a receiver: latitude and longitude by arc lengths on a sphere."""
    rng, t = np.random.default_rng(seed), np.arange(float(seconds))
    course = speed_mps / radius_m * t
    north, east = radius_m * np.sin(course), -radius_m * np.cos(course)
    north, east = north + noise_m * rng.standard_normal(len(t)), east + noise_m * rng.standard_normal(len(t))
    lats = lat + np.degrees(north / RADIUS_M)
    lons = (lon + np.degrees(east / RADIUS_M / np.cos(np.radians(lat))) + 180.0) % 360.0 - 180.0
    vn, ve = speed_mps * np.cos(course), speed_mps * np.sin(course)
    names = ("t_s", "lat_deg", "lon_deg", "height_m", "vn_mps", "ve_mps", "vd_mps")
    return [dict(zip(names, row, strict=True)) for row in zip(t, lats, lons, 0 * t, vn, ve, 0 * t, strict=True)]


def by_course(row):
    speed, course = np.hypot(row["vn_mps"], row["ve_mps"]), np.degrees(np.arctan2(row["ve_mps"], row["vn_mps"]))
    kept = {name: row[name] for name in ("t_s", "lat_deg", "lon_deg", "height_m")}
    return kept | {"speed_mps": speed, "course_deg": course % 360.0}


def without_velocity(row):
    return {name: row[name] for name in ("t_s", "lat_deg", "lon_deg", "height_m")}


def in_radians(row):
    return row | {name: np.radians(row[name]) for name in ("lat_deg", "lon_deg")}


def exchanged(row, one="lat_deg", other="lon_deg"):
    return row | {one: row[other], other: row[one]}


def said(rows):
    return misread_columns(fixes_of(rows, 0.0))


@pytest.mark.parametrize("form", [dict, by_course, without_velocity])
@pytest.mark.parametrize(("lat", "lon"), [*PLACES, (0.0, 0.0)])
def test_right_columns_are_left_alone(lat, lon, form):
    assert said([form(row) for row in drive(lat, lon)]) == ""


@pytest.mark.parametrize("form", [dict, by_course])
@pytest.mark.parametrize(("lat", "lon"), PLACES)
def test_radians_and_exchanged_axes_are_named(lat, lon, form):
    rows = [form(row) for row in drive(lat, lon)]
    assert "lat_deg and lon_deg in radians" in said(list(map(in_radians, rows)))
    if abs(lon) < 90.0:
        assert "lat_deg and lon_deg exchanged" in said(list(map(exchanged, rows)))


@pytest.mark.parametrize(("lat", "lon"), PLACES)
def test_a_velocity_of_east_and_north_is_named(lat, lon):
    rows = [exchanged(row, "vn_mps", "ve_mps") for row in drive(lat, lon)]
    assert "velocities' north and east exchanged" in said(rows)


@pytest.mark.parametrize(("lat", "lon"), PLACES)
def test_radians_without_velocities_are_asked_for_by_the_place(lat, lon):
    radians = [in_radians(without_velocity(row)) for row in drive(lat, lon)]
    assert "radians?" in said(radians)
    assert "radians?" in said([row | {"vn_mps": 0.0, "ve_mps": 0.0, "vd_mps": 0.0} for row in radians])  # never moves


@pytest.mark.parametrize("factor", [1.852, 1 / 1.852, 3.6, 0.5144])
def test_a_velocity_in_other_units_is_not_what_is_meant(factor):
    rows = [row | {name: factor * row[name] for name in ("vn_mps", "ve_mps")} for row in drive()]
    assert said(rows) == ""


def test_positions_that_stand_still_and_fixes_without_a_way_are_not_what_is_meant():
    rows = drive()
    assert said([row | {"lat_deg": 47.3, "lon_deg": 8.5} for row in rows]) == ""
    assert said(rows[:1]) == ""
    assert misread_columns(fixes_of([], 0.0)) == ""


@pytest.mark.parametrize(("change", "named"), [(in_radians, "in radians"), (exchanged, "exchanged")])
def test_a_replay_says_so_and_does_not_blame_the_velocity(change, named, tmp_path, capsys):
    rows = list(map(change, drive(seconds=60)))
    names = [name for name in FIX_COLUMNS if name in rows[0]]
    lines = [",".join(names), *(",".join(f"{row[name]:.9f}" for name in names) for row in rows)]
    (tmp_path / "gnss.csv").write_text("\n".join(lines) + "\n")
    samples = "".join(f"{i / 20},0,0,0,0,{i % 2 / 1000},-9.81\n" for i in range(1200))
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2\n"
    (tmp_path / "imu.csv").write_text(header + samples)
    tables = ("--imu", str(tmp_path / "imu.csv"), "--gnss", str(tmp_path / "gnss.csv"))
    assert main(["replay", *tables, "-o", str(tmp_path / "est.csv")]) == 0
    err = capsys.readouterr().err
    assert "gnss.csv" in err and f"lat_deg and lon_deg {named}" in err
    assert "without their velocity" not in err


@pytest.mark.parametrize(("lat", "lon", "asked"), [(139.79, 35.67, True), (139.79, 135.67, False)])
def test_a_latitude_beyond_90_degrees_may_be_the_longitude(lat, lon, asked):
    with pytest.raises(ValueError, match="outside") as refused:
        checked_fix("line 2", {"t_s": 0.0, "lat_deg": lat, "lon_deg": lon, "height_m": 0.0})
    assert ("exchanged" in str(refused.value)) == asked
