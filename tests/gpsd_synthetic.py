"""A gpsd server with a synthetic solution that moves: `python tests/gpsd_synthetic.py --listen 127.0.0.1:2947`.

A vehicle on a circle of 50 m at 10 m/s around a known centre. Used by the tests in a process of its own, so that real
clients have something real to talk to, and by hand with cgps.
"""

import argparse
import contextlib
import math
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from imud.configuration.settings import Gpsd
from imud.drivers.fix import Satellite, Sky
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, HEIGHT_VALID, POSITION_VALID, SOLUTION
from imud.math.earth import radii
from imud.math.rotation import quat_of_euler
from imud.outputs.gpsd import GpsdServer
from imud.outputs.view import Device, View
from imud.sensors.readings import ReceiverReport

LAT_DEG, LON_DEG, HEIGHT_M, GEOID_M = 48.137154, 11.576124, 565.0, 46.0
ALL_VALID = ATTITUDE_VALID | HEADING_VALID | POSITION_VALID | HEIGHT_VALID
RADIUS_M, SPEED_MPS = 50.0, 10.0
ROLL_DEG, PITCH_DEG = -11.5, 2.0
IMU = Device("/dev/ttyUSB0", "Epson M-G350", 460800, "M-G350-PD11", "12345678", 1.7e9)
SKY = Sky(tuple(Satellite(0, k, 40 + k, 12 * k + 1, 26 + k, k <= 9) for k in range(1, 15)), 1.5, 1.2)
RECEIVER = Device("/dev/ttyUSB1", "NMEA0183", 38400, activated_s=1.7e9)


def solution(t_s: float, status: int = ALL_VALID) -> np.ndarray:
    """One row: the vehicle at time t_s."""
    row = np.zeros(1, SOLUTION)
    angle = SPEED_MPS / RADIUS_M * t_s
    meridian, prime_vertical = radii(math.radians(LAT_DEG))
    row["t_ns"] = round(t_s * 1e9)
    row["status"] = status
    row["lat"] = math.radians(LAT_DEG) + RADIUS_M * math.cos(angle) / meridian
    row["lon"] = math.radians(LON_DEG) + RADIUS_M * math.sin(angle) / (prime_vertical * math.cos(math.radians(LAT_DEG)))
    row["height"] = HEIGHT_M
    row["v"] = (-SPEED_MPS * math.sin(angle), SPEED_MPS * math.cos(angle), 0.25)
    row["q_nb"] = quat_of_euler(math.radians(ROLL_DEG), math.radians(PITCH_DEG), angle + 0.5 * math.pi)
    row["w"] = (0.001, -0.002, SPEED_MPS / RADIUS_M)
    row["f"] = (0.1, 2.0, -9.8)
    row["bg"] = (0.001, -0.002, 0.003)
    row["ba"] = (0.01, -0.02, 0.03)
    row["sigma_p"] = (1.0, 1.5, 2.5)
    row["sigma_v"] = (0.05, 0.06, 0.07)
    row["sigma_rpy"] = (0.002, 0.003, 0.01)
    row["sigma_bg"] = (1e-4, 2e-4, 3e-4)
    row["sigma_ba"] = (1e-3, 2e-3, 3e-3)
    if not status & POSITION_VALID:
        for name in ("lat", "lon", "height", "v", "sigma_p", "sigma_v"):
            row[name] = math.nan
    return row


def view(t_s: float, utc_s: float | None, seq: int, attitude_only: bool = False) -> View:
    """What the daemon would publish at t_s."""
    status = ATTITUDE_VALID if attitude_only else ALL_VALID
    return View(
        solution=solution(t_s, status).tobytes(),
        utc_s=utc_s,
        utc_error_s=0.001,
        t_mono_ns=round(t_s * 1e9),
        seq=seq,
        estimator="attitude" if attitude_only else "navigation",
        devices=(IMU,) if attitude_only else (IMU, RECEIVER),
        gnss=None if attitude_only else ReceiverReport(9, 0.9, 1, HEIGHT_M - GEOID_M, GEOID_M, 0.1, SKY),
        temperature=31.5,
        sensed=(0.002, -0.004, 0.203, 0.11, 1.98, -9.77),
    )


def serve(settings: Gpsd, publish_hz: float, attitude_only: bool) -> None:
    """Run until SIGTERM; the first line on stdout says where."""
    poller = select.poll()
    server = GpsdServer(settings, poller)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    print(*server.addresses, flush=True)
    start, offset, seq = time.monotonic(), time.time() - time.monotonic(), 0
    try:
        while True:
            now = time.monotonic()
            due = start + seq / publish_hz
            if now >= due:
                seq = max(seq + 1, int((now - start) * publish_hz))
                server.publish(view(now - start, now + offset, seq, attitude_only), round(now * 1e9))
            for fd, mask in poller.poll(max(0.0, start + seq / publish_hz - time.monotonic()) * 1e3):
                server.on_event(fd, mask, round(now * 1e9))
            server.tick(round(now * 1e9))
    finally:
        server.close()


@contextlib.contextmanager
def running(*arguments: str) -> Iterator[str]:
    """The server in a process of its own; yields its address."""
    command = [sys.executable, str(Path(__file__)), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            address = process.stdout.readline().strip()
            assert address, "the server did not start"
            yield address
        finally:
            process.terminate()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--listen", default="127.0.0.1:0")
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--publish-hz", type=float, default=100.0)
    parser.add_argument("--max-clients", type=int, default=64)
    parser.add_argument("--attitude-only", action="store_true")
    given = parser.parse_args()
    settings = Gpsd(listen=given.listen, rate_hz=given.rate, max_clients=given.max_clients)
    serve(settings, given.publish_hz, given.attitude_only)


if __name__ == "__main__":
    main()
