"""Is the same receiver better with UBX than with NMEA? Simulated drives, as a table in Markdown.

    python tests/receiver_protocols.py [--runs 40] [--seconds 300]

Each run has an inertial sensor, a motion and a receiver of its own. The receiver's emulator speaks both protocols as it
does by default: NMEA once per second, UBX five times. Errors are RMS while the heading is valid in both.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from emulated import Emulated
from replay_in_process import new_filter, replay
from scripted import run
from simulated import UTC, errors, motion, sensed

from imud.configuration.settings import Imu, Settings
from imud.drivers.driver import Options
from imud.drivers.registry import by_name
from imud.estimators.records import HEADING_VALID
from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.nmea import FvM11
from imud.firmware_sim.ublox import Ublox
from imud.sensors.gnss import record

RATE_HZ = 125.0  # samples per second
RATES_HZ = {"nmea": 1.0, "ubx": 5.0}  # fixes per second, by protocol
STEP_S = 0.01  # of the emulated wire
SCENARIOS = ("car", "figure8")
ROWS = (
    *(f"position {axis}, m" for axis in ("north", "east", "down")),
    *(f"velocity {axis}, m/s" for axis in ("north", "east", "down")),
    *(f"{angle}, deg" for angle in ("roll", "pitch", "yaw")),
)
NEES = ("position", "velocity", "attitude")
DAY_S = 86_400.0


class SameErrors:
    """Fixes that have the same errors at the same epochs, however far they are apart."""

    def __init__(self, source):
        self._source = source

    def after(self, t, interval):
        shortest = 1.0 / max(RATES_HZ.values())
        while True:
            fix = self._source.after(t, shortest)
            t = fix.t
            if abs((UTC + t + 0.5 * shortest) % interval - 0.5 * shortest) < 0.1 * shortest:
                return fix


def fixes_by(protocol, source, seconds):
    """What the driver of this protocol reads from the receiver, as rows of FIX; time 0 of the emulator is 1 s."""
    receiver = FvM11(source, UTC) if protocol == "nmea" else Ublox(source, UTC, mixed=True)
    wire, driver = Emulated(receiver), by_name(protocol)
    wire.host_baud = receiver.uart.baud
    heard = b""
    while not (identity := driver.recognise(heard)):
        heard += taken(wire)
    identity = replace(identity, baud=wire.host_baud)
    configured, _ = run(driver.configure(identity, Options(fix_rate_hz=RATES_HZ[protocol], set_up_nmea=True)), wire)
    assert configured.identity.driver == protocol, configured
    decoder, rows = driver.new_decoder(), []
    while wire.now_s < seconds:
        arrival_ns, data = round(wire.now_s * 1e9), taken(wire)
        for fix in decoder.feed(data, arrival_ns) if data else ():
            t = (fix.utc_s - UTC + DAY_S / 2) % DAY_S - DAY_S / 2
            rows.append(record(fix, round((1.0 + t) * 1e9), fix.arrival_ns + 1_000_000_000))
    return np.concatenate(rows)


def taken(wire):
    """What comes in the next step of time."""
    wire.pass_time(STEP_S)
    data = bytes(wire.outgoing)
    wire.outgoing.clear()
    return data


def figures_of(job):
    """(RMS errors, NEES of position, velocity, attitude) with NMEA, then with UBX, of one run."""
    seed, seconds = job
    rng = np.random.default_rng(seed)
    m = motion(SCENARIOS[seed % len(SCENARIOS)], seconds, RATE_HZ, (0.0, 0.0, rng.uniform(-3.0, 3.0)))
    samples, _ = sensed(m, rng)
    runs = []
    for protocol in RATES_HZ:
        source = SimulatedFixes(m.trajectory, np.random.default_rng([seed, 1]), UTC)
        fixes = fixes_by(protocol, SameErrors(source), seconds)
        settings = Settings(imu=Imu(profile="m-g350"))
        runs.append(replay(new_filter("navigation", samples, settings), samples, fixes)[0])
    both = np.all([run["status"] & HEADING_VALID != 0 for run in runs], axis=0)
    k = np.flatnonzero(both)[:: round(RATE_HZ)]
    found = []
    for out in runs:
        p, v, rpy = errors(out[k], m.truth, k)
        off = np.column_stack([p, v, np.degrees(rpy)])
        sigma = np.column_stack([out["sigma_p"][k], out["sigma_v"][k], np.degrees(out["sigma_rpy"][k])])
        nees = np.mean((off / sigma) ** 2, axis=0).reshape(3, 3).mean(axis=1)
        found.append(np.concatenate([np.sqrt(np.mean(off**2, axis=0)), nees]))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    args = parser.parse_args()
    with ProcessPoolExecutor(args.jobs) as pool:
        found = np.array(list(pool.map(figures_of, [(seed, args.seconds) for seed in range(args.runs)])))
    nmea, ubx = np.median(found, axis=0)
    share = np.mean(found[:, 1] < found[:, 0], axis=0)
    print(f"| median of {args.runs} runs | NMEA, 1 Hz | UBX, 5 Hz | UBX better in |\n|---|---|---|---|")
    for i, name in enumerate(ROWS):
        print(f"| {name} | {nmea[i]:.3f} | {ubx[i]:.3f} | {100.0 * share[i]:.0f} % |")
    for i, name in enumerate(NEES, len(ROWS)):
        print(f"| NEES, {name} | {np.mean(found[:, 0, i]):.2f} | {np.mean(found[:, 1, i]):.2f} | |")


if __name__ == "__main__":
    main()
