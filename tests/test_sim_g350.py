"""The emulated M-G350: words against the data sheet, behaviour against docs/protocols.md §1."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imud.firmware_sim.g350 import G350, TAPS_V340
from imud.firmware_sim.noise import IDEAL, M_G350, ImuErrors
from imud.firmware_sim.sampling import Sampler

DEG, G = math.pi / 180.0, 9.80665
READY = 0.9  # s; start-up is over
FOREVER = 1e6


class Signal:
    """True rates and forces: a function of time, or +1.25, -1.25, 0 deg/s and +1 G on z."""

    def __init__(self, function=None, end=math.inf):
        self.end, self._function = end, function

    def imu(self, t):
        if self._function is None:
            return np.tile([1.25 * DEG, -1.25 * DEG, 0.0, 0.0, 0.0, G], (len(t), 1))
        return np.array([self._function(x) for x in t])


def device(signal=None, grade=IDEAL, seed=1, **options):
    return G350(signal or Signal(), ImuErrors(grade, np.random.default_rng(seed), 2000.0), **options)


def ask(unit, command, t=READY):
    """Send bytes in hex, return what comes back within a millisecond, in hex; spaces are free."""
    unit.receive(bytes.fromhex(command), t)
    return unit.uart.take(t + 1e-3, unit.uart.baud).hex(" ").upper()


def word(unit, address, t=READY):
    answer = bytes.fromhex(ask(unit, f"{address:02X} 00 0D", t))
    assert len(answer) == 4 and answer[0] == address and answer[3] == 0x0D
    return int.from_bytes(answer[1:3], "big")


def start(unit, t=READY, rate=1, taps=1, auto=True, count=True):
    ask(unit, f"B7 {rate:02X} 0D B8 {taps:02X} 0D BA {auto:02X} 0D D0 {count:02X} 0D B9 01 0D", t)


def frames(unit, until, size=22):
    unit.advance(until)
    data = unit.uart.take(FOREVER, unit.uart.baud)
    assert len(data) % size == 0
    return [data[i : i + size] for i in range(0, len(data), size)]


# --- start-up and registers ---


def test_not_ready_for_800_ms():
    unit = device()
    assert word(unit, 0x3E, 0.1) == 0x0400
    assert ask(unit, "38 00 0D", 0.2) == ""  # nothing else answers yet
    ask(unit, "B7 02 0D", 0.3)  # nor is anything written
    assert word(unit, 0x3E, 0.799) == 0x0400
    assert word(unit, 0x3E, 0.801) == 0
    assert word(unit, 0x36, 0.9) == 0x0100


# docs/protocols.md §1.3 and the siblings' defaults in §1.7
@pytest.mark.parametrize(
    "address, value",
    [(0x38, 0x0401), (0x36, 0x0100), (0x34, 0x0006), (0x32, 0xFE00), (0x3A, 0), (0x3C, 0), (0x50, 0), (0x40, 0)],
)
def test_defaults_in_configuration_mode(address, value):
    assert word(device(), address) == value


@pytest.mark.parametrize(
    "command, address, value",
    [
        ("B7 04 0D", 0x36, 0x0400),  # rate code in the high byte
        ("B8 07 0D", 0x38, 0x0407),  # filter code in the low byte; still configuration mode
        ("BA 01 0D", 0x3A, 0x0001),
        ("D0 FF 0D", 0x50, 0x0001),  # only bit 0 exists
        ("91 02 0D", 0x10, 0x0200),
        ("90 FF 0D", 0x10, 0x0207),
        ("B5 FF 0D", 0x34, 0x0406),  # self test: busy, and nothing of it stored
        ("BC FF 0D", 0x3C, 0x0000),  # read-only
        ("84 12 0D", 0x04, 0x0000),
        ("EA 41 0D", 0x6A, 0x3347),  # "G3", low byte first
        ("FE 01 0D", 0x38, 0x0401),  # there are no windows: ignored
    ],
)
def test_writes_store_the_bits_that_exist(command, address, value):
    unit = device()
    assert ask(unit, command) == ""  # a write is not answered
    assert word(unit, address) == value


def test_product_name_and_its_absence():
    named, nameless = device(), device(identity=False)
    words = [word(named, address) for address in (0x6A, 0x6C, 0x6E, 0x70)]
    assert b"".join(value.to_bytes(2, "little") for value in words) == b"G350PD11"
    assert [word(nameless, address) for address in range(0x6A, 0x7C, 2)] == [0] * 9


def test_self_test_is_busy_for_80_ms_and_passes():
    unit = device()
    ask(unit, "B5 04 0D", 1.0)
    assert word(unit, 0x34, 1.07) & 0x0400
    assert word(unit, 0x34, 1.09) == 0x0006
    assert word(unit, 0x3C, 1.1) == 0


def test_soft_reset_restores_all_defaults():
    unit = device()
    start(unit)
    assert len(frames(unit, 1.0)) > 90
    ask(unit, "BE 80 0D", 1.0)
    assert word(unit, 0x3E, 1.7) == 0x0400
    assert word(unit, 0x3E, 1.9) == 0
    assert word(unit, 0x38, 1.9) == 0x0401
    assert word(unit, 0x3A, 1.9) == 0


# --- commands on the wire ---


@pytest.mark.parametrize("junk", ["0D", "0D 0D", "3E 0D", "00 3E 00 0D", "FF 38 00 0D", "FF" * 500 + "0D"])
def test_a_command_of_another_length_is_ignored(junk):
    unit = device()
    assert ask(unit, junk) == ""
    assert ask(unit, "38 00 0D") == "38 04 01 0D"


@given(st.lists(st.binary(max_size=40), max_size=10))
def test_garbage_never_raises_and_the_device_stays_reachable(chunks):
    unit = device()
    for i, chunk in enumerate(chunks):
        unit.receive(chunk, READY + i * 0.01)
    unit.receive(bytes.fromhex("0D B9 02 0D BE 80 0D"), 2.0)
    unit.uart.take(FOREVER, unit.uart.baud)
    assert word(unit, 0x38, 3.0) == 0x0401


@given(st.data())
def test_chunking_of_commands_does_not_matter(data):
    text = bytes.fromhex("0D 3E 00 0D B7 03 0D 36 00 0D 11 B8 02 0D 38 00 0D D0 01 0D 20 00 0D 6A 00 0D")
    whole, parts = device(), device()
    whole.receive(text, READY)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(text)), max_size=8)))
    for a, b in zip([0, *cuts], [*cuts, len(text)], strict=True):
        parts.receive(text[a:b], READY)
    expected = whole.uart.take(FOREVER, 460800)
    assert parts.uart.take(FOREVER, 460800) == expected and len(expected) == 4 * 4 + 22


def test_an_answer_takes_its_time_on_the_line():
    unit = device(baud=230400)
    unit.receive(b"\x38\x00\x0d", 1.0)
    done = unit.uart.due()
    assert done - 1.0 == pytest.approx((3 + 4) * 10 / 230400 + 25e-6)
    assert unit.uart.take(done - 1e-9, 230400) == b""
    assert unit.uart.take(done, 230400) == bytes.fromhex("38 04 01 0D")


# --- sampling ---


def test_golden_burst():
    """25 degC, +1.25, -1.25, 0 deg/s, +1 G (docs/protocols.md §1.5), GPIO cleared."""
    unit = device()
    ask(unit, "91 00 0D")
    start(unit, auto=False, count=False)
    unit.advance(1.0)
    assert ask(unit, "20 00 0D", 1.0) == "20 FE 00 C4 92 00 64 FF 9C 00 00 00 00 00 00 1F 40 00 00 0D"
    assert ask(unit, "20 00 0D", 1.0006).startswith("20 00 00 C4 92")  # nothing new since
    assert word(unit, 0x04, 1.1) == 0x0064 and word(unit, 0x02, 1.2) == 0xC492


def test_auto_frames_carry_count_and_no_read_is_answered():
    unit = device()
    start(unit)
    assert ask(unit, "38 00 0D", READY + 1e-4) == "" and ask(unit, "20 00 0D", READY + 1e-4) == ""
    got = frames(unit, READY + 0.1001)
    assert len(got) == 100
    assert all(frame[0] == 0x20 and frame[21] == 0x0D and frame[1:3] == b"\xfe\x00" for frame in got)
    assert [int.from_bytes(frame[19:21], "big") for frame in got] == list(range(2, 202, 2))  # ticks of 2 kHz


@pytest.mark.parametrize("code, rate", [(1, 1000), (2, 500), (3, 250), (4, 125), (5, 62.5), (6, 31.25), (7, 15.625)])
def test_rates_and_count_steps(code, rate):
    ticks, ones = device(), device(count_step=1)
    for unit, step in ((ticks, 2000 / rate), (ones, 1)):
        start(unit, rate=code, taps=code)
        got = frames(unit, READY + 10.0 + 1e-6)
        assert len(got) == int(10 * rate)
        counts = np.array([int.from_bytes(frame[19:21], "big") for frame in got])
        assert set(np.diff(counts) % 65536) == {step}


@pytest.mark.thorough
def test_frames_leave_on_the_grid_of_the_device_clock_for_an_hour(monkeypatch):
    monkeypatch.setattr(ImuErrors, "measure", lambda self, signal, t: np.zeros((len(t), 6)))  # only times matter here
    unit = device(oscillator=1.0 + 50e-6)
    start(unit, rate=7, taps=7)
    unit.advance(READY + 3600.0)
    due = []
    while unit.uart.due() < math.inf:
        due.append(unit.uart.due())
        unit.uart.take(due[-1], 460800)
    expected = READY + np.arange(1, len(due) + 1) * 0.064 / (1.0 + 50e-6) + 22 * 10 / 460800
    assert np.abs(np.array(due) - expected).max() < 1e-9 and len(due) == 56252


def test_deadline_is_when_the_next_frame_will_be_complete():
    unit = device()
    assert unit.deadline() == math.inf
    start(unit)
    for k in range(1, 50):
        t = unit.deadline()
        assert t == pytest.approx(READY + k * 1e-3 + 22 * 10 / 460800, abs=1e-12)
        unit.advance(t)
        assert unit.uart.due() == pytest.approx(t) and len(unit.uart.take(t + 1e-12, 460800)) == 22


def test_only_mode_gpio_and_reset_are_writable_while_sampling():
    unit = device()
    start(unit, auto=False)
    ask(unit, "B7 04 0D B8 04 0D BA 01 0D D0 00 0D B5 04 0D 90 07 0D 91 05 0D")
    assert [word(unit, a) for a in (0x36, 0x38, 0x3A, 0x50, 0x34, 0x10)] == [0x100, 0x0001, 0, 1, 6, 0x0500]
    ask(unit, "B9 02 0D")
    assert word(unit, 0x38) == 0x0401


def test_new_data_flags_are_cleared_one_by_one_and_can_be_disabled():
    unit = device()
    start(unit, auto=False)
    unit.advance(1.0)
    assert word(unit, 0x00, 1.0) == 0xFE00
    word(unit, 0x06, 1.0)
    word(unit, 0x0E, 1.0)
    assert word(unit, 0x00, 1.0) == 0xFE00 & ~0x2000 & ~0x0200  # gyro Y, accelerometer Z
    few = device()
    ask(few, "B3 0E 0D")  # accelerometers only
    start(few, auto=False)
    few.advance(1.0)
    assert word(few, 0x00, 1.0) == 0x0E00


def test_a_line_too_slow_for_the_rate_loses_whole_frames_and_reports_it():
    unit = device(baud=115200)  # 22 bytes take 1.9 ms
    start(unit)
    got = frames(unit, READY + 1.0)
    assert 480 < len(got) < 530
    assert all(frame[0] == 0x20 and frame[-1] == 0x0D for frame in got)
    counts = np.array([int.from_bytes(frame[19:21], "big") for frame in got])
    assert set(np.diff(counts) % 65536) <= {2, 4} and got[-1][2] & 1  # gaps seen in COUNT; error flag EA
    ask(unit, "B9 02 0D", READY + 1.1)
    unit.uart.take(FOREVER, 115200)
    assert word(unit, 0x3C, 3.1) == 0x0008  # UART overrun
    assert word(unit, 0x3C, 3.2) == 0  # cleared by reading


def test_the_device_falls_silent_where_the_recording_ends():
    unit = device(Signal(end=1.5))
    start(unit)
    assert len(frames(unit, 10.0)) == 600
    assert unit.deadline() == math.inf


# --- from motion to numbers ---


def rows(sampler, n):
    return np.array([np.frombuffer(sampler.row(), dtype=">i2") for _ in range(n)])


def sampler(signal, decimation=2, taps=2, grade=IDEAL, seed=1):
    return Sampler(signal, ImuErrors(grade, np.random.default_rng(seed), 2000.0), 10.0, decimation, taps)


@pytest.mark.parametrize("decimation, taps", [(2, 1), (2, 2), (16, 16), (16, 128), (128, 128)])
def test_the_filter_is_the_mean_of_the_last_taps(decimation, taps):
    def ramp(t):
        return [(t - 10.0) * 100.0 * DEG, 0.0, 0.0, 0.0, 0.0, 0.0]

    got = rows(sampler(Signal(ramp), decimation, taps), 40)[:, 1] * 0.0125
    t = np.arange(1, 41) * decimation / 2000.0
    delay = (taps - 1) / 2 / 2000.0  # group delay of a moving average
    assert got == pytest.approx(np.clip(100.0 * (t - delay), -300, 300), abs=0.00626)


def test_taps_average_the_noise():
    quiet = rows(sampler(Signal(), 16, 16, M_G350), 4000)[:, 1:].std(axis=0)
    loud = rows(sampler(Signal(), 16, 4, M_G350), 4000)[:, 1:].std(axis=0)
    assert loud / quiet == pytest.approx(2.0, rel=0.1)
    # white noise at 125 /s with the data sheet's random walk, and half an LSB of rounding noise in quadrature
    expected = math.hypot(0.2 / 60.0 * math.sqrt(125.0) / 0.0125, 1 / math.sqrt(12))
    assert quiet[:3] == pytest.approx(expected, rel=0.05)


@given(
    st.lists(st.floats(-400.0, 400.0), min_size=3, max_size=3), st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3)
)
def test_words_are_the_data_sheets_scale_and_range(rates, forces):
    truth = [x * DEG for x in rates] + [x * G for x in forces]
    got = rows(sampler(Signal(lambda _: truth)), 1)[0]
    expected = [np.clip(x / 0.0125, -24000, 24000) for x in rates] + [
        np.clip(x / 125e-6, -24000, 24000) for x in forces
    ]
    assert np.abs(got[1:] - expected).max() <= 0.5 + 1e-6
    assert got[0] == -15214  # 25 degC


def test_temperature_rises_after_switch_on():
    late = Sampler(Signal(), ImuErrors(M_G350, np.random.default_rng(1), 2000.0), 200.0, 2, 2)
    celsius = 25.0 + 0.0042725 * (rows(late, 1)[0, 0] + 15214)
    assert celsius == pytest.approx(25.0 + 6.0 * (1.0 - math.exp(-1.0)), abs=0.01)


def test_seed_repeats_the_bytes():
    def run(seed):
        unit = device(grade=M_G350, seed=seed)
        start(unit)
        return frames(unit, 1.5)

    assert run(5) == run(5) and run(5) != run(6)


def test_the_siblings_tap_table_can_be_had():
    def step(t):
        return [100.0 * DEG if t > READY + 0.01025 else 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]

    mixed = {}
    for name, taps in (("G350", {}), ("V340", {"taps": TAPS_V340})):
        unit = device(Signal(step), **taps)
        start(unit, taps=3)
        gyro = np.array([int.from_bytes(frame[5:7], "big") for frame in frames(unit, READY + 0.05)])
        mixed[name] = int(((gyro > 0) & (gyro < 8000)).sum())
    assert mixed == {"G350": 3, "V340": 0}  # code 3: 8 taps, or 2, at 2 ticks per sample
