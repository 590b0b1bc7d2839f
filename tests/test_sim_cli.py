"""The emulator as its users meet it: a process, ports opened with pyserial, recordings, truth, exit codes."""

import ast
import math
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import serial
from pynmeagps import NMEAReader

from firmware_sim.motion import Trajectory
from firmware_sim.replay import DataError, RecordedFixes, RecordedImu
from firmware_sim.scenarios import SCENARIOS

ROOT = Path(__file__).resolve().parents[1]
GYRO_LSB, ACCEL_LSB = 0.0125, 0.125e-3 * 9.80665  # deg/s, m/s^2
SILENT_S = 120.0  # against hanging


@contextmanager
def emulator(*arguments):
    """A running emulator and the paths it printed, by device name."""
    words = [str(argument) for argument in arguments]
    devices = [word for word in words if word.partition("@")[0] in ("g350", "nmea")]
    command = [sys.executable, "-m", "firmware_sim", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        lines = [process.stdout.readline().split() for _ in devices]
        assert all(len(line) == 2 for line in lines), process.stderr.read()
        yield process, dict(lines)
    finally:
        process.kill()
        process.communicate()


def run(*arguments):
    command = [sys.executable, "-m", "firmware_sim", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)


def read_word(port, address):
    port.write(bytes([address, 0, 0x0D]))
    answer = port.read(4)
    assert len(answer) == 4 and answer[0] == address and answer[3] == 0x0D, answer
    return int.from_bytes(answer[1:3], "big")


def answer_behind_frames(port, command):
    """The answer of four bytes to a command, after the frames that are still to come."""
    port.write(bytes.fromhex(command))
    while (head := port.read(1)) == b"\x20":
        assert port.read(21)[20:] == b"\x0d"
    return head + port.read(3)


def configure(port, rate_code=1, auto=True):
    while read_word(port, 0x3E) & 0x0400:
        time.sleep(0.02)
    for command in (f"B7{rate_code:02X}0D", f"B8{rate_code:02X}0D", f"BA{auto:02X}0D", "D0010D", "B9010D"):
        port.write(bytes.fromhex(command))


def read_frames(port, n):
    data = b""
    while len(data) < n * 22:
        more = port.read(n * 22 - len(data))
        assert more, f"silent after {len(data)} bytes"
        data += more
    frames = [data[i : i + 22] for i in range(0, len(data), 22)]
    assert all(frame[0] == 0x20 and frame[21] == 0x0D for frame in frames)
    return np.array([np.frombuffer(frame[1:21], dtype=">i2") for frame in frames])


def lines_until(port, start, n):
    """All whole lines up to the n-th that begins with `start`."""
    text, end = b"", time.monotonic() + SILENT_S
    while sum(line.startswith(start) for line in text.split(b"\r\n")[:-1]) < n:
        assert time.monotonic() < end, text
        text += port.read(max(1, port.in_waiting))
    return text.split(b"\r\n")[:-1]


# --- the inertial sensor on a port ---


def test_a_stream_without_gaps_and_with_the_attitude_asked_for(tmp_path):
    link = tmp_path / "imu"
    with emulator(
        *("g350", "--link", link, "--roll-deg", 10, "--pitch-deg", -5),
        *("--ideal", "--gyro-bias-dps", "0.3,0.3,0.3", "--patient"),
    ) as (_, paths):
        assert paths["g350"] == str(link) and link.is_symlink()
        with serial.Serial(str(link), 460800, timeout=SILENT_S, exclusive=True) as port:
            configure(port)
            words = read_frames(port, 3000)
            answer = answer_behind_frames(port, "B9020D38000D")
            assert len(answer) == 4 and answer[0] == 0x38 and answer[1] & 0x04
    assert set(np.diff(words[:, 9].astype(np.uint16))) == {2}
    forces = words[:, 5:8].mean(axis=0) * ACCEL_LSB
    roll, pitch = math.atan2(-forces[1], -forces[2]), math.atan2(forces[0], math.hypot(forces[1], forces[2]))
    assert np.degrees([roll, pitch]) == pytest.approx([10.0, -5.0], abs=0.01)
    assert words[:, 2:5].mean(axis=0) * GYRO_LSB == pytest.approx([0.3] * 3, abs=0.0125)


def test_a_recording_is_played_as_fast_as_it_is_read_and_no_faster(tmp_path):
    imu, _ = write_recording(tmp_path, seconds=20.0)
    with emulator("g350", "--replay", imu, "--fast") as (_, paths), serial.Serial(paths["g350"], 460800) as port:
        port.timeout = SILENT_S
        configure(port)
        time.sleep(1.0)  # more than a pseudo-terminal holds is due by now, and waits
        words = read_frames(port, 12000)
    assert set(np.diff(words[:, 9].astype(np.uint16))) == {2}


def test_what_a_stall_delays_is_caught_up():
    with (
        emulator("g350", "--patient") as (process, paths),
        serial.Serial(paths["g350"], 460800, timeout=SILENT_S) as port,
    ):
        configure(port)
        before = read_frames(port, 200)
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.2)
        process.send_signal(signal.SIGCONT)
        counts = np.concatenate([before, read_frames(port, 500)])[:, 9].astype(np.uint16)
    assert set(np.diff(counts)) == {2}


def test_polled_bursts_and_reopening():
    with emulator("g350", "--ideal") as (_, paths):
        with serial.Serial(paths["g350"], 460800, timeout=SILENT_S) as port:
            configure(port, auto=False)
            time.sleep(0.05)
            port.write(bytes.fromhex("20000D"))
            first = port.read(22)
        time.sleep(0.05)  # a new sample comes every millisecond
        with serial.Serial(paths["g350"], 460800, timeout=SILENT_S) as port:
            port.write(bytes.fromhex("20000D"))
            second = port.read(22)
    for frame in (first, second):
        assert len(frame) == 22 and frame[0] == 0x20 and frame[21] == 0x0D
    assert first[1:3] == second[1:3] == b"\xfe\x00" and first[19:21] != second[19:21]


def test_the_wrong_baud_rate_is_garbage_and_the_right_one_is_not():
    with emulator("g350@230400") as (_, paths), serial.Serial(paths["g350"], 230400, timeout=SILENT_S) as port:
        configure(port)
        read_frames(port, 10)
        port.baudrate = 460800
        time.sleep(0.1)
        port.reset_input_buffer()
        garbled = port.read(2200)
        assert len(garbled) > 500 and garbled.count(b"\x20\xfe\x00") < 5
        port.baudrate = 230400
        time.sleep(0.1)
        port.reset_input_buffer()
        data = port.read(4400)
        assert data.count(b"\x20\xfe\x00") > 190


def test_the_device_vanishes_when_the_emulator_ends():
    with emulator("g350") as (process, paths):
        descriptor = os.open(paths["g350"], os.O_RDWR | os.O_NOCTTY)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
        try:
            assert os.read(descriptor, 100) == b""
        except OSError as error:
            assert error.errno == 5  # EIO: both are an unplugged port
        os.close(descriptor)


# --- the receiver on a port ---


def test_the_receiver_tells_the_time_and_the_place():
    before = time.time()
    with (
        emulator("nmea@38400", "--ideal", "--no-fix", "0.5", "--rate", 5) as (_, paths),
        serial.Serial(paths["nmea"], 38400, timeout=0.1) as port,
    ):
        lines = lines_until(port, b"$GPRMC", 12)
    messages = [NMEAReader.parse(line + b"\r\n", validate=1) for line in lines if line.startswith(b"$GPRMC")]
    fixes = [m for m in messages if m.status == "A"]
    assert len(fixes) > 5
    assert (fixes[-1].lat, fixes[-1].lon) == pytest.approx((35.6586, 139.7454), abs=1e-7)
    stamps = [datetime.combine(m.date, m.time, UTC).timestamp() for m in fixes]
    assert before < stamps[0] and stamps[-1] < time.time()  # UTC is the host's
    assert np.diff(stamps) == pytest.approx(0.2)


def test_commands_through_the_port():
    with (
        emulator("nmea", "--no-fix", "inf") as (_, paths),
        serial.Serial(paths["nmea"], 9600, timeout=0.1) as port,
    ):
        port.write(b"$PMTK251,115200*1F\r\n")
        lines_until(port, b"$PMTK001,251,3*36", 1)
        port.baudrate = 115200
        lines = lines_until(port, b"$GPGGA,2359", 2)
    assert sum(b",8960.000000,N," in line for line in lines) >= 2


# --- motion, truth, repetition ---


def test_truth_is_written_as_it_happens(tmp_path):
    truth = tmp_path / "truth.csv"
    before = time.monotonic()
    with emulator("g350", "--scenario", "car", "--truth", truth):
        while len(text := truth.read_text()) < 60_000:  # about six seconds; grows while the emulator runs
            time.sleep(0.1)
        now = time.monotonic()
    assert text.endswith("\n")
    header, *rows = text.splitlines()
    assert header == "t_mono_s,lat_deg,lon_deg,height_m,vn_mps,ve_mps,vd_mps,roll_deg,pitch_deg,yaw_deg"
    table = np.array([[float(x) for x in row.split(",")] for row in rows])
    assert before < table[0, 0] and table[-1, 0] < now
    assert np.diff(table[:, 0]) == pytest.approx(0.01, abs=2e-6)
    x = Trajectory(SCENARIOS["car"](0, 0, 0), 35.6586, 139.7454, 60.0).at(table[:, 0] - table[0, 0])
    assert table[:, 1] == pytest.approx(np.degrees(x.lat), abs=2e-9)
    assert table[:, 4:7] == pytest.approx(x.v_n, abs=1e-4)
    assert table[:, 7:] == pytest.approx(np.degrees(x.rpy), abs=1e-4)
    assert len(table) > 500 and np.linalg.norm(table[-1, 4:7]) > 0.0


# --- recordings ---

IMU_HEADER = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2\n"


def write_recording(folder, seconds=3.0, gnss="t_s,lat_deg,lon_deg,height_m,arrival_s,hdop,speed_mps,course_deg\n"):
    t = 500.25 + np.arange(0.0, seconds + 1e-9, 0.02)
    ramp = np.radians(100.0) * (t - 500.25)
    rows = [f"{a:.6f},{b:.9f},0,0,0,0,-9.80665\n" for a, b in zip(t, ramp, strict=True)]
    imu, fixes = folder / "imu.csv", folder / "gnss.csv"
    imu.write_text(IMU_HEADER + "".join(rows))
    fixes.write_text(
        gnss + "".join(f"{s},{10 + s / 1000:.9f},-20.5,99.5,{s + 0.25},1.5,5,90\n" for s in range(501, 504))
    )
    return imu, fixes


def test_recorded_rates_are_interpolated(tmp_path):
    imu = RecordedImu(write_recording(tmp_path)[0])
    t = np.linspace(0.0, 3.0, 977)
    assert imu.imu(t)[:, 0] == pytest.approx(np.radians(100.0) * t, abs=1e-6) and imu.end == pytest.approx(3.0)
    again = RecordedImu(write_recording(tmp_path)[0], loop=True)
    assert again.imu(t + 9.0) == pytest.approx(imu.imu(np.where(t < 3.0 - 1e-6, t, 0.0)), abs=1e-5)
    assert again.end == math.inf


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
    assert epochs == pytest.approx([*once, 3.75, 4.75, 5.75, 6.75] if loop else once)
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
        words = read_frames(port, 1000)
        lines = lines_until(text, b"$GPVTG", 3)
        port.timeout = 1.0
        while port.read(22_000):  # until it falls silent
            pass
    ramp = words[:, 2] * GYRO_LSB
    assert np.diff(ramp)[::2].mean() == pytest.approx(0.1, abs=0.002)  # 100 deg/s^2 at 1 kHz
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
def test_bad_inertial_files_say_why(tmp_path, text, complaint):
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
def test_bad_fix_files_say_why(tmp_path, text, complaint):
    imu, gnss = write_recording(tmp_path)
    gnss.write_text(text)
    with pytest.raises(DataError, match=complaint):
        RecordedFixes(gnss, RecordedImu(imu))


# --- life cycle ---


@pytest.mark.parametrize("number, code", [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_it_ends_cleanly_and_takes_its_links_along(tmp_path, number, code):
    links = [tmp_path / "imu", tmp_path / "gps"]
    with emulator("g350", "nmea", "--link", links[0], "--link", links[1]) as (process, _):
        assert all(link.is_symlink() for link in links)
        process.send_signal(number)
        assert process.wait(60) == code
        assert "Traceback" not in process.stderr.read()
    assert list(tmp_path.iterdir()) == []


def test_seconds_end_it():
    done = run("nmea", "--seconds", "0.2")
    assert done.returncode == 0 and done.stdout.startswith("nmea /dev/pts/")


def test_an_old_link_is_replaced_and_another_ones_link_is_left(tmp_path):
    link = tmp_path / "imu"
    link.symlink_to("/dev/null")
    with emulator("g350", "--link", link) as (process, _):
        assert link.readlink() != Path("/dev/null")
        link.unlink()
        link.symlink_to("/dev/zero")
        process.terminate()
        assert process.wait(60) == 0
    assert link.readlink() == Path("/dev/zero")


@pytest.mark.parametrize(
    "arguments, code, complaint",
    [
        ([], 64, "DEVICE"),
        (["rga"], 64, "a device is g350 or nmea"),
        (["g350@1200"], 64, "one of 4800"),
        (["g350", "--scenario", "train"], 64, "invalid choice"),
        (["g350", "--gyro-bias-dps", "1,2"], 64, "three numbers"),
        (["g350", "--seconds", "nan"], 64, "time in seconds"),
        (["nmea", "--rate", "10"], 64, "1 to 5 fixes"),
        (["g350", "--link", "a", "--link", "b"], 64, "more --link than devices"),
        (["g350", "g350", "--link", "a", "--link", "a"], 64, "same --link"),
        (["g350", "--loop"], 64, "--loop goes with --replay"),
        (["nmea", "--replay", "IMU"], 64, "needs a gnss.csv"),
        (["g350", "--replay", "IMU", "--truth", "t.csv"], 64, "knows no truth"),
        (["g350", "--replay", "absent.csv"], 66, "absent.csv: No such file"),
        (["g350", "--replay", "BAD"], 65, "header must be"),
        (["g350", "--link", "/absent/imu"], 73, "/absent/imu: No such file"),
        (["g350", "--link", "BAD"], 73, "exists and is not a link"),
        (["g350", "--truth", "/absent/t.csv"], 73, "/absent/t.csv: No such file"),
    ],
)
def test_misuse_is_told_and_has_its_exit_code(tmp_path, arguments, code, complaint):
    bad = tmp_path / "bad"
    bad.write_text("not,this\n")
    names = {"IMU": write_recording(tmp_path)[0], "BAD": bad}
    done = run(*[names.get(argument, argument) for argument in arguments], "--seconds=1")
    assert done.returncode == code
    assert complaint in done.stderr and "Traceback" not in done.stderr and done.stdout == ""


# --- the house ---


def test_the_emulator_shares_no_code_with_what_it_tests():
    allowed = set(sys.stdlib_module_names) | {"numpy", "firmware_sim"}
    for path in sorted((ROOT / "firmware_sim").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module]
            assert {name.partition(".")[0] for name in names} <= allowed, f"{path.name}:{getattr(node, 'lineno', 0)}"
