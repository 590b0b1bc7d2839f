"""The emulated serial accelerometer: lines against the report, menu and limits against docs/protocols.md §3."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imud.firmware_sim.noise import IDEAL, STANDARD_GRAVITY, ImuErrors
from imud.firmware_sim.seraccel import BAUDS, MODES, MV_PER_G, RATE_MAX_HZ, SerAccel, Settings, mma7260

G = STANDARD_GRAVITY
READY = 1.0  # s; the menu has been said, at any speed


class Signal:
    """No rates, a force that is constant in time or a function of it."""

    def __init__(self, force=(0.0, 0.0, -G), function=None, end=math.inf):
        self.end, self._force, self._function = end, force, function

    def imu(self, t):
        force = [self._function(x) for x in t] if self._function else np.tile(self._force, (len(t), 1))
        return np.hstack([np.zeros((len(t), 3)), force])


def board(signal=None, baud=57600, mode="gravity", rate=50.0, range_g=1.5, ideal=True, seed=1, **options):
    grade = replace(IDEAL, limit=(math.inf, math.inf)) if ideal else mma7260(rate, range_g)
    errors = ImuErrors(grade, np.random.default_rng(seed), rate)
    return SerAccel(signal or Signal(), errors, baud, Settings(mode, rate, range_g), **options)


def heard(unit, until):
    """What the line carried up to then."""
    unit.advance(until)
    return unit.uart.take(until, unit.uart.baud)


def press(unit, key, t):
    """One key, and what came back within 0.5 s."""
    unit.receive(key, t)
    return heard(unit, t + 0.5)


def started(**options):
    """A board that streams from READY on."""
    unit = board(**options)
    heard(unit, READY)
    unit.receive(b"x", READY)
    return unit


def lines(unit, seconds, end=b"\n\r"):
    return heard(unit, READY + seconds).split(end)[2:-1]  # behind the echo


# --- lines ---


def test_the_line_of_the_report():
    """X=-0.501 Y=-0.007 Z= 0.082: blank for plus, three decimals; the converter's steps are 4 mg."""
    unit = started(signal=Signal((-0.501 * G, 0.007 * G, -0.082 * G)))
    first = lines(unit, 0.5)[0]
    assert re.fullmatch(rb"X=-\d\.\d{3} Y=-\d\.\d{3} Z= \d\.\d{3}", first)
    assert [float(x) for x in re.findall(rb"-?\d\.\d{3}", first)] == pytest.approx([-0.501, -0.007, 0.082], abs=0.005)


def test_the_successors_line():
    unit = started(signal=Signal((0.0, 0.0, -G)), labelled=False)
    assert lines(unit, 0.5)[0] == b" 0.00\t 0.00\t 1.00"


def test_a_level_board_reports_one_g_on_z_and_specific_force_on_the_others():
    """x forward, y left, z up, against the signal's FRD."""
    for force, expected in (((0, 0, -G), (0, 0, 1)), ((G, 0, 0), (1, 0, 0)), ((0, G, 0), (0, -1, 0))):
        first = lines(started(signal=Signal(force)), 0.2)[0]
        assert [float(x) for x in re.findall(rb"[- ]\d\.\d{3}", first)] == pytest.approx(expected, abs=0.005)


@pytest.mark.parametrize(("range_g", "mv_per_g"), [(1.5, 800), (2.0, 600), (4.0, 300), (6.0, 200)])
def test_counts_are_the_data_sheets_sensitivity(range_g, mv_per_g):
    expected = [round((1650 + mv_per_g * g) / 3300 * 1023) for g in (0.25, -0.5, 1.0)]
    signal = Signal((0.25 * G, 0.5 * G, -G))
    text = lines(started(signal=signal, mode="raw", range_g=range_g), 0.2)[0]
    assert re.fullmatch(rb"\d{4}\t\d{4}\t\d{4}", text)
    assert [int(x) for x in text.split(b"\t")] == expected
    unit = started(signal=signal, mode="binary", range_g=range_g)
    data = heard(unit, READY + 0.2).removeprefix(b"x\n\r\n\r")
    assert data[:8] == b"#" + b"".join(count.to_bytes(2, "big") for count in expected) + b"$"
    assert len(data) % 8 == 0


@given(st.tuples(*[st.floats(-30.0, 30.0)] * 3), st.sampled_from(sorted(MV_PER_G)))
def test_no_force_leaves_the_sensors_swing(force, range_g):
    unit = started(signal=Signal(force), mode="raw", range_g=range_g)
    for count, f in zip(map(int, lines(unit, 0.2)[0].split(b"\t")), np.array(force) * [1, -1, -1], strict=True):
        mv = min(max(1650 + MV_PER_G[range_g] * f / G, 250), 3050)
        assert count == pytest.approx(mv / 3300 * 1023, abs=0.51)


def test_line_ends_can_be_had_either_way_round():
    assert heard(started(line_end=b"\r\n"), READY + 0.2).count(b" Z= 1.001\r\n") > 5


# --- the menu ---


def test_it_boots_into_its_menu_and_waits():
    unit = board()
    text = heard(unit, READY)
    assert text.endswith(b"\n\rSelection: ")
    assert b"[x] Exit" in text and b"gravity" in text and b"50 Hz" in text and b"+/- 1.5 g" in text
    assert heard(unit, 100.0) == b""
    assert unit.deadline() == math.inf


def test_it_can_stream_from_the_start():
    unit = board(streaming=True)
    assert unit.deadline() < 0.5
    assert heard(unit, 1.0).startswith(b"X=")


@given(st.integers(0, 255))
def test_any_byte_stops_the_stream(byte):
    unit = started()
    assert b"X=" in heard(unit, READY + 0.5)
    unit.receive(bytes([byte]), READY + 0.5)
    assert heard(unit, READY + 1.0).endswith(b"Selection: ")
    assert heard(unit, READY + 9.0) == b""


@pytest.mark.parametrize("key", [b"\xff", b"\r", b"?", b"\0"])
def test_an_invalid_key_shows_the_menu_again(key):
    unit = board()
    heard(unit, READY)
    answer = press(unit, key, READY)
    assert b"Invalid" in answer and answer.endswith(b"Selection: ")


def test_keys_are_lost_while_it_prints():
    unit = board()
    unit.receive(b"x", 0.21)  # the menu takes 40 ms
    assert b"X=" not in heard(unit, READY)
    assert b"X=" in press(unit, b"x", READY)


def test_every_setting_can_be_chosen():
    unit = board()
    heard(unit, READY)
    for t, keys in enumerate((b"22", b"44", b"3iii", b"x"), start=2):
        for k, key in enumerate(keys):
            last = press(unit, bytes([key]), t * 10.0 + k)
    assert unit.settings == Settings("raw", 53.0, 6.0)
    assert last.endswith(b"Selection: ")
    assert press(unit, b"1", 70.0).endswith(b"\n\r") and press(unit, b" ", 71.0).endswith(b"Selection: ")


@pytest.mark.parametrize(("key", "baud"), list(zip(b"1234", BAUDS, strict=True)))
def test_the_speed_of_the_line_can_be_chosen(key, baud):
    unit = board(baud=38400)
    heard(unit, READY)
    press(unit, b"5", 2.0)
    unit.receive(bytes([key]), 3.0)
    assert unit.uart.baud == baud
    assert heard(unit, 5.0).endswith(b"Selection: ")


# --- rates and times ---


@pytest.mark.parametrize(("mode", "fastest"), [("gravity", 125.0), ("raw", 195.0)])
def test_the_fastest_rates_of_the_report(mode, fastest):
    """125 Hz calculated gravity and 195 Hz raw, at 57600."""
    unit = board(mode=mode, rate=500.0, streaming=True)
    heard(unit, READY)
    assert unit.settings.rate_hz == fastest
    assert len(lines(unit, 2.0)) == pytest.approx(2.0 * fastest, abs=4)
    assert unit.skipped == 0


@pytest.mark.parametrize("baud", BAUDS)
@pytest.mark.parametrize("mode", MODES)
def test_no_rate_exceeds_the_line(mode, baud):
    unit = board(mode=mode, rate=500.0, baud=baud, streaming=True)
    text = heard(unit, 10.0)
    assert unit.skipped == 0
    assert len(text) * 10 <= baud * 10.0
    assert unit.settings.rate_hz == RATE_MAX_HZ[mode] or len(text) * 10 > 0.85 * baud * 9.8


def test_lines_leave_on_the_grid_of_the_boards_clock():
    unit = started(rate=20.0, oscillator=1.001)
    due, length = [], 28
    while len(due) < 400:
        t = unit.deadline()
        assert t == pytest.approx(READY + 0.02 + len(due) * 0.05 / 1.001 + length * 10 / 57600, abs=1e-9)
        unit.advance(t)
        unit.uart.take(t, 57600)
        due.append(t)


def test_the_motion_is_sampled_at_its_time():
    unit = started(signal=Signal(function=lambda t: ((t - READY) * G, 0.0, -G)), rate=50.0)
    values = [float(re.search(rb"X=(.\d\.\d{3})", line)[1]) for line in lines(unit, 1.0)]
    assert values == pytest.approx([0.02 + 0.02 * k for k in range(len(values))], abs=0.005)
    assert len(values) > 40


def test_it_falls_silent_where_the_recording_ends():
    unit = started(signal=Signal(end=READY + 0.5))
    assert len(lines(unit, 5.0)) == 25
    assert unit.deadline() == math.inf


# --- errors ---


def test_noise_is_the_data_sheets():
    """0.35 mg/sqrt(Hz) up to a pole at 350 Hz is 8.2 mg, and a converter's step of 4 mg adds little."""
    unit = started(mode="raw", ideal=False)
    counts = np.array([[int(x) for x in line.split(b"\t")] for line in lines(unit, 60.0)])
    step = 3300.0 / 1023.0 / 800.0
    expected = math.hypot(0.35e-3 * math.sqrt(350.0 * math.pi / 2.0), step / math.sqrt(12.0))
    assert counts.std(axis=0) * step == pytest.approx([expected] * 3, rel=0.1)


def test_units_differ_and_seeds_repeat():
    def run(seed):
        return heard(started(ideal=False, seed=seed), READY + 1.0)

    assert run(5) == run(5) != run(6)


@pytest.mark.thorough
@given(st.lists(st.tuples(st.binary(max_size=30), st.floats(0.0, 1.0)), max_size=12))
def test_garbage_never_raises_and_the_board_stays_reachable(chunks):
    unit, t = board(), 0.0
    for data, pause in chunks:
        t += pause
        unit.receive(data, t)
        heard(unit, t)
    for _ in range(9):  # out of any sub-menu, and of the stream
        t += 5.0
        unit.receive(b"\xff" if unit.deadline() < math.inf else b"x", t)
    heard(unit, t + 5.0)
    if unit.deadline() == math.inf:
        unit.receive(b"x", t + 5.0)
    assert heard(unit, t + 15.0)
