"""The emulated windowed sensors: registers, frames against docs/protocols.md §1.7, numbers against Epson's scales."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_sim_g350 import READY, ask

from imud.firmware_sim.g370 import G364, G370, VARIANTS, Windowed
from imud.firmware_sim.noise import IDEAL, ImuErrors

DEG, G = math.pi / 180.0, 9.80665
FOREVER = 1e6


class Still:
    """+1.25, -1.25 and 0 deg/s, -1 G on z."""

    end = math.inf

    def imu(self, t):
        return np.tile([1.25 * DEG, -1.25 * DEG, 0.0, 0.0, 0.0, -G], (len(t), 1))


def device(variant=G364, **options):
    return Windowed(variant, Still(), ImuErrors(IDEAL, np.random.default_rng(1), 2000.0), **options)


def word(unit, window, address, t=READY):
    answer = bytes.fromhex(ask(unit, f"FE {window:02X} 0D {address:02X} 00 0D", t))
    assert len(answer) == 4 and answer[0] == address and answer[3] == 0x0D
    return int.from_bytes(answer[1:3], "big")


def start(unit, t=READY, rate=1, taps=1, auto=1, fields=0xF003, wide=0x00):
    high, low = fields >> 8, fields & 0xFF
    ask(unit, f"FE 01 0D 85 {rate:02X} 0D 86 {taps:02X} 0D 88 {auto:02X} 0D", t)
    ask(unit, f"8C {low:02X} 0D 8D {high:02X} 0D 8F {wide:02X} 0D FE 00 0D 83 01 0D", t)


def frames(unit, until, size):
    unit.advance(until)
    data = unit.uart.take(FOREVER, unit.uart.baud)
    assert len(data) % size == 0 and data
    return [data[i : i + size] for i in range(0, len(data), size)]


def test_not_ready_for_800_ms():
    unit = device()
    assert word(unit, 1, 0x0A, 0.1) == 0x0400
    assert ask(unit, "FE 00 0D 4C 00 0D", 0.2) == ""  # nothing else answers yet
    assert word(unit, 1, 0x0A, 0.801) == 0
    assert word(unit, 0, 0x4C, 0.9) == 0x5345


# docs/protocols.md §1.7, defaults
@pytest.mark.parametrize(
    ("window", "address", "value"),
    [
        (0, 0x02, 0x0400),
        (0, 0x08, 0x0200),
        (0, 0x4C, 0x5345),
        (1, 0x00, 0xFE00),
        (1, 0x02, 0x0006),
        (1, 0x04, 0x0103),
        (1, 0x06, 0x0001),
        (1, 0x08, 0x0000),
        (1, 0x0C, 0xF006),
        (1, 0x0E, 0x0000),
        (1, 0x38, 0x4000),
        (1, 0x3A, 0x0000),
        (1, 0x48, 0x4000),
        (1, 0x4C, 0x0000),
    ],
)
def test_registers_have_their_defaults(window, address, value):
    assert word(device(), window, address) == value


@pytest.mark.parametrize("name", VARIANTS)
def test_the_registers_spell_the_product_name(name):
    words = [word(device(VARIANTS[name]), 1, address) for address in (0x6A, 0x6C, 0x6E, 0x70)]
    assert b"".join(value.to_bytes(2, "little") for value in words).startswith(name.upper().encode())


def test_windows_keep_their_registers_apart():
    unit = device()
    ask(unit, "FE 00 0D 85 04 0D 86 05 0D")  # W0 04, 06: DIAG_STAT and FLAG, read-only
    assert word(unit, 1, 0x04) == 0x0103 and word(unit, 1, 0x06) == 0x0001
    ask(unit, "FE 01 0D 85 04 0D 86 05 0D")
    assert word(unit, 1, 0x04) == 0x0403 and word(unit, 1, 0x06) == 0x0005
    ask(unit, "FE 01 0D B9 02 0D")  # the flat dialect's stop command hits the rotation matrix
    assert word(unit, 1, 0x38) == 0x0200


@pytest.mark.parametrize(("variant", "seconds"), [(G364, 0.08), (G370, 0.15)])
def test_self_test_is_busy_for_its_time(variant, seconds):
    unit = device(variant)
    ask(unit, "FE 01 0D 83 04 0D", 1.0)
    assert word(unit, 1, 0x02, 1.0 + seconds - 0.01) & 0x0400
    assert word(unit, 1, 0x02, 1.0 + seconds + 0.01) == 0x0006
    assert word(unit, 0, 0x04, 1.3) == 0


def test_golden_frame():
    """25 degC, +1.25, -1.25, 0 deg/s at 0.00375 deg/s, -1 G at 0.125 mG; sums by hand.

    FE00 + 0A4A = 084A, + 014D = 0997, + FEB2 = 0849, + E0C0 = E909, + 0002 = E90B
    """
    unit = device()
    start(unit)
    first = frames(unit, READY + 1.1e-3, 22)[0]
    # 333.33 and -333.33 LSB: the 16-bit words are the high words, -334 = FEB2
    assert first == bytes.fromhex("80 FE00 0A4A 014D FEB2 0000 0000 0000 E0C0 0002 E90B 0D")


def test_wide_frames_hold_65536th_parts():
    unit = device()
    start(unit, wide=0x70)
    first = frames(unit, READY + 1.1e-3, 36)[0]
    temperature, gx, gy, _, _, _, az = struct.unpack(">7i", first[3:31])
    assert temperature == 2634 << 16
    assert [gx, gy] == [round(65536 * 1.25 / 0.00375), -round(65536 * 1.25 / 0.00375)]
    assert az == -8000 << 16


FIELDS = [0x8000, 0x4000, 0x2000, 0x1000, 0x0004, 0x0002, 0x0001]


@given(st.sets(st.sampled_from(FIELDS), min_size=1), st.sampled_from([0x00, 0x70, 0x30, 0x40]))
def test_frames_hold_what_burst_ctrl_asks_for(chosen, wide):
    narrow = {0x8000: 2, 0x4000: 2, 0x2000: 6, 0x1000: 6, 0x0004: 2, 0x0002: 2, 0x0001: 2}
    size = 2 + sum(narrow[bit] * (2 if wide << 8 & bit & 0x7000 else 1) for bit in chosen)
    unit = device()
    start(unit, rate=4, taps=4, fields=sum(chosen), wide=wide)
    for frame in frames(unit, READY + 0.1, size):
        assert (frame[0], frame[-1]) == (0x80, 0x0D)
        body = struct.unpack(f">{(size - 2) // 2}H", frame[1:-1])
        if 0x0001 in chosen:
            assert sum(body[:-1]) & 0xFFFF == body[-1]
        if 0x8000 in chosen:
            assert body[0] == 0xFE00


@pytest.mark.parametrize(("code", "rate"), [(0, 2000), (1, 1000), (5, 62.5), (8, 400), (10, 100), (15, 20)])
def test_rates_and_count_steps(code, rate):
    unit = device(baud=921600)
    start(unit, rate=code, taps=7)
    got = frames(unit, READY + 2.0 + 1e-6, 22)
    assert len(got) == 2 * rate
    counts = np.array([int.from_bytes(frame[-5:-3], "big") for frame in got])
    assert set(np.diff(counts) % 65536) == {2000 / rate}


def test_a_burst_is_sent_when_asked_for():
    unit = device()
    start(unit, auto=0)
    unit.advance(1.0)
    burst = bytes.fromhex(ask(unit, "80 00 0D", 1.0))
    assert len(burst) == 22 and burst[0] == 0x80 and burst[1:3] == b"\xfe\x00"
    assert word(unit, 0, 0x0E, 1.1) == 2634
    assert word(unit, 0, 0x12, 1.1) == 0x014D
    assert ask(unit, "FE 01 0D 80 00 0D", 1.2) == ""  # in window 1 that writes SIG_CTRL


def test_soft_reset_restores_all_defaults():
    unit = device()
    start(unit)
    unit.advance(1.0)
    ask(unit, "FE 01 0D 8A 80 0D", 1.0)
    assert word(unit, 1, 0x0A, 1.7) == 0x0400
    assert word(unit, 1, 0x0A, 1.9) == 0
    assert word(unit, 0, 0x02, 1.9) == 0x0400
    assert word(unit, 1, 0x0C, 1.9) == 0xF006


@given(st.lists(st.binary(max_size=40), max_size=10))
def test_garbage_never_raises_and_the_device_stays_reachable(chunks):
    unit = device()
    for i, chunk in enumerate(chunks):
        unit.receive(chunk, READY + i * 0.01)
    unit.receive(bytes.fromhex("0D FE 00 0D 83 02 0D FE 01 0D 8A 80 0D"), 2.0)
    unit.uart.take(FOREVER, unit.uart.baud)
    assert word(unit, 0, 0x4C, 3.0) == 0x5345
