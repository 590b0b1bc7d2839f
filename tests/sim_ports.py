"""The emulator as a process, its ports opened with pyserial, and a recording for it to play."""

import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
GYRO_LSB, ACCEL_LSB = 0.0125, 0.125e-3 * 9.80665  # deg/s, m/s^2
SILENT_S = 120.0  # against hanging


@contextmanager
def emulator(*arguments):
    """A running emulator and the paths it printed, by device name."""
    words = [str(argument) for argument in arguments]
    devices = [word for word in words if word.partition("@")[0] in ("g350", "nmea")]
    command = [sys.executable, "-m", "imud.firmware_sim", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        lines = [process.stdout.readline().split() for _ in devices]
        assert all(len(line) == 2 for line in lines), process.stderr.read()
        yield process, dict(lines)
    finally:
        process.kill()
        process.communicate()


def run(*arguments):
    command = [sys.executable, "-m", "imud.firmware_sim", *map(str, arguments)]
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
