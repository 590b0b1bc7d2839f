"""Emulated devices on their ports, in real time: the inertial sensor, the receiver, and the truth beside them."""

import math
import os
import signal
import time
from datetime import UTC, datetime

import numpy as np
import pytest
import serial
from pynmeagps import NMEAReader
from sim_ports import (
    ACCEL_LSB,
    GYRO_LSB,
    SILENT_S,
    answer_behind_frames,
    configure,
    emulator,
    lines_until,
    read_frames,
    write_recording,
)

from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.scenarios import SCENARIOS


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


@pytest.mark.thorough
def test_a_recording_is_played_as_fast_as_it_is_read_and_no_faster(tmp_path):
    imu, _ = write_recording(tmp_path, seconds=300.0)
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
            first = new_sample(port)
        with serial.Serial(paths["g350"], 460800, timeout=SILENT_S) as port:
            second = new_sample(port)
    assert first[19:21] != second[19:21]


def new_sample(port):
    """The first answer whose flags say that all in it is new; a new sample comes every millisecond."""
    for _ in range(1000):
        port.write(bytes.fromhex("20000D"))
        frame = port.read(22)
        assert len(frame) == 22 and frame[0] == 0x20 and frame[21] == 0x0D
        if frame[1:3] == b"\xfe\x00":
            return frame
        assert frame[1:3] == b"\x00\x00"
    raise AssertionError("nothing new")


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


def test_the_receiver_sends_time_and_position():
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
