"""The emulated FV-M11 through line, decoder and epoch clock: every fix at its time, with its own speed."""

import math

import numpy as np
import pytest
from nmea_lines import line

from imud.clocks.epochs import EpochClock
from imud.drivers.nmea.decoder import NmeaDecoder
from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.nmea import FvM11
from imud.firmware_sim.scenarios import SCENARIOS

UTC_0 = 1_793_577_580.3  # 23:59:40.3, soon midnight
LATENCY_S, COMPUTE_S = 0.15, 0.1
EVERYTHING = "PMTK314,0,1,1,1,5,5,0,0,0,0,0,0,0,0,0,0,0,0,1"  # the channels too: 1.2 s on the line at each fifth epoch
GGA_VTG = "PMTK314,0,0,1,1,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0"


def drive(baud, rate_hz=1.0, command=None, seconds=60.0, stall_s=0.0):
    """Fixes and their epochs on the axis of the emulator's time. The host stalls for `stall_s` every 20 s."""
    truth = Trajectory(SCENARIOS["car"](0.0, 0.0, 0.0), 35.6586, 139.7454, 60.0)
    source = SimulatedFixes(truth, np.random.default_rng(1), UTC_0, True)
    unit, decoder, clock = FvM11(source, UTC_0, baud=baud, rate_hz=rate_hz), NmeaDecoder(), EpochClock(LATENCY_S)
    if command:
        unit.receive(line(command), 0.0)
    found, t = [], 0.0
    while t < seconds:
        t += stall_s if stall_s and t % 20.0 < 0.01 <= t else 0.01
        unit.advance(t)
        data = unit.uart.take(t, baud)
        now_ns = round((t + 100.0) * 1e9)
        for fix in (decoder.feed(data, now_ns) if data else []) + decoder.flush(now_ns):
            found.append((fix, clock.epoch_ns(fix.utc_s, fix.arrival_ns) * 1e-9 - 100.0, t))
    return truth, found, decoder, unit


CASES = {
    "9600 baud": (9600, 1.0, None),
    "4800 baud": (4800, 1.0, None),
    "4800 baud, everything": (4800, 1.0, EVERYTHING),
    "4800 baud, GGA and VTG": (4800, 1.0, GGA_VTG),
    "5 Hz": (57600, 5.0, None),
    "5 Hz, GGA and VTG": (57600, 5.0, GGA_VTG),
    "2 Hz": (19200, 2.0, None),
}


@pytest.mark.thorough
@pytest.mark.parametrize("stall_s", [0.0, 0.7, 3.0])
@pytest.mark.parametrize("case", CASES)
def test_fixes_are_the_truth_at_their_epochs(case, stall_s):
    baud, rate_hz, command = CASES[case]
    truth, found, decoder, unit = drive(baud, rate_hz, command, stall_s=stall_s)
    assert unit.lost == 0
    true_s = np.array([(fix.utc_s - UTC_0) % 86_400 for fix, _, _ in found])
    assert np.allclose(np.diff(true_s), 1.0 / rate_hz, atol=1e-6), "each epoch once"
    assert true_s[0] < 4.0 and true_s[-1] > 60.0 - 3.5
    x = truth.at(true_s)
    assert np.allclose([fix.lat_deg for fix, _, _ in found], np.degrees(x.lat), atol=2e-8)
    assert np.allclose([fix.height_m for fix, _, _ in found], x.height, atol=2e-3)
    speeds = [math.nan if fix.speed_mps is None else fix.speed_mps for fix, _, _ in found]
    apart = ~np.isfinite(speeds)
    assert apart.sum() <= (2 if stall_s else 0)
    assert np.allclose(np.array(speeds)[~apart], np.hypot(*x.v_n[~apart, :2].T), atol=2e-3)
    epochs = np.array([epoch_s for _, epoch_s, _ in found])
    early = COMPUTE_S - LATENCY_S  # what the settings think too much
    prompt = 25 if command == EVERYTHING else 3  # the backlog of the search has to drain first: nothing comes in time
    assert np.abs(epochs - true_s - early)[prompt:].max() < 0.06
    assert not any(
        " " in reason for reason in decoder.counters if reason not in ("no fix", "no checksum", "noise bytes")
    )


@pytest.mark.parametrize("command", [None, GGA_VTG])
def test_a_fix_is_ready_with_the_last_byte_of_its_burst(command):
    _, found, _, _ = drive(9600, 1.0, command)
    length = 200 if command is None else 122  # GGA, RMC, VTG; or GGA, VTG
    ready = np.array([t - (fix.utc_s - UTC_0) % 86_400 for fix, _, t in found])[5:]
    assert np.median(ready) == pytest.approx(COMPUTE_S + length * 10 / 9600, abs=0.03)
