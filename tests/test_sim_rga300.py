"""The emulated DMU RGA300CA: packets against Prasanna's tables and a captured packet, commands, timer, pacing."""

import math
import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imud.firmware_sim.noise import IDEAL, ImuErrors
from imud.firmware_sim.rga300 import RGA300, SERIAL, START_UP_S, Reading, Rga300

DEG, G = math.pi / 180.0, 9.80665
READY = START_UP_S
FOREVER = 1e6
GOLDEN = "AA55005BFF97FFEE005F005C2A59ADA20621012C000006BF"  # of a real unit: VRPN's Crossbow tracker


class Signal:
    """True rates and forces, one row for all times; level and turning at 10 deg/s unless told."""

    def __init__(self, rates=(1.0, 2.0, 10.0), force=(0.0, 0.0, -G), end=math.inf):
        self.end, self._row = end, np.array([*np.array(rates) * DEG, *force])

    def imu(self, t):
        return np.tile(self._row, (len(t), 1))


def device(signal=None, grade=IDEAL, rate_hz=100.0, **options):
    errors = ImuErrors(grade, np.random.default_rng(1), rate_hz, **options.pop("biases", {}))
    return Rga300(signal or Signal(), errors, rate_hz=rate_hz, **options)


def ask(unit, command, t=READY, wait=0.02):
    """Send, and return what comes back in so many seconds."""
    unit.receive(command, t)
    unit.advance(t + wait)
    return unit.uart.take(t + wait, unit.uart.baud)


def fields(packet):
    """Roll, pitch, yaw rate, accelerations, timer, temperature, part, BIT."""
    assert len(packet) == 24 and packet[:2] == b"\xaa\x55"
    assert sum(packet[2:22]) == int.from_bytes(packet[22:], "big")
    return struct.unpack(">6h4H", packet[2:22])


def stream(unit, seconds, t=READY):
    """Packets and the times at which their last bytes had come."""
    unit.receive(b"C", t)
    packets, heard, now = [], b"", t
    while now < t + seconds:
        now += 1e-3
        unit.advance(now)
        heard += unit.uart.take(now, unit.uart.baud)
        while len(heard) >= 24:
            packets.append((heard[:24], now))
            heard = heard[24:]
    return packets


def test_the_captured_packet_is_reproduced_from_its_values():
    packet = Reading(
        roll=0.49988 * DEG, pitch=-0.57678 * DEG, yaw_rate=-0.082397 * DEG,
        gravity=(0.0086975 * G, 0.0084229 * G, 0.9925232 * G), timer=0xADA2, temperature=24.0102,
    ).packet()  # fmt: skip
    assert packet.hex().upper() == GOLDEN


@given(*[st.integers(-32768, 32767)] * 4, st.integers(-32767, 32767), st.integers(-16384, 16384))
def test_every_word_is_the_value_over_its_scale(yaw_rate, x, y, z, roll, pitch):
    gravity = tuple(value * 2 * 1.5 / 2**15 * G for value in (x, y, z))
    angles = [value * 180 / 2**15 * DEG for value in (roll, pitch)]
    packet = Reading(*angles, yaw_rate * 100 * 1.5 / 2**15 * DEG, gravity, 5, 30.0).packet()
    assert fields(packet)[:6] == (roll, pitch, yaw_rate, x, y, z)
    assert 44.44 * (fields(packet)[7] * 5 / 4096 - 1.375) == pytest.approx(30.0, abs=0.03)


def test_it_is_silent_until_asked_and_deaf_while_it_starts():
    unit = device()
    assert ask(unit, b"R", 0.0) == b""
    assert unit.deadline() == math.inf
    assert ask(unit, b"R") == b"H"


def test_the_unit_tells_serial_number_and_version():
    unit = device()
    serial = struct.pack(">I", SERIAL)
    assert ask(unit, b"S") == b"\xff" + serial + bytes([sum(serial) & 0xFF])
    version = ask(unit, b"v", READY + 1.0)
    assert version[:1] == b"\xff" and version[-1:] == b"$" and version[1:-1].isascii()
    assert ask(unit, b"V?\r\n", READY + 2.0) == b""


def test_a_level_unit_shows_gravity_and_its_yaw_rate():
    roll, pitch, yaw_rate, x, y, z, _, volts, part, bit = fields(ask(device(), b"G"))
    assert (roll, pitch, x, y, part, bit) == (0, 0, 0, 0, 300, 0)
    assert z * 3 / 32768 == pytest.approx(1.0, abs=1e-4)  # +1 g: not the specific force
    assert yaw_rate * 150 / 32768 == pytest.approx(10.0, abs=5e-3)
    assert 44.44 * (volts * 5 / 4096 - 1.375) == pytest.approx(25.0, abs=0.1)


@pytest.mark.parametrize(("roll", "pitch"), [(10.0, 0.0), (0.0, -5.0), (30.0, 20.0), (180.0, 0.0), (-120.0, 40.0)])
def test_the_unit_computes_its_own_tilt(roll, pitch):
    r, p = roll * DEG, pitch * DEG
    force = -G * np.array([-math.sin(p), math.sin(r) * math.cos(p), math.cos(r) * math.cos(p)])
    words = fields(ask(device(Signal(force=force)), b"G"))
    turned = (words[0] * 180 / 32768 - roll + 180.0) % 360.0 - 180.0
    assert (turned, words[1] * 180 / 32768) == pytest.approx((0.0, pitch), abs=0.01)


@pytest.mark.parametrize("rate_hz", [10.0, 100.0, 160.0])
def test_a_stream_keeps_its_rate_and_ends_with_the_last_packet(rate_hz):
    unit = device(rate_hz=rate_hz)
    packets = stream(unit, 4.0)
    assert len(packets) == pytest.approx(4.0 * rate_hz, abs=1)
    times = np.array([at for _, at in packets])
    np.testing.assert_allclose(np.diff(times), 1.0 / rate_hz, atol=1.6e-3)
    unit.receive(b"P", READY + 4.0 + 1e-9)
    unit.advance(READY + 9.0)
    assert len(unit.uart.take(FOREVER, 38400)) <= 24
    assert unit.deadline() == math.inf


def test_the_timer_counts_down_with_the_sampling():
    unit = device(oscillator=1.0 + 200e-6)
    packets = stream(unit, 10.0)
    words = [fields(packet)[6] for packet, _ in packets]
    steps = [(before - after) & 0xFFFF for before, after in pairwise(words)]
    assert sum(steps) * 0.79e-6 == pytest.approx((packets[-1][1] - packets[0][1]) * (1 + 200e-6), abs=5e-3)
    in_ms = np.array(steps) * 0.79e-3
    assert set(np.rint(in_ms / 3.5)) == {2.0, 3.0}  # internal samples of 3.5 ms


def test_polling_ends_a_stream():
    unit = device()
    assert len(stream(unit, 0.1)) == 9
    assert len(ask(unit, b"G", READY + 0.1025)) == 2 * 24  # the tenth is on the line
    assert ask(unit, b"", READY + 0.2, wait=1.0) == b""


def test_zeroing_takes_its_time_is_deaf_and_takes_out_the_bias():
    biases = {"gyro_bias": (0.0, 0.0, 2.0 * DEG), "accel_bias": (0.0, 0.0, 0.0)}
    unit = device(Signal(rates=(0.0, 0.0, 0.0)), biases=biases)
    assert fields(ask(unit, b"G"))[2] * 150 / 32768 == pytest.approx(2.0, abs=5e-3)
    assert ask(unit, b"z\x0a", 1.0, wait=3.4) == b""
    assert ask(unit, b"R", 4.45, wait=0.04) == b""
    assert ask(unit, b"", 4.49, wait=0.1) == b"Z"
    assert fields(ask(unit, b"G", 5.0))[2] == 0
    assert ask(unit, b"z\x00", 6.0, wait=0.1) == b"Z"  # clears
    assert fields(ask(unit, b"G", 7.0))[2] * 150 / 32768 == pytest.approx(2.0, abs=5e-3)


@pytest.mark.parametrize("baud", [9600, 57600])
def test_changing_the_speed(baud):
    unit = device()
    assert ask(unit, b"b") == b"B"
    unit.receive(unit.uart.receive_from(b"a", baud), 1.0)
    assert unit.uart.take(2.0, baud) == b"A"
    assert unit.uart.baud == baud
    assert ask(unit, b"R", 3.0) == b"H"


def test_a_line_too_slow_for_the_stream_loses_whole_packets():
    unit = device(baud=9600)
    packets = stream(unit, 2.0)
    assert 70 <= len(packets) <= 80  # 40 a second
    assert all(fields(packet) for packet, _ in packets)


def test_the_wrong_speed_is_garbage_both_ways():
    unit = device()
    unit.receive(unit.uart.receive_from(b"G", 9600), READY)
    assert b"\xaa\x55" not in unit.uart.take(FOREVER, 38400)
    unit.receive(b"G", 1.0)
    assert b"\xaa\x55" not in unit.uart.take(FOREVER, 57600)


def test_range_and_the_end_of_a_recording():
    limited = device(Signal(rates=(0.0, 0.0, 300.0), force=(50.0, 0.0, 0.0)), grade=RGA300)
    words = fields(ask(limited, b"G"))
    assert (words[2], words[3]) == (21845, -21845)  # 100 deg/s, 2 g
    unit = device(Signal(end=1.005))
    assert len(stream(unit, 3.0)) == 70


def test_a_reported_fault():
    unit = device()
    unit.bit = 4
    assert fields(ask(unit, b"G"))[9] == 4


def test_the_same_seed_gives_the_same_bytes():
    ahead, other = (device(grade=RGA300) for _ in range(2))
    ahead.receive(b"C", READY)
    for k in range(1000):  # computing ahead changes nothing
        ahead.advance(READY + 1e-3 * k)
        ahead.prepare()
    heard = ahead.uart.take(FOREVER, 38400)
    expected = b"".join(packet for packet, _ in stream(other, 1.0))
    assert len(expected) > 90 * 24
    assert heard[: len(expected)] == expected[: len(heard)]
