"""Recordings that the emulator plays: interpolated, looped, on its ports, and refused when they are bad."""

import math

import numpy as np
import pytest
import serial
from pynmeagps import NMEAReader
from sim_ports import GYRO_LSB, IMU_HEADER, SILENT_S, configure, emulator, lines_until, read_frames, write_recording

from imud.firmware_sim.replay import DataError, RecordedFixes, RecordedImu


def test_recorded_samples_come_as_they_are_and_when_they_were(tmp_path):
    path = write_recording(tmp_path)[0]
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    for loop, laps in ((False, 1), (True, 3)):
        imu, times, t = RecordedImu(path, loop), [], -1.0
        while (t := imu.after(t)) < 9.0:
            times.append(t)
        lap_s = 3.02  # one interval more than from the first to the last
        assert np.array(times)[: len(rows) * laps] == pytest.approx(
            np.concatenate([rows[:, 0] - rows[0, 0] + lap * lap_s for lap in range(laps)])[: len(times)]
        )
        n = min(len(times), len(rows) * laps)
        assert (imu.imu(np.array(times[:n])) == np.tile(rows[:, 1:], (laps, 1))[:n]).all()
        assert imu.end == (math.inf if loop else pytest.approx(3.0))


@pytest.mark.parametrize("loop", [False, True])
def test_recorded_fixes_keep_epoch_and_arrival(tmp_path, loop):
    imu, gnss = write_recording(tmp_path)
    fixes = RecordedFixes(gnss, RecordedImu(imu, loop))
    epochs, t = [], -1.0
    for _ in range(7 if loop else 4):
        fix = fixes.after(t, 0.2)
        if fix is None:
            break
        assert fix.arrival - fix.t == pytest.approx(0.25) and fix.hdop == 1.5
        epochs.append(t := fix.t)
    once = [0.75, 1.75, 2.75]
    assert epochs == pytest.approx([*once, 3.77, 4.77, 5.77, 6.79] if loop else once)
    assert fixes.phase == pytest.approx(0.75)


def test_velocity_columns_become_speed_and_course_and_arrival_has_a_default(tmp_path):
    imu, gnss = write_recording(tmp_path)
    gnss.write_text("height_m,lon_deg,lat_deg,t_s,vn_mps,ve_mps\n1,2,3,501,-3,4\n")
    fix = RecordedFixes(gnss, RecordedImu(imu)).after(0.0, 1.0)
    assert (fix.speed_mps, fix.course_deg) == pytest.approx((5.0, 126.8698976))
    assert fix.arrival == pytest.approx(fix.t + 0.1) and (fix.lat_deg, fix.lon_deg, fix.height_m) == (3.0, 2.0, 1.0)


def test_a_recording_comes_out_of_the_ports_and_ends(tmp_path):
    imu, gnss = write_recording(tmp_path)
    with (
        emulator("g350", "nmea@115200", "--replay", imu, gnss, "--no-fix", "0") as (_, paths),
        serial.Serial(paths["g350"], 460800, timeout=SILENT_S) as port,
        serial.Serial(paths["nmea"], 115200, timeout=0.1) as text,
    ):
        configure(port)
        words = read_frames(port, 60)
        lines = lines_until(text, b"$GPVTG", 3)
        port.timeout = 1.0
        while port.read(22_000):  # until it falls silent
            pass
    recorded = np.rint(np.loadtxt(imu, delimiter=",", skiprows=1, usecols=1) / np.radians(GYRO_LSB)).astype(int)
    first = int(np.flatnonzero(recorded == words[0, 2])[0])
    assert (words[:, 2] == recorded[first : first + 60]).all() and words[0, 2] > 0
    assert words[:, 7] == pytest.approx(-8000)
    fixes = [NMEAReader.parse(line + b"\r\n", validate=1) for line in lines if line.startswith(b"$GPGGA")]
    assert [m.lat for m in fixes] == pytest.approx([10.501, 10.502, 10.503], abs=2e-8)
    assert [m.lon for m in fixes] == pytest.approx([-20.5] * 3) and fixes[0].HDOP == 1.5
    assert [m.time.microsecond for m in fixes] == [0, 0, 0]
    assert fixes[0].alt + fixes[0].sep == pytest.approx(99.5)


@pytest.mark.parametrize("name", ["ixr-0412", "dtu-ugv4"])
def test_real_recordings_can_be_played(recordings, name):
    folder = recordings / "navigation" / name
    imu = RecordedImu(folder / "imu.csv")
    for gnss in ("gnss_rtk.csv", "gnss_nmea_grade.csv", "gnss_receiver_like.csv"):
        fixes = RecordedFixes(folder / gnss, imu)
        first = fixes.after(0.0, 1.0)
        assert 0.0 < first.t < 2.0 and first.t < first.arrival < first.t + 1.0
    assert np.linalg.norm(imu.imu(np.linspace(0.0, 10.0, 1000))[:, 3:], axis=1) == pytest.approx(9.8, abs=1.0)


@pytest.mark.parametrize(
    "text, complaint",
    [
        ("", "header must be"),
        ("t,x\n1,2\n", "header must be"),
        (IMU_HEADER + "1,2,3,4,5,6,7\n", "at least two rows"),
        (IMU_HEADER + "1,2,3,4,5,6,7\n2,2,3,x,5,6,7\n", "could not convert"),
        (IMU_HEADER + "1,2,3,4,5,6,7\n2,2,3,nan,5,6,7\n", "finite"),
        (IMU_HEADER + "1,2,3,4,5,6,7\n1,2,3,4,5,6,7\n", "time does not increase"),
    ],
)
def test_bad_inertial_files_are_reported(tmp_path, text, complaint):
    path = tmp_path / "imu.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=complaint):
        RecordedImu(path)


@pytest.mark.parametrize(
    "text, complaint",
    [
        ("", "columns missing"),
        ("t_s,lat_deg\n1,2\n", "columns missing: height_m, lon_deg"),
        ("t_s,lat_deg,lon_deg,height_m\n", "no fix lies within"),
        ("t_s,lat_deg,lon_deg,height_m\n501,a,2,3\n", "gnss.csv:2: not a fix"),
        ("t_s,lat_deg,lon_deg,height_m\n501,1,,3\n", "gnss.csv:2: not a fix"),
        ("t_s,lat_deg,lon_deg,height_m\n501,nan,2,3\n", "must be finite"),
        ("t_s,lat_deg,lon_deg,height_m\n501,1,2,3\n501,1,2,3\n", "time does not increase"),
    ],
)
def test_bad_fix_files_are_reported(tmp_path, text, complaint):
    imu, gnss = write_recording(tmp_path)
    gnss.write_text(text)
    with pytest.raises(DataError, match=complaint):
        RecordedFixes(gnss, RecordedImu(imu))
