"""The Crossbow DMU RGA300CA: packets to samples, and its timer.

The golden packet was captured from a real unit (first commit of VRPN's Crossbow tracker). Oracle on other streams: a
decoder in plain Python after Prasanna's tables.
"""

import math

import numpy as np
import pytest
from crossbow_packets import SPACING, STILL, SUMS, packet, packets
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
from in_c import in_c

from imud.clocks.counter import new_clock, stamp
from imud.drivers.crossbow import timer
from imud.drivers.crossbow.driver import DRIVER
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.sample import DEVICE_ERROR, SATURATED, SUSPECT

G = 9.80665
GOLDEN = bytes.fromhex("AA55005BFF97FFEE005F005C2A59ADA20621012C000006BF")


def configured(rate_hz=100.0):
    return ImuConfigured(Identity("crossbow", "DMU RGA300CA"), rate_hz, 790, 0, 24, gyro_axes=(False, False, True))


def decoder(capacity=256, room=1 << 17, rate_hz=100.0):
    return Decoder(DRIVER, configured(rate_hz), capacity, room)


def content(sample):
    """Yaw rate and accelerations that a sample was made of, LSB."""
    return tuple(int(v) for v in np.rint([math.degrees(sample["w"][2]) * 32768 / 150, *-sample["f"] / G * 32768 / 3]))


WORD = st.one_of(st.integers(-32768, 32767), st.sampled_from([0, -21931, 0x55AA, -21846, 0x5555, -86]))
WORDS = st.tuples(*[WORD] * 6)
FRAMES = st.lists(st.builds(packet, WORDS, st.integers(0, 65535), bit=st.sampled_from([0, 0, 4])), max_size=20)


def test_the_captured_packet():
    (sample,) = decoder().feed(GOLDEN).samples
    assert np.degrees(sample["w"]).tolist() == pytest.approx([0.0, 0.0, -0.0824], abs=1e-4)
    assert (sample["f"] / G).tolist() == pytest.approx([-0.0087, -0.0084, -0.9925], abs=5e-5)
    down = sample["down"]
    assert math.degrees(math.atan2(down[1], down[2])) == pytest.approx(0.500, abs=5e-4)
    assert math.degrees(math.asin(-down[0])) == pytest.approx(-0.577, abs=5e-4)
    assert np.linalg.norm(down) == pytest.approx(1.0, abs=1e-12)
    assert sample["temperature"] == pytest.approx(24.0, abs=0.05)
    assert (sample["flags"], sample["tick"]) == (0, 0)
    assert packet(clock=0xADA2) == GOLDEN


@given(WORDS, st.integers(0, 65535))
def test_samples_agree_with_the_tables(words, temperature):
    (sample,) = decoder().feed(packet(words, temperature=temperature)).samples
    roll, pitch, yaw_rate, *gravity = words
    np.testing.assert_allclose(sample["w"], [0.0, 0.0, math.radians(yaw_rate * (100 * 1.5) / 2**15)], rtol=1e-12)
    np.testing.assert_allclose(sample["f"], [-g * (2 * 1.5) / 2**15 * G for g in gravity], rtol=1e-12)
    roll, pitch = (math.radians(angle * 180 / 2**15) for angle in (roll, pitch))
    turn_x = np.array([[1, 0, 0], [0, math.cos(roll), math.sin(roll)], [0, -math.sin(roll), math.cos(roll)]])
    turn_y = np.array([[math.cos(pitch), 0, -math.sin(pitch)], [0, 1, 0], [math.sin(pitch), 0, math.cos(pitch)]])
    np.testing.assert_allclose(sample["down"], turn_x @ turn_y @ [0.0, 0.0, 1.0], atol=1e-12)
    assert sample["temperature"] == pytest.approx(44.44 * (temperature * 5 / 4096 - 1.375), rel=1e-12, abs=1e-9)


@pytest.mark.thorough
@given(damaged_streams(FRAMES), SIZES, CAPACITY)
def test_any_chunking_gives_the_same_samples(stream, sizes, capacity):
    check_any_chunking(decoder, stream, sizes, capacity)


@given(st.binary(max_size=3000))
@example(b"\xaa\x55" * 500)
@example(b"\xaa" * 500)
def test_garbage_neither_raises_nor_grows(noise):
    check_garbage(decoder(3, 4096), noise, packets(60))


@given(st.lists(WORDS, max_size=4), st.binary(max_size=60), st.integers(0, 23), st.lists(WORDS, max_size=4))
@example([], b"\xaa\x55", 0, [])
def test_good_packets_after_a_bad_one_are_neither_lost_nor_held_back(before, noise, kept, after):
    decoding = decoder().feed(b"".join(map(packet, before)) + packet()[:kept] + noise)
    check_last_byte(decoding, [(packet(words), words[2:]) for words in [*after, STILL]], content)
    assert is_subsequence([words[2:] for words in [*before, *after, STILL]], map(content, decoding.samples))


@pytest.mark.parametrize("kind", ["delete", "insert", "flip"])
def test_damage_at_every_byte_costs_exactly_that_packet(kind):
    for at in range(24):
        frames = [packet((k, -k, 3 * k, 100 + k, -k, 9000 - k), -k * SPACING) for k in range(60)]
        frames[40] = with_damage(frames[40], kind, at, 0x3C)
        decoding = decoder().feed(b"".join(frames))
        whole = {("insert", 0): True}.get((kind, at), False)  # the byte stands before the packet, which is whole
        expected = [k for k in range(60) if k != 40 or whole]
        assert [content(sample)[0] for sample in decoding.samples] == [3 * k for k in expected], at
        assert decoding.ticks == [k * SPACING for k in expected]
        assert decoding["lost"] == 60 - len(expected)
        assert decoding["junk"] == len(frames[40]) - 24 * whole
        assert decoding["bad"] == 1


@pytest.mark.parametrize("name", list(SUMS)[1:])
def test_another_checksum_is_taken_once_it_fits_twenty_times(name):
    odd = [packet((91, -105, k, 95, 92, 10841), -k * SPACING, checksum=SUMS[name]) for k in range(60)]
    decoding = decoder().feed(b"".join(odd))
    assert [content(sample)[0] for sample in decoding.samples] == list(range(20, 60))
    usual = b"".join(packets(5))
    decoding = decoder().feed(b"".join(usual + b"".join(odd[:19]) for _ in range(5)))
    assert decoding["frames"] == 25
    torn = b"".join(b"".join(odd[k : k + 10]) + b"\0" for k in range(0, 60, 10))
    assert decoder().feed(torn)["frames"] == 0


def test_the_checksum_conventions_are_distinguished():
    body = GOLDEN[2:22]
    assert [sums(body) for sums in SUMS.values()] == [0x06BF, 0xDFE3, 0xDFE5, 0xBF]


@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("spacing", [7911, 12658, 31000, 50000, 126582, 632911])
def test_the_timer_is_unwrapped_in_both_directions(direction, spacing):
    rng = np.random.default_rng(spacing)
    # the unit's own sampling makes the spacing uneven
    at = np.cumsum(rng.integers(-3000, 3000, 300) + spacing)
    stream = b"".join(packet(clock=int(direction * t)) for t in at)
    ticks = np.array(decoder(rate_hz=1e9 / 790 / spacing).feed(stream).ticks)
    learned = 80 if spacing == 31000 else 25  # near half a turn both ways look alike
    assert (np.diff(ticks)[learned:] == np.diff(at)[learned:]).all()
    assert (np.diff(ticks)[:15] == spacing).all()  # not learned yet


@pytest.mark.parametrize("clock", [lambda k: 7, lambda k: (k * k * 7919) ^ (k << 7)])
def test_a_constant_or_random_timer_is_ignored(clock):
    decoding = decoder().feed(b"".join(packet(clock=clock(k)) for k in range(300)))
    assert decoding.ticks == [k * SPACING for k in range(300)]
    assert decoding["lost"] == 0


@given(st.lists(st.integers(1, 4), max_size=30))
def test_the_timer_counts_lost_packets(steps):
    at = list(range(30)) + [29 + sum(steps[: k + 1]) for k in range(len(steps))]
    decoding = decoder().feed(b"".join(packet(clock=-k * SPACING) for k in at))
    assert decoding.ticks == [k * SPACING for k in at]
    assert decoding["lost"] == at[-1] - len(at) + 1


@pytest.mark.parametrize("seed", [1, 2])
def test_stamps_follow_the_uneven_sampling_of_the_unit(seed):
    """The unit's clock is 500 ppm fast, it samples every 3.5 ms and sends the latest sample every 10 ms."""
    rng = np.random.default_rng(seed)
    sampled = np.floor(np.arange(3000) * 0.01 / 3.5e-3) * 3.5e-3  # s
    frames = [packet(clock=-int(t * (1.0 + 500e-6) / 0.79e-6)) for t in sampled]
    ticks = decoder().feed(b"".join(frames)).ticks
    arrivals = np.arange(3000) * 0.01 + 6.25e-3 + rng.exponential(3e-4, 3000)
    clock = new_clock(790.0, 6.25e6)
    stamps = [in_c(stamp)(clock[0], tick, int(t * 1e9)) for tick, t in zip(ticks, arrivals, strict=True)]
    error = np.array(stamps) * 1e-9 - sampled
    assert np.abs(error[1000:]).max() < 0.5e-3
    assert np.std(np.arange(3000) * 0.01 - sampled) > 0.9e-3  # what a fixed spacing would make of it


def test_faults_and_range_are_marked():
    level, fast = (0, 0, 0, 0, 0, 10922), (0, 0, 21845, 0, 0, 10922)
    frames = [packet(level), packet(level, bit=4), packet(level, bit=16), packet(level, bit=0xC0), packet(fast)]
    decoding = decoder().feed(b"".join([*frames, packet(fast)]))
    assert decoding.flags == [0, DEVICE_ERROR, DEVICE_ERROR, 0, SUSPECT, SATURATED]
    assert (decoding["errors"], decoding["suspect"]) == (2, 1)


def test_damage_that_the_sum_of_bytes_does_not_see_is_suspect():
    frames = packets(50)
    middle = bytearray(frames[40])
    middle[12], middle[2] = middle[12] ^ 0x20, middle[2] ^ 0x20  # one bit set, one cleared: the sum stays
    frames[40] = bytes(middle)
    assert sum(middle) == sum(packet(clock=-40 * SPACING))
    decoding = decoder().feed(b"".join(frames))
    assert [k for k, flags in enumerate(decoding.flags) if flags] == [40]


@pytest.mark.parametrize(("rate", "guess"), [(100.0, 96.0), (20.0, 21.0), (160.0, 155.0), (5.0, 5.2)])
@pytest.mark.parametrize("direction", [-1, 1])
def test_the_rate_follows_from_the_timer(rate, guess, direction):
    timers = [round(direction * k / rate / 0.79e-6) & 0xFFFF for k in range(200) if k % 17]
    assert 1e9 / timer.spacing_ns(timers, 1e9 / guess) == pytest.approx(rate, rel=5e-3)
    frozen = [5] * 100
    assert timer.spacing_ns(frozen, 1e9 / guess) == 1e9 / guess
