"""Epson automatic frames: bytes to samples. Oracle on clean streams: a second decoder in plain Python."""

import math
import struct

import framer_properties
import numpy as np
import pytest
from framer_properties import (
    CAPACITY,
    SIZES,
    check_any_chunking,
    check_garbage,
    check_last_byte,
    damaged_streams,
    is_subsequence,
    with_damage,
)
from hypothesis import example, given
from hypothesis import strategies as st

from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.epson.driver import DRIVER
from imud.drivers.sample import DEVICE_ERROR, POWER_ON, SATURATED, SUSPECT

G = 9.80665
GOLDEN = "20 FE00 C492 0064 FF9C 0000 0000 0000 1F40 0000"  # docs/protocols.md 1.5: 25 degC, +-1.25 dps, +1 G


def configured(model="M-G350", rate_hz=1000.0):
    return ImuConfigured(Identity("epson", model), rate_hz, round(1e9 / rate_hz), 0, 22)


class Decoder(framer_properties.Decoder):
    """The kernel, with frames read back as words."""

    def __init__(self, capacity=256, room=1 << 17, **model):
        super().__init__(DRIVER, configured(**model), capacity, room)

    def words(self):
        return [raw_words(sample) for sample in self.samples]


def raw_words(sample):
    """The six words that a sample was made of."""
    gyro = sample["w"] / math.radians(0.0125)
    accel = sample["f"] / (0.125e-3 * G)
    return tuple(int(word) for word in np.round([*gyro, *accel]))


def frame(words=(0, 0, 0, 0, 0, 8000), count=None, flag=0xFE00, temperature=-15214, gpio=0):
    tail = b"" if count is None else struct.pack(">H", count & 0xFFFF)
    return b"\x20" + struct.pack(">Hh6hH", flag, temperature, *words, gpio) + tail + b"\r"


def reference(stream, length):
    """Plain decoder of an undamaged stream: (w, f, temperature) per frame."""
    for p in range(0, len(stream), length):
        word = [int.from_bytes(stream[p + 1 + 2 * i : p + 3 + 2 * i], "big", signed=True) for i in range(8)]
        w = [math.radians(0.0125 * value) for value in word[2:5]]
        f = [0.125e-3 * G * value for value in word[5:8]]
        yield w, f, 25.0 + 0.0042725 * (word[1] + 15214)


WORD = st.one_of(st.integers(-32768, 32767), st.sampled_from([0, 0x0D0D, 0x2020, 0x200D, 0x0D20, 0x20FE, 0x000D]))
WORDS = st.tuples(*[WORD] * 6)
STILL = (24, -3, 7, -697, -1366, -7848)


@pytest.mark.parametrize("count", [None, 0])
def test_golden_frame(count):
    tail = "" if count is None else "{:04X}"
    stream = b"".join(bytes.fromhex(GOLDEN + tail.format(k) + "0D") for k in range(3))
    decoder = Decoder().feed(stream)
    assert len(decoder.samples) == 3
    for sample in decoder.samples:
        np.testing.assert_allclose(np.degrees(sample["w"]), [1.25, -1.25, 0.0], rtol=1e-12)
        np.testing.assert_allclose(sample["f"], [0.0, 0.0, 1.0 * G], rtol=1e-12)
        assert sample["temperature"] == 25.0
        assert sample["flags"] == 0
    assert decoder.ticks == [0, 1, 2]
    assert (decoder["frames"], decoder["junk"], decoder["bad"], decoder["lost"]) == (3, 0, 0, 0)


def test_the_sibling_has_scales_of_its_own():
    sample = Decoder(model="M-V340").feed(frame((100, 0, 0, 0, 0, 1000), temperature=2634) * 2).samples[1]
    np.testing.assert_allclose(math.degrees(sample["w"][0]), 1.5, rtol=1e-12)
    np.testing.assert_allclose(sample["f"][2], 0.18 * G, rtol=1e-12)
    assert sample["temperature"] == 25.0


@given(st.lists(WORDS, min_size=2, max_size=40), st.booleans(), st.integers(-32768, 32767), st.integers(0, 65535))
def test_clean_streams_agree_with_the_reference(words, numbered, temperature, gpio):
    frames = [frame(w, k if numbered else None, temperature=temperature, gpio=gpio) for k, w in enumerate(words)]
    decoder = Decoder().feed(b"".join(frames))
    expected = list(reference(b"".join(frames), len(frames[0])))
    assert len(decoder.samples) == len(expected)
    for sample, (w, f, degc) in zip(decoder.samples, expected, strict=True):
        np.testing.assert_allclose(sample["w"], w, rtol=1e-14)
        np.testing.assert_allclose(sample["f"], f, rtol=1e-14)
        assert sample["temperature"] == pytest.approx(degc, rel=1e-12)
    assert decoder.ticks == list(range(len(words)))
    assert decoder["junk"] == decoder["bad"] == decoder["lost"] == 0


@st.composite
def frame_lists(draw):
    """Frames of one sensor."""
    numbered = draw(st.booleans())
    gpio = st.sampled_from([0, 0, 0, 0, 0x100])
    return [frame(draw(WORDS), 20 * k if numbered else None, gpio=draw(gpio)) for k in range(draw(st.integers(2, 30)))]


@pytest.mark.thorough
@given(damaged_streams(frame_lists()), SIZES, CAPACITY)
def test_any_chunking_gives_the_same_samples(stream, sizes, capacity):
    check_any_chunking(Decoder, stream, sizes, capacity)


@given(st.binary(max_size=3000))
def test_garbage_neither_raises_nor_grows(noise):
    decoder = Decoder(capacity=3, room=4096)
    check_garbage(decoder, noise, [frame(STILL, k) for k in range(60)], held_back=2)
    assert raw_words(decoder.samples[-1]) == STILL


@given(st.lists(WORDS, min_size=3, max_size=6), st.binary(max_size=60), st.integers(0, 22), st.lists(WORDS, max_size=4))
def test_good_frames_after_a_bad_one_are_never_lost(before, noise, kept, after):
    for numbered in (False, True):
        frames = [frame(w, k if numbered else None) for k, w in enumerate([*before, *after, STILL, STILL])]
        stream = b"".join(frames[: len(before)]) + frames[0][:kept] + noise + b"".join(frames[len(before) :])
        assert is_subsequence([*before, *after, STILL, STILL], Decoder().feed(stream).words())


CALM = st.tuples(
    *[st.integers(-32768, 32767).filter(lambda word: 0x20 not in word.to_bytes(2, "big", signed=True))] * 6
)


@given(st.lists(CALM, min_size=3, max_size=6), st.binary(max_size=60), st.integers(0, 22), CALM, st.booleans())
@example([STILL] * 3, b"", 9, (0, 0, 0x0D, 0, 0, 0), False)
def test_a_good_frame_is_delivered_with_its_last_byte(words, noise, kept, last, numbered):
    """Also after a bad one, unless the damage looks like the beginning of yet another frame."""
    good = [frame(w, k if numbered else None) for k, w in enumerate(words)]
    decoder = Decoder().feed(b"".join(good))
    decoder.feed(good[-1][:kept] + noise.replace(b" ", b""))
    for k, values in enumerate((last, words[0]), start=len(good) + 1):
        check_last_byte(decoder, [(frame(values, k if numbered else None), values)], raw_words)


def test_a_frame_put_together_by_a_loss_does_not_hide_the_good_one():
    lead = frame(STILL) * 3
    hidden = frame((0, 0, 0x000D, 0, 0, 0))  # 00 0D inside: half of the frame before it and this make a frame
    spliced = frame((0,) * 6)[:9] + hidden
    decoder = Decoder().feed(lead + spliced + frame(STILL))
    assert (0, 0, 0x000D, 0, 0, 0) in decoder.words()
    assert decoder.words()[-1] == STILL


MIDDLE, TOTAL = 40, 60


def edited(kind, at, length):
    frames = [frame((k, -k, 3 * k, 100 + k, -k, 8000 - k), 2 * k if length == 22 else None) for k in range(TOTAL)]
    frames[MIDDLE] = with_damage(frames[MIDDLE], kind, at)
    return frames


@pytest.mark.parametrize("length", [20, 22])
@pytest.mark.parametrize("kind", ["delete", "insert", "flip"])
def test_damage_at_every_offset_of_one_frame_costs_at_most_that_frame(kind, length):
    for at in range(length):
        decoder = Decoder().feed(b"".join(edited(kind, at, length)))
        expected = [(k, -k, 3 * k, 100 + k, -k, 8000 - k) for k in range(TOTAL)]
        got = decoder.words()
        others = expected[:MIDDLE] + expected[MIDDLE + 1 :]
        if len(got) == TOTAL:  # the frame came through, damaged or not
            assert got[:MIDDLE] + got[MIDDLE + 1 :] == others
        else:
            assert got == others
        assert decoder.ticks == sorted(set(decoder.ticks))
        assert decoder.ticks[-1] == TOTAL - 1, at
        assert decoder["lost"] == TOTAL - len(got)


@pytest.mark.parametrize("at", [5, 7, 9, 11, 13, 15])
def test_a_flipped_high_bit_is_suspect_and_nothing_else_is(at):
    decoder = Decoder().feed(b"".join(edited("flip", at, 22)))  # 0x40 in the high byte: 16384 LSB
    assert [k for k, flags in enumerate(decoder.flags) if flags] == [MIDDLE]
    assert decoder.flags[MIDDLE] == SUSPECT
    assert decoder["suspect"] == 1


@pytest.mark.parametrize("step", [1, 2, 20, 1000])
def test_count_is_turned_into_ticks_whatever_its_step(step):
    keep = [k for k in range(300) if k not in (150, 151, 152, 200)]
    decoder = Decoder().feed(b"".join(frame(STILL, 60000 + step * k) for k in keep))
    late = {153, 154, 201, 202}  # one tick a frame: their COUNT may be damage, in both alike, until the third agrees
    assert [t for t, k in zip(decoder.ticks, keep, strict=True) if k not in late] == [k for k in keep if k not in late]
    assert decoder.ticks == sorted(set(decoder.ticks))
    assert decoder["lost"] == 4


@given(st.integers(0, 15))
def test_a_damaged_count_does_not_move_the_ticks(bit):
    counts = [2 * k for k in range(100)]
    counts[70] ^= 1 << bit
    decoder = Decoder().feed(b"".join(frame(STILL, count) for count in counts))
    assert decoder.ticks == list(range(100))
    assert decoder["lost"] == 0


def test_two_counts_damaged_alike_do_not_move_the_ticks():
    counts = [0x28A0 + 2 * k for k in range(100)]
    counts[70:72] = [count & 0xFF | 0x2000 for count in counts[70:72]]  # the header's byte, as a real line might
    decoder = Decoder().feed(b"".join(frame(STILL, count) for count in counts))
    assert decoder.ticks == list(range(100))
    assert decoder["lost"] == 0


@pytest.mark.parametrize("counts", [[7] * 100, [2 * (k % 60) + 40000 * (k < 60) for k in range(100)]])
def test_a_frozen_or_restarted_count_is_one_tick_a_frame(counts):
    decoder = Decoder().feed(b"".join(frame(STILL, count) for count in counts))
    assert decoder.ticks == list(range(100))
    assert decoder["lost"] == 0


@pytest.mark.parametrize("last", [40_000, 65_000, 300])
@pytest.mark.parametrize("lost", [0, 5])
def test_a_count_that_begins_anew_is_a_sensor_that_was_switched_on(last, lost):
    """After silence; its first frames may be lost."""
    counts = [*range(last - 60, last + 1), *range(lost, 60 + lost)]
    decoder = Decoder().feed(b"".join(frame(STILL, count) for count in counts))
    assert [flags for flags in decoder.flags if flags] == [POWER_ON]
    assert decoder.flags.index(POWER_ON) - 61 < 4
    assert decoder.ticks == list(range(121))
    assert decoder["lost"] == 0


@pytest.mark.parametrize(
    "counts",
    [
        range(65_500, 65_700),
        [*range(60), *range(3_000, 3_060)],
        [*range(65_470, 65_530), *range(65_537, 65_600)],  # lost while it wraps
        [7] * 100,
    ],
)
def test_a_count_that_wraps_or_jumps_elsewhere_shows_no_switch_on(counts):
    decoder = Decoder().feed(b"".join(frame(STILL, count) for count in counts))
    assert not any(decoder.flags)


def test_a_changed_input_pin_renews_the_lock_without_loss():
    stream = b"".join(frame((k, 0, 0, 0, 0, 0), k, gpio=0x0100 if 20 <= k < 40 else 0) for k in range(60))
    decoder = Decoder().feed(stream)
    assert [words[0] for words in decoder.words()] == list(range(60))
    assert decoder.ticks == list(range(60))
    assert decoder["junk"] == 0


def test_the_other_frame_length_is_found_after_a_restart():
    decoder = Decoder().feed(frame(STILL) * 10 + b"".join(frame(STILL, k) for k in range(100)))
    assert decoder["length"] == 22
    assert decoder["frames"] >= 10 + 50


def test_faults_and_range_are_marked():
    calm, strong = (0, 0, 0, 0, 0, 8000), (0, 0, 24000, 0, 0, 8000)
    frames = [frame(calm), frame(calm, flag=0xFE01), frame(calm), frame(strong), frame(strong)]
    decoder = Decoder().feed(b"".join(frames))
    assert decoder.flags == [0, DEVICE_ERROR, 0, SUSPECT, SATURATED]
    assert decoder["errors"] == 1


@given(
    st.floats(1.0, 499.0),
    st.floats(100.0, 24000.0),
    st.integers(0, 5),
    st.floats(0.0, 6.3),
    st.sampled_from([125.0, 1000.0]),
)
def test_motion_is_never_called_damage_for_more_than_three_samples(hz, amplitude, axis, phase, rate):
    values = [0] * 50 + [round(amplitude * math.sin(2 * math.pi * hz * k / 1000.0 + phase)) for k in range(200)]
    stream = b"".join(frame([value if i == axis else 0 for i in range(6)], k) for k, value in enumerate(values))
    runs = "".join("x" if flags & SUSPECT else " " for flags in Decoder(rate_hz=rate).feed(stream).flags).split()
    assert max(map(len, runs), default=0) <= 3
    assert sum(map(len, runs)) <= 12


@given(st.integers(-24000, 24000), st.integers(-24000, 24000), st.integers(0, 5))
def test_a_step_of_the_motion_comes_through_with_its_second_sample(before, after, axis):
    words = [[value if i == axis else 0 for i in range(6)] for value in [before] * 30 + [after] * 30]
    flags = Decoder().feed(b"".join(frame(word, k) for k, word in enumerate(words))).flags
    assert not any(flag & SUSPECT for flag in flags[:30] + flags[31:])
