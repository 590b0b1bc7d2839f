"""`imud replay` as a command: the CSV contract, determinism, and that nothing is used before it was known."""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from imud.commands import main
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.scenarios import SCENARIOS

RATE_HZ = 100
SECONDS = 60


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A noiseless drive: imu.csv, gnss.csv (0.2 s late), track.nmea, and the truth."""
    folder = tmp_path_factory.mktemp("drive")
    trajectory = Trajectory(SCENARIOS["car"](0.0, 0.0, 0.0), 35.6586, 139.7454, 40.0)
    t = np.arange(0, SECONDS, 1 / RATE_HZ)
    samples = np.column_stack([t + 1000.0, trajectory.imu(t)])
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    np.savetxt(folder / "imu.csv", samples, delimiter=",", header=header, comments="", fmt="%.9f")
    epochs = np.arange(1.0, SECONDS - 1)
    truth = trajectory.at(epochs)
    speed = np.hypot(*truth.v_n[:, :2].T)
    course = np.degrees(np.arctan2(truth.v_n[:, 1], truth.v_n[:, 0])) % 360
    with (folder / "gnss.csv").open("w") as file:
        print("t_s,arrival_s,lat_deg,lon_deg,height_m,hdop,speed_mps,course_deg", file=file)
        for k, e in enumerate(epochs):
            lat, lon = np.degrees(truth.lat[k]), np.degrees(truth.lon[k])
            print(
                f"{e + 1000},{e + 1000.2},{lat:.9f},{lon:.9f},{truth.height[k]:.3f},0.9,{speed[k]:.3f},{course[k]:.2f}",
                file=file,
            )
    with (folder / "track.nmea").open("w") as file:
        for k, e in enumerate(epochs):
            file.write(
                sentences(
                    e + 1000, np.degrees(truth.lat[k]), np.degrees(truth.lon[k]), truth.height[k], speed[k], course[k]
                )
            )
    return folder, trajectory


def sentences(t, lat, lon, height, speed, course):
    def dm(angle, width):
        return f"{int(abs(angle)):0{width}d}{(abs(angle) % 1) * 60:09.6f}"

    clock = f"{int(t // 3600):02d}{int(t % 3600 // 60):02d}{t % 60:06.3f}"
    bodies = (
        f"GPGGA,{clock},{dm(lat, 2)},N,{dm(lon, 3)},E,1,8,0.90,{height - 36.0:.3f},M,36.000,M,,",
        f"GPVTG,{course:.2f},T,,M,{speed / 0.514444:.3f},N,{speed * 3.6:.3f},K,A",
    )
    return "".join(f"${b}*{np.bitwise_xor.reduce(np.frombuffer(b.encode(), np.uint8)):02X}\r\n" for b in bodies)


def replay(*arguments, piped=None):
    return subprocess.run(
        [sys.executable, "-m", "imud", "replay", *map(str, arguments)], capture_output=True, check=False,
        env={**os.environ, "NO_COLOR": "1"}, input=piped,
    )  # fmt: skip


def rows(path):
    with path.open() as file:
        return [{k: float(v) if v else None for k, v in row.items()} for row in csv.DictReader(file)]


def metres_off(row, trajectory):
    truth = trajectory.at(np.array([row["t_s"] - 1000.0]))
    north = np.radians(row["lat_deg"]) - truth.lat[0]
    east = (np.radians(row["lon_deg"]) - truth.lon[0]) * np.cos(truth.lat[0])
    return 6.37e6 * float(np.hypot(north, east)), np.degrees(truth.rpy[0])


@pytest.mark.parametrize("gnss", ["gnss.csv", "track.nmea"])
def test_a_drive_is_followed_with_csv_and_nmea_fixes(drive, tmp_path, gnss):
    folder, trajectory = drive
    out = tmp_path / "est.csv"
    ended = replay("--imu", folder / "imu.csv", "--gnss", folder / gnss, "-o", out)
    assert ended.returncode == 0, ended.stderr
    estimates = rows(out)
    assert len(estimates) == SECONDS * RATE_HZ
    off, rpy = metres_off(estimates[-1], trajectory)
    assert off < 1.0
    for name, angle in zip(("roll_deg", "pitch_deg", "yaw_deg"), rpy, strict=True):
        assert abs((estimates[-1][name] - angle + 180) % 360 - 180) < 1.0
    assert all(estimates[-1][name] > 0.0 for name in ("sn_m", "svn_mps", "syaw_deg", "sbgx_radps"))


def test_the_same_input_gives_the_same_bits_through_pipes_too(drive, tmp_path):
    folder, _ = drive
    samples, arguments = folder / "imu.csv", ("--gnss", folder / "gnss.csv", "--rate", "10")
    assert replay("--imu", samples, *arguments, "-o", tmp_path / "a.csv").returncode == 0
    printed = replay("--imu", "-", *arguments, "-o", "-", piped=samples.read_bytes())
    assert printed.stdout == (tmp_path / "a.csv").read_bytes()
    assert len(printed.stdout.splitlines()) == SECONDS * 10 + 1


def test_a_fix_is_not_used_before_it_arrived(drive, tmp_path):
    """Cutting the fixes after some time must not change anything before the first missing one's arrival."""
    folder, _ = drive
    lines = (folder / "gnss.csv").read_text().splitlines()
    (tmp_path / "cut.csv").write_text("\n".join(lines[:31]) + "\n")
    replay("--imu", folder / "imu.csv", "--gnss", folder / "gnss.csv", "-o", tmp_path / "all.csv")
    replay("--imu", folder / "imu.csv", "--gnss", tmp_path / "cut.csv", "-o", tmp_path / "some.csv")
    everything, some = ((tmp_path / n).read_text().splitlines()[1:] for n in ("all.csv", "some.csv"))
    first = next(k for k, (a, b) in enumerate(zip(everything, some, strict=True)) if a != b)
    assert float(everything[first].split(",")[0]) == pytest.approx(1000.0 + 31.2, abs=1.5 / RATE_HZ)


def test_fixes_that_arrive_too_late_to_be_used_are_said(drive, tmp_path):
    folder, _ = drive
    lines = (folder / "gnss.csv").read_text().splitlines()
    late = tmp_path / "late.csv"
    rows = [line.split(",") for line in lines[1:]]
    late.write_text("\n".join([lines[0], *(",".join([r[0], str(float(r[0]) + 5.0), *r[2:]]) for r in rows)]) + "\n")
    result = replay("--imu", folder / "imu.csv", "--gnss", late, "-o", tmp_path / "est.csv")
    assert b"its fixes arrive 5.0 s after their t_s" in result.stderr


def test_without_fixes_attitude_only(drive, tmp_path):
    folder, _ = drive
    ended = replay("--imu", folder / "imu.csv", "-o", tmp_path / "est.csv", "--rate", "5")
    assert ended.returncode == 0, ended.stderr
    estimates = rows(tmp_path / "est.csv")
    assert estimates[-1]["lat_deg"] is None
    assert estimates[-1]["svn_mps"] is None
    assert abs(estimates[20]["roll_deg"]) < 0.3


def test_a_given_start_needs_no_alignment(drive, tmp_path):
    folder, trajectory = drive
    start = trajectory.at(np.array([0.0]))
    initial = ",".join(
        f"{name}={value:.9f}"
        for name, value in zip(
            ("lat_deg", "lon_deg", "height_m", "yaw_deg"),
            (*np.degrees([start.lat[0], start.lon[0]]), start.height[0], np.degrees(start.rpy[0, 2])), strict=True,
        )
    )  # fmt: skip
    out = tmp_path / "est.csv"
    ended = replay("--imu", folder / "imu.csv", "--gnss", folder / "gnss.csv", "-o", out, "--initial", initial)
    assert ended.returncode == 0, ended.stderr
    early = rows(out)[2 * RATE_HZ]
    off, rpy = metres_off(early, trajectory)
    assert off < 2.0
    assert abs((early["yaw_deg"] - rpy[2] + 180) % 360 - 180) < 2.0


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("-o", "/nonexistent/est.csv"), 73, b"/nonexistent/est.csv"),
        (("-o", "-", "--gnss", "/nonexistent.csv"), 66, b"/nonexistent.csv"),
        (("-o", "-", "--gnss", "{imu}"), 65, b"lat_deg"),
        (("-o", "{imu}"), 73, b"overwritten"),
        (("-o", "{imu}", "--aiding", "heading={imu}", "--imu", "/dev/null"), 73, b"overwritten"),
        (("-o", "{imu}", "--config", "{imu}", "--imu", "/dev/null"), 73, b"overwritten"),
        (("-o", "/tmp/est.csv", "--innovations", "/tmp/../tmp/est.csv"), 73, b"written twice"),
        (("-o", "-", "--imu", "{long}"), 65, b"t_s is 1111111111"),
        (("-o", "-", "--estimator", "magic"), 64, b"magic"),
        (("-o", "-", "--initial", "yaw=3"), 78, b"--initial"),
        (("-o", "-", "--rate", "0"), 64, b"--rate"),
        (("-o", "-", "--set", "navigation.vehicle=boat"), 78, b"navigation.vehicle"),
    ],
)
def test_errors_are_reported(drive, arguments, code, says):
    folder, _ = drive
    header = (folder / "imu.csv").read_text().partition("\n")[0]
    (folder / "long.csv").write_text(f"{header}\n{'1' * 50_000}{',0' * 6}\n")
    names = {"imu": folder / "imu.csv", "long": folder / "long.csv"}
    ended = replay("--imu", folder / "imu.csv", *(a.format(**names) for a in arguments))
    assert ended.returncode == code, ended.stderr
    assert says in ended.stderr
    assert b"Traceback" not in ended.stderr
    assert len(ended.stderr) < 2000


def test_an_output_stays_as_it_was_if_an_input_is_bad(drive, tmp_path):
    folder, _ = drive
    (tmp_path / "heading.csv").write_text("no,heading\n1,2\n")
    (tmp_path / "est.csv").write_text("of an earlier run")
    inputs = ("--imu", folder / "imu.csv", "--gnss", folder / "gnss.csv")
    for more in (("--aiding", f"heading={tmp_path / 'heading.csv'}"), ("--calibration", folder / "imu.csv")):
        assert replay(*inputs, *more, "-o", tmp_path / "est.csv").returncode == 65
        assert (tmp_path / "est.csv").read_text() == "of an earlier run"


def test_an_axis_that_was_not_recorded_is_said(drive, tmp_path):
    folder, _ = drive
    header, *lines = (folder / "imu.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines]
    table = tmp_path / "imu.csv"
    table.write_text("\n".join([header, *(",".join([*r[:3], "0", *r[4:]]) for r in rows)]) + "\n")
    assert b"gyro z never changes" in replay("--imu", table, "-o", tmp_path / "est.csv").stderr
    assert b"never changes" not in replay("--imu", folder / "imu.csv", "-o", tmp_path / "est.csv").stderr


def test_rates_of_a_car_in_degrees_are_asked_about(drive, tmp_path):
    """Gravity does not show it: the car turns about the vertical, and just has no heading."""
    folder, _ = drive
    samples = np.loadtxt(folder / "imu.csv", delimiter=",", skiprows=1)
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    samples[:, 1:4] = np.degrees(samples[:, 1:4])
    np.savetxt(tmp_path / "imu.csv", samples, delimiter=",", header=header, comments="", fmt="%.9f")
    inputs = ("--gnss", folder / "gnss.csv", "-o", tmp_path / "est.csv")
    assert b"is it in rad/s?" in replay("--imu", tmp_path / "imu.csv", *inputs).stderr
    assert b"rad/s" not in replay("--imu", folder / "imu.csv", *inputs).stderr


def test_what_the_sensor_monitor_finds_is_said(drive, tmp_path):
    folder, _ = drive
    samples = np.loadtxt(folder / "imu.csv", delimiter=",", skiprows=1)
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    samples[3000:3100, 4] = 1e6
    np.savetxt(tmp_path / "imu.csv", samples, delimiter=",", header=header, comments="", fmt="%.9f")
    ended = replay("--imu", tmp_path / "imu.csv", "-o", tmp_path / "est.csv")
    assert ended.returncode == 0
    assert b"accelerometer x impossible (100 samples)" in ended.stderr


def test_options_of_recordings_and_of_tables_are_not_ignored_with_the_other(tmp_path, capsys):
    table, recording, out = (
        tmp_path / "imu.csv",
        Path(__file__).parent / "corpus/recordings/json.mcap",
        tmp_path / "out",
    )
    table.write_text("t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2\n0,0,0,0,0,0,-9.8\n0.01,0,0,0,0,0,-9.8\n")
    for option in (("--cluster", "localhost:1"), ("--jobs", "2")):
        assert main(["replay", "--imu", str(table), *option, "-o", str(out)]) == 64
        assert option[0] in capsys.readouterr().err
    for option in (("--aiding", f"heading={table}"), ("--gnss-offset", "-18")):
        assert main(["replay", str(recording), *option, "-o", str(out)]) == 64
        assert "--gnss-offset and --aiding are for tables: give tables or recordings" in capsys.readouterr().err
    assert not out.exists()


def test_replay_prints_what_the_filter_has_found_of_the_receiver(drive, tmp_path):
    """Its velocity is that of the fix before, a second earlier."""
    folder, _ = drive
    header, *lines = (folder / "gnss.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines]
    late = [",".join([*row[:6], *before[6:]]) for before, row in zip(rows[:1] + rows, rows, strict=False)]
    (tmp_path / "gnss.csv").write_text("\n".join([header, *late]) + "\n")
    for fixes, is_late in ((tmp_path / "gnss.csv", True), (folder / "gnss.csv", False)):
        printed = replay("--imu", folder / "imu.csv", "--gnss", fixes, "-o", tmp_path / "est.csv").stderr
        assert (b"velocity lags behind its positions" in printed) == is_late


@pytest.mark.parametrize("log", ["gnss.csv", "track.nmea"])
def test_clocks_that_differ_by_seconds_are_found_by_the_turns(drive, tmp_path, log):
    """The positions are then those of another time, and no heading fits them: the filter compares a second or two."""
    folder, _ = drive
    samples = np.loadtxt(folder / "imu.csv", delimiter=",", skiprows=1)
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    for late_s, found in ((0.0, None), (1.0, None), (6.0, b"6 s behind"), (-8.0, b"8 s ahead of")):
        samples[:, 0] += late_s
        np.savetxt(tmp_path / "imu.csv", samples, delimiter=",", header=header, comments="", fmt="%.9f")
        samples[:, 0] -= late_s
        ended = replay("--imu", tmp_path / "imu.csv", "--gnss", folder / log, "-o", tmp_path / "est.csv", "--rate", 1)
        assert ended.returncode == 0
        assert (b"by the turns in both" in ended.stderr) == (found is not None)
        assert found is None or found in ended.stderr


def _option_named(ended):
    return re.search(rb"wrong; (--gnss-offset=\S+) corrects that", ended.stderr)[1].decode()


@pytest.mark.parametrize("log", ["gnss.csv", "track.nmea"])
def test_the_option_that_the_warning_names_corrects_the_clocks(drive, tmp_path, log):
    """Also if an offset that was given before is wrong; the estimates are then those of one clock."""
    folder, _ = drive
    tables = ("--imu", folder / "imu.csv", "--gnss", folder / log)
    last = []
    for given in ((), ("--gnss-offset", "-7.5")):
        ended = replay(*tables, *given, "-o", tmp_path / "est.csv", "--rate", 1)
        last.append((tmp_path / "est.csv").read_text().splitlines()[-1])
    option = _option_named(ended)
    assert abs(float(option.partition("=")[2])) <= 0.25, "as near as differences are compared"
    ended = replay(*tables, option, "-o", tmp_path / "est.csv", "--rate", 1)
    assert (ended.returncode, b"by the turns in both" in ended.stderr) == (0, False)
    right, wrong, corrected = (
        np.array(line.split(",")[1:3], float) for line in (*last, (tmp_path / "est.csv").read_text().splitlines()[-1])
    )
    error_m = 1.1e5 * np.abs([corrected - right, wrong - right]).max(axis=1)
    assert error_m[0] < 5.0
    assert error_m[1] > 20.0


@pytest.mark.parametrize("sign", ["", "-"])
def test_the_option_that_the_warning_names_has_all_digits(drive, tmp_path, sign):
    """GPS time and Unix time, each as seconds since its beginning, are 315964800 s less 18 leap seconds apart."""
    folder, _ = drive
    samples = np.loadtxt(folder / "imu.csv", delimiter=",", skiprows=1)
    samples[:, 0] += float(f"{sign}315964782")
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    np.savetxt(tmp_path / "imu.csv", samples, delimiter=",", header=header, comments="", fmt="%.9f")
    tables = ("--imu", tmp_path / "imu.csv", "--gnss", folder / "gnss.csv", "-o", tmp_path / "est.csv", "--rate", 1)
    option = _option_named(replay(*tables, f"--gnss-offset={sign}315964800"))
    assert option == f"--gnss-offset={sign}315964782"
    ended = replay(*tables, option)
    assert (ended.returncode, b"by the turns in both" in ended.stderr) == (0, False)


def test_an_offset_of_the_fixes_needs_a_table_of_fixes(tmp_path, capsys):
    table = tmp_path / "imu.csv"
    table.write_text("t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2\n0,0,0,0,0,0,-9.8\n0.01,0,0,0,0,0,-9.8\n")
    assert main(["replay", "--imu", str(table), "--gnss-offset", "18", "-o", str(tmp_path / "out")]) == 64
    assert "--gnss, which is missing" in capsys.readouterr().err
    for wrong in ("nan", "inf", "1s"):
        with pytest.raises(SystemExit, match="64"):
            main(["replay", "--imu", str(table), "--gnss-offset", wrong, "-o", str(tmp_path / "out")])
