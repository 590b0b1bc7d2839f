"""The serial accelerometer's lines to samples. Oracle on other than the golden lines: exact fractions in Python."""

import math
from fractions import Fraction

import pytest
from framer_properties import (
    CAPACITY,
    SIZES,
    Decoder,
    check_any_chunking,
    check_garbage,
    check_last_byte,
    damaged_streams,
    is_subsequence,
    with_damage,
)  # fmt: skip
from hypothesis import example, given
from hypothesis import strategies as st
from seraccel_lines import BINARY, GOLDEN, RAW, SUCCESSOR, raw

from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.sample import SATURATED, SUSPECT
from imud.drivers.seraccel.driver import DRIVER
from imud.drivers.seraccel.ranges import RANGES

G = 9.80665


def configured(model="SerAccel (±1.5 g)"):
    return ImuConfigured(Identity("seraccel", model), 50.0, 20_000_000, 0, 28, gyro_axes=(False, False, False))


def decoder(capacity=256, room=1 << 17, **model):
    return Decoder(DRIVER, configured(**model), capacity, room)


def board(sample):
    """What the board said, in g on its own axes: x forward, y left, z up."""
    return (sample["f"] * [1.0, -1.0, -1.0] / G).tolist()


# --- lines ---


def test_the_line_of_the_report():
    (sample,) = decoder().feed(GOLDEN).samples
    assert sample["f"].tolist() == [-0.501 * G, 0.007 * G, -0.082 * G]
    assert sample["w"].tolist() == sample["down"].tolist() == [0.0, 0.0, 0.0]
    assert math.isnan(sample["temperature"])
    assert (sample["tick"], sample["flags"]) == (0, 0)


def test_a_level_board_shows_specific_force():
    (sample,) = decoder().feed(b"X= 0.000 Y= 0.000 Z= 1.000\r\n").samples
    assert sample["f"].tolist() == [0.0, 0.0, -G]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (b"X=1.000 Y=+0.500 Z=-0.250\r\n", (1.0, 0.5, -0.25)),
        (b"X= -0.501,Y=-0.007,\tZ=0.082\n", (-0.501, -0.007, 0.082)),
        (b"X: 0.10 Y: 0.20 Z: 0.30 \n\r", (0.1, 0.2, 0.3)),
        (b"x=0.1y=0.2z=0.3\n", (0.1, 0.2, 0.3)),
        (SUCCESSOR, (0.01, -0.02, 1.0)),
        (b"-0.501, -0.007, 0.082\r", (-0.501, -0.007, 0.082)),
    ],
)
def test_layout_is_free(line, expected):
    (sample,) = decoder().feed(b"\n" + line).samples
    assert board(sample) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    "line",
    [
        b"X=-0.501 Y=-0.007\r\n",
        b"X=-0.501 Y=-0.007 Z=\r\n",
        b"X=-0.501 Z=-0.007 Y= 0.082\r\n",
        b"X=-0.501 Y=-0.007 Z= 0.082 0.001\r\n",
        b"X=-0.501 Y=-0.07 Z= 0.082\r\n",  # a digit is missing
        b"X=-0501 Y=-0.007 Z= 0.082\r\n",  # a point is
        b"X=-.501 Y=-.007 Z= .082\r\n",
        b"X=-0.501 Y=-0.007 Z= 0.0.2\r\n",
        b"X=-0.501 Y=--0.07 Z= 0.082\r\n",
        b"X=- 0.501 Y=- 0.007 Z= 0.082\r\n",
        b"0.5010.0070.082\r\n",
        b"X=1234567890.0 Y= 0.0 Z= 0.0\r\n",
        b"0512\t0498\t1024\r\n",  # more than ten bits
        b"0512\t-498\t0760\r\n",
        b"1 2\r\n",
        b"X Y Z\r\n",
        b"Selection: x\r\n",
        b"[1] Calibrate (Current Calibration Values: 1650, 1650, 1650)\r\n",
    ],
)
def test_what_is_no_line_is_skipped_and_the_next_is_not(line):
    got = decoder().feed(GOLDEN + line + GOLDEN)
    assert [board(sample)[0] for sample in got.samples] == [-0.501] * 2
    assert got["bad"] >= 1
    assert got["junk"] == len(line) - 2


@pytest.mark.parametrize("row", RANGES, ids=lambda row: f"{row.g:g} g")
def test_counts_are_millivolts(row):
    expected = [(count * 3300 / 1023 - 1650) / row.mv_per_g for count in (512, 498, 760)]
    samples = decoder(model=row.model).feed(b"\n" + RAW + BINARY).samples
    for sample in samples:
        assert board(sample) == pytest.approx(expected, abs=1e-12)
    assert [sample["tick"] for sample in samples] == [0, 1]


def test_a_line_cut_at_its_beginning_is_not_decoded_unless_it_has_labels():
    assert [board(sample) for sample in decoder().feed(b"12\t0498\t0760\n\r" + RAW).samples] == [
        board(decoder().feed(b"\n" + RAW).samples[0])
    ]
    assert len(decoder().feed(b"0.082\r\n" + GOLDEN).samples) == 1
    assert len(decoder().feed(b" 0.082" + GOLDEN).samples) == 1


NUMBER = st.integers(-5999, 5999)
MILLI = st.tuples(NUMBER, NUMBER, NUMBER)
COUNTS = st.tuples(*[st.integers(0, 1023)] * 3)


def gravity(values, end=b"\n"):
    return b"X=%s Y=%s Z=%s" % tuple(b"% .3f" % (value / 1000) for value in values) + end


def binary(counts):
    return b"#" + b"".join(count.to_bytes(2, "big") for count in counts) + b"$"


def milli(sample):
    return tuple(round(value * 1000) for value in board(sample))


def counts_of(sample):
    return tuple(round((value * 800 + 1650) * 1023 / 3300) for value in board(sample))


@given(st.lists(MILLI, min_size=1, max_size=40), st.sampled_from([b"\r\n", b"\n\r", b"\n", b"\r", b"\r\n\r\n"]))
def test_gravity_is_exact(values, end):
    got = decoder().feed(b"".join(gravity(row, end) for row in values))
    assert len(got.samples) == len(values)
    for sample, row in zip(got.samples, values, strict=True):
        exact = [float(Fraction(value, 1000)) * G for value in row]
        assert sample["f"].tolist() == [exact[0], -exact[1], -exact[2]]
    assert got.ticks == list(range(len(values)))
    assert (got["junk"], got["bad"], got["lost"]) == (0, 0, 0)


@given(st.lists(st.tuples(st.sampled_from([raw, binary]), COUNTS), min_size=1, max_size=40))
def test_counts_come_through_in_either_form(rows):
    got = decoder().feed(b"\n" + b"".join(form(counts) for form, counts in rows))
    # behind a binary frame a line must begin with a line end: it may be the rest of one
    kept = [c for k, (form, c) in enumerate(rows) if form is binary or k == 0 or rows[k - 1][0] is raw]
    assert [counts_of(sample) for sample in got.samples] == kept


# --- damage ---

ENDS = st.sampled_from([b"\r\n", b"\n\r"])
FRAMES = st.lists(
    st.one_of(st.builds(gravity, MILLI, ENDS), st.builds(raw, COUNTS, ENDS), st.builds(binary, COUNTS)), max_size=20
)


@given(damaged_streams(FRAMES), SIZES, CAPACITY)
def test_any_chunking_gives_the_same_samples(stream, sizes, capacity):
    check_any_chunking(decoder, stream, sizes, capacity)


STILL = [gravity((10, -20, 1000 + k % 3)) for k in range(20)]
STILL_COUNTS = [(515, 507, 759 + k % 2) for k in range(20)]


@given(st.binary(max_size=3000), st.sampled_from([0, 1, 2]))
def test_garbage_neither_raises_nor_hides_what_follows(noise, form):
    good = [STILL, [raw(counts) for counts in STILL_COUNTS], [binary(counts) for counts in STILL_COUNTS]][form]
    check_garbage(decoder(capacity=3), noise, good, held_back=1)


@given(st.lists(MILLI, min_size=2, max_size=6), st.binary(max_size=60), st.integers(0, 27), st.lists(MILLI, max_size=4))
@example([(0, 0, 1000)] * 2, b"X= 0.1 ", 9, [(1, 2, 3)])
def test_good_lines_after_a_bad_one_are_never_lost(before, noise, kept, after):
    bad = gravity(before[0])[:kept] + noise.replace(b"X", b"")
    stream = b"".join(map(gravity, before)) + bad + b"".join(map(gravity, after))
    assert is_subsequence([*before, *after], [milli(sample) for sample in decoder().feed(stream).samples])


@given(st.lists(MILLI, min_size=1, max_size=8), st.lists(COUNTS, min_size=1, max_size=8))
def test_a_line_is_delivered_with_its_end(values, counts):
    check_last_byte(decoder(), [(gravity(row), row) for row in values], milli)
    check_last_byte(decoder().feed(b"\n"), [(raw(row), row) for row in counts], counts_of)
    check_last_byte(decoder(), [(binary(row), row) for row in counts], counts_of)


@pytest.mark.parametrize("form", [gravity, lambda row: binary(tuple(512 + value // 16 for value in row))])
@pytest.mark.parametrize("kind", ["delete", "insert", "flip"])
def test_damage_at_every_offset_costs_at_most_that_line_and_a_tick_each(form, kind):
    values = [(10 * k, -10 * k, 1000 - 10 * k) for k in range(40)]
    frames = [form(row) for row in values]
    whole = [sample["f"].tolist() for sample in decoder().feed(b"".join(frames)).samples]
    for at in range(len(frames[30])):
        got = decoder().feed(b"".join([*frames[:30], with_damage(frames[30], kind, at), *frames[31:]]))
        forces = [sample["f"].tolist() for sample in got.samples]
        others = forces if len(forces) == 39 else forces[:30] + forces[31:]
        assert others == whole[:30] + whole[31:], at
        assert got.ticks[-1] == 39, at
        assert got["lost"] == 40 - len(got.samples)


def test_a_digit_that_became_another_is_suspect():
    lines = [*STILL, b"X= 4.010 Y=-0.020 Z= 1.000\n", *STILL]
    assert [k for k, flags in enumerate(decoder().feed(b"".join(lines)).flags) if flags] == [20]


def test_a_lost_sign_is_seen_in_the_width():
    flags = decoder().feed(b"".join([*STILL, b"X= 0.010 Y=0.020 Z= 1.000\n", *STILL])).flags
    assert [k for k, flag in enumerate(flags) if flag == SUSPECT] == [20]


def test_widths_that_vary_are_no_damage():
    lines = [b"X=%.3f Y=0.100 Z=1.000\n" % (0.05 * (-1) ** (k // 3)) for k in range(60)]
    assert set(decoder().feed(b"".join(lines)).flags) == {0}


def test_a_board_without_a_column_for_signs_is_learned():
    lines = [b"%.3f\t-0.100\t1.000\n\r" % (0.05 * (-1) ** (k % 10 == 9)) for k in range(100)]
    assert [k for k, flag in enumerate(decoder().feed(b"".join(lines)).flags) if flag] == [18, 28]


def test_another_width_is_learned():
    lines = [gravity((0, 0, 1000))] * 20 + [b" 0.00\t 0.00\t 1.00\n"] * 20
    assert decoder().feed(b"".join(lines)).flags[-15:] == [0] * 15


def test_the_end_of_the_range_is_marked():
    lines = [gravity((0, 0, value)) for value in (1000, 1400, 1740, 1760, 1760)]
    assert decoder().feed(b"".join(lines)).flags == [0, 0, 0, SATURATED, SATURATED]
    unknown = decoder(model="SerAccel").feed(b"".join(lines))
    assert unknown.flags == [0] * 5
