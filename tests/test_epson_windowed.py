"""Epson's windowed dialect: frames to samples. Oracle: golden bytes by hand, and a second decoder in plain Python."""

import math
import struct

import numpy as np
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
)
from hypothesis import given
from hypothesis import strategies as st

from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.epson.driver import DRIVER
from imud.drivers.epson.models import MODELS, model_of
from imud.drivers.sample import DEVICE_ERROR, SATURATED

G = 9.80665
NARROW, WIDE = 22, 36
# docs/protocols.md 1.7, M-G364PDCA: 25 degC, +0.375, -0.375 and 0 deg/s, +1 G, COUNT 1. The sum of the words, by hand:
# FE00 + 0A4A = 084A, + 0064 = 08AE, + FF9C = 084A, + 1F40 = 278A, + 0001 = 278B, carries dropped
GOLDEN = "80 FE00 0A4A 0064 FF9C 0000 0000 0000 1F40 0001 278B 0D"
# the same with 32 bits: x +0.376875 deg/s, z 1/65536 LSB; accelerometers 0, -1/65536 LSB, +1.00003125 G; COUNT 2:
# 084A + 0064 + 8000 = 88AE, + FF9C = 884A, + 0001 + FFFF + FFFF = 8849, + 1F40 + 4000 = E789, + 0002 = E78B
GOLDEN_WIDE = "80 FE00 0A4A0000 00648000 FF9C0000 00000001 00000000 FFFFFFFF 1F404000 0002 E78B 0D"


def configured(model="M-G364PDCA", length=NARROW):
    return ImuConfigured(Identity("epson", model), 1000.0, 1_000_000, 0, length)


def make(capacity=256, **options):
    return Decoder(DRIVER, configured(**options), capacity)


def frame(words=(0, 0, 0, 0, 0, 8000), count=0, flag=0xFE00, temperature=2634, length=NARROW):
    if length == NARROW:
        body = struct.pack(">H7hH", flag, temperature, *words, count & 0xFFFF)
    else:
        body = struct.pack(">H7iH", flag, temperature, *words, count & 0xFFFF)
    total = sum(body[0::2]) * 256 + sum(body[1::2])
    return b"\x80" + body + struct.pack(">H", total & 0xFFFF) + b"\r"


def reference(data, length, gyro_dps=0.00375, accel_mg=0.125):
    """Plain decoder of one undamaged frame: w, f, temperature, COUNT."""
    size = 2 if length == NARROW else 4
    fields = [int.from_bytes(data[3 + size * i : 3 + size * (i + 1)], "big", signed=True) for i in range(7)]
    values = [field / 65536 ** (size // 2 - 1) for field in fields]
    w = [math.radians(gyro_dps * value) for value in values[1:4]]
    f = [accel_mg * 1e-3 * G * value for value in values[4:]]
    return w, f, 25.0 - 0.0037918 * (values[0] - 2634), int.from_bytes(data[-5:-3], "big")


def raw_words(sample):
    """The six 16-bit words that a sample was made of."""
    gyro = sample["w"] / math.radians(0.00375)
    accel = sample["f"] / (0.125e-3 * G)
    return tuple(int(word) for word in np.round([*gyro, *accel]))


def words_of(decoder):
    return [raw_words(sample) for sample in decoder.samples]


WORD = st.one_of(st.integers(-32768, 32767), st.sampled_from([0, 0x0D0D, -0x7F80, 0x0D80, -0x7FF3, 0x000D]))
WORDS = st.tuples(*[WORD] * 6)
LONG = st.integers(-(1 << 31), (1 << 31) - 1)
STILL = (24, -3, 7, -697, -1366, -7848)


# --- what a frame means ---


def test_golden_frame():
    decoder = make().feed(bytes.fromhex(GOLDEN))
    (sample,) = decoder.samples
    np.testing.assert_allclose(np.degrees(sample["w"]), [0.375, -0.375, 0.0], rtol=1e-12)
    np.testing.assert_allclose(sample["f"], [0.0, 0.0, G], rtol=1e-12)
    assert (sample["temperature"], sample["tick"], sample["flags"]) == (25.0, 0, 0)
    assert [decoder[name] for name in ("frames", "junk", "bad", "lost", "errors")] == [1, 0, 0, 0, 0]


def test_golden_frame_of_32_bits():
    (sample,) = make(length=WIDE).feed(bytes.fromhex(GOLDEN_WIDE)).samples
    np.testing.assert_allclose(np.degrees(sample["w"]), [0.376875, -0.375, 0.00375 / 65536], rtol=1e-12)
    np.testing.assert_allclose(sample["f"], [0.0, -0.125e-3 * G / 65536, 1.00003125 * G], rtol=1e-12)
    assert sample["temperature"] == 25.0


def test_the_tests_own_frames_are_those_of_the_golden_bytes():
    assert frame((100, -100, 0, 0, 0, 8000), 1) == bytes.fromhex(GOLDEN)
    words = (0x648000, -100 << 16, 1, 0, -1, 0x1F404000)
    assert frame(words, 2, temperature=2634 << 16, length=WIDE) == bytes.fromhex(GOLDEN_WIDE)


# docs/protocols.md 1.0 and py_esensorlib's models: deg/s and mG per LSB, degC per LSB, the word at 25 degC
SCALES = {
    "G320PDG0": (0.008, 0.2, -0.0037918, 2634),
    "G330PDG0": (1 / 66, 0.25, 0.00390625, 0),
    "G354PDH0": (0.016, 0.2, -0.0037918, 2634),
    "G362PDC1": (0.005, 0.125, 0.0042725, -15214),
    "G364PDC0": (0.0075, 0.125, -0.0037918, 2634),
    "G364PDCA": (0.00375, 0.125, -0.0037918, 2634),
    "G365PDC1": (1 / 66, 0.16, -0.0037918, 2634),
    "G365PDF1": (1 / 66, 0.4, -0.0037918, 2634),
    "G366PDG0": (1 / 66, 0.25, 0.00390625, 0),
    "G370PDF1": (1 / 66, 0.4, -0.0037918, 2634),
    "G370PDS0": (1 / 150, 0.4, -0.0037918, 2634),
    "G370PDG0": (1 / 66, 0.25, 0.00390625, 0),
    "G370PDT0": (1 / 150, 0.25, 0.00390625, 0),
}


@pytest.mark.parametrize("product", SCALES)
@pytest.mark.parametrize("length", [NARROW, WIDE])
def test_every_model_has_scales_of_its_own(product, length):
    gyro, accel, temperature, raw_25 = SCALES[product]
    unit = 1 if length == NARROW else 65536
    words = (100 * unit, 0, 0, 0, 0, 1000 * unit)
    data = frame(words, temperature=(raw_25 + 256) * unit, length=length)
    (sample,) = make(model=f"M-{product}", length=length).feed(data).samples
    np.testing.assert_allclose(math.degrees(sample["w"][0]), 100 * gyro, rtol=1e-12)
    np.testing.assert_allclose(sample["f"][2], accel * G, rtol=1e-12)
    np.testing.assert_allclose(sample["temperature"], 25.0 + 256 * temperature, rtol=1e-12)


def test_no_model_hides_another():
    assert [model_of(model.name) for model in MODELS] == list(MODELS)
    assert [model_of(f"M-{product}") for product in SCALES] == list(MODELS[2:])


@given(st.lists(WORDS, min_size=1, max_size=30), st.integers(-32768, 32767))
def test_clean_streams_agree_with_the_reference(words, temperature):
    frames = [frame(w, 20 * k, temperature=temperature) for k, w in enumerate(words)]
    decoder = make().feed(b"".join(frames))
    for sample, data in zip(decoder.samples, frames, strict=True):
        w, f, degc, _ = reference(data, NARROW)
        np.testing.assert_allclose(sample["w"], w, rtol=1e-14)
        np.testing.assert_allclose(sample["f"], f, rtol=1e-14)
        assert sample["temperature"] == pytest.approx(degc, rel=1e-12)
    assert decoder.ticks == list(range(len(words)))
    assert decoder["junk"] == decoder["bad"] == decoder["lost"] == 0


@given(st.lists(st.tuples(*[LONG] * 6), min_size=1, max_size=20), LONG)
def test_clean_streams_of_32_bits_agree_with_the_reference(words, temperature):
    frames = [frame(w, k, temperature=temperature, length=WIDE) for k, w in enumerate(words)]
    decoder = make(length=WIDE).feed(b"".join(frames))
    for sample, data in zip(decoder.samples, frames, strict=True):
        w, f, degc, _ = reference(data, WIDE)
        np.testing.assert_allclose(sample["w"], w, rtol=1e-14)
        np.testing.assert_allclose(sample["f"], f, rtol=1e-14)
        assert sample["temperature"] == pytest.approx(degc, rel=1e-12)


@pytest.mark.parametrize(("words", "flags"), [((26666, 0, 0, 0, 0, 0), 0), ((0, -26667, 0, 0, 0, 0), SATURATED)])
def test_the_end_of_the_range_is_marked(words, flags):  # 100 deg/s at 0.00375 deg/s
    assert make().feed(frame(words)).flags == [flags]
    wide = [word << 16 for word in words]
    assert make(length=WIDE).feed(frame(wide, length=WIDE)).flags == [flags]


def test_a_fault_that_the_sensor_reports_is_marked():
    decoder = make().feed(frame(count=0) + frame(count=1, flag=0xFE01) + frame(count=2))
    assert decoder.flags == [0, DEVICE_ERROR, 0]
    assert decoder["errors"] == 1


# --- framing ---

FRAMES = st.lists(WORDS, min_size=1, max_size=20).map(lambda all_: [frame(w, 20 * k) for k, w in enumerate(all_)])


@pytest.mark.thorough
@given(damaged_streams(FRAMES), SIZES, CAPACITY)
def test_any_chunking_gives_the_same_samples(stream, sizes, capacity):
    check_any_chunking(make, stream, sizes, capacity)


@given(st.lists(WORDS, min_size=1, max_size=10), SIZES, CAPACITY)
def test_any_chunking_gives_the_same_samples_of_32_bits(words, sizes, capacity):
    stream = b"".join(frame([v << 16 for v in w], k, length=WIDE) for k, w in enumerate(words))
    check_any_chunking(lambda capacity: make(capacity, length=WIDE), stream[5:], sizes, capacity)


@given(st.one_of(st.binary(max_size=2000), st.lists(st.sampled_from([0x80, 0x0D, 0]), max_size=500).map(bytes)))
def test_garbage_neither_raises_nor_grows(noise):
    check_garbage(make(3), noise, [frame(STILL, k) for k in range(60)], held_back=1)


@given(st.lists(WORDS, min_size=1, max_size=10))
def test_a_frame_is_delivered_with_its_last_byte(words):
    check_last_byte(make(), [(frame(w, k), w) for k, w in enumerate(words)], raw_words)


@given(st.lists(WORDS, min_size=1, max_size=6), st.binary(max_size=60), st.integers(0, 21), st.lists(WORDS, max_size=4))
def test_good_frames_after_a_bad_one_are_never_lost(before, noise, kept, after):
    frames = [frame(w, k) for k, w in enumerate([*before, *after, STILL])]
    stream = b"".join(frames[: len(before)]) + frames[0][:kept] + noise + b"".join(frames[len(before) :])
    assert is_subsequence([*before, *after, STILL], words_of(make().feed(stream)))


MIDDLE = 40
CALM = [(k % 5, -(k % 3), k % 7, 2, 3, 8000 + k % 4) for k in range(80)]


def edited(edit, at, length):
    frames = [frame([v << 16 for v in w] if length == WIDE else w, 2 * k, length=length) for k, w in enumerate(CALM)]
    frames[MIDDLE] = with_damage(frames[MIDDLE], edit, at, 0x80)
    return frames


@pytest.mark.parametrize(
    ("edit", "length", "at"),
    [(e, length, at) for e in ("delete", "insert", "flip") for length in (NARROW, WIDE) for at in range(length)],
)
def test_damage_at_any_byte_costs_only_that_frame(edit, length, at):
    decoder = make(length=length).feed(b"".join(edited(edit, at, length)))
    spared = edit == "insert" and at <= 1  # a second header before the frame's own
    expected = [w for k, w in enumerate(CALM) if spared or k != MIDDLE]
    assert words_of(decoder) == expected
    assert decoder.ticks == [k for k in range(80) if spared or k != MIDDLE]
    assert (decoder["bad"], decoder["lost"]) == (1, 0 if spared else 1)


@pytest.mark.parametrize("step", [1, 2, 20, 128])
def test_lost_frames_are_counted_at_once_whatever_the_step_of_count(step):
    keep = [k for k in range(300) if k not in (150, 151, 152, 200)]
    decoder = make().feed(b"".join(frame(STILL, 60000 + step * k) for k in keep))
    assert decoder.ticks == keep
    assert decoder["lost"] == 4
    assert decoder["junk"] == decoder["bad"] == 0


@pytest.mark.parametrize("counts", [[7] * 100, [2 * (k % 60) + 40000 * (k < 60) for k in range(100)]])
def test_a_frozen_or_restarted_count_is_one_tick_a_frame(counts):
    decoder = make().feed(b"".join(frame(STILL, count) for count in counts))
    assert decoder.ticks == list(range(100))
    assert decoder["lost"] == 0
