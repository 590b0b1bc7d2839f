"""Epson's sensors over SPI: words against docs/protocols.md 1.6 and 1.7, dialogues and samples against emulators."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_c import in_c
from spi_memory import DPS, Constant, G, Memory, golden

from imud.drivers.detect import detect_spi
from imud.drivers.dialogue import Exchange
from imud.drivers.driver import Identity, Options
from imud.drivers.epson.dialects import FLAT, NARROW, WIDE, WINDOWED
from imud.drivers.epson.driver import DRIVER
from imud.drivers.epson.protocol import read_register_once, write_register
from imud.drivers.epson.registers import Register
from imud.drivers.epson.spi import fetch, over_spi, spi_carries
from imud.drivers.findings import NoAnswer
from imud.drivers.sample import SAMPLE
from imud.drivers.spi import Bus
from imud.firmware_sim.g350 import G350, TAPS_V340
from imud.firmware_sim.g370 import VARIANTS, Windowed
from imud.firmware_sim.noise import IDEAL, ImuErrors

SENSORS = {"g350": G350} | {
    name: lambda *scene, variant=variant: Windowed(variant, *scene) for name, variant in VARIANTS.items()
}


def converse(dialogue, answers):
    """The words that a dialogue sends, given the answers in turn; and its finding."""
    sent, heard = [], None
    try:
        while True:
            exchange = dialogue.send(heard)
            sent.append(exchange)
            heard = next(answers) if exchange.send else b""
    except StopIteration as finding:
        return sent, finding.value


def test_registers_in_words():
    bus = Bus(3, 500_000, 20)  # mode 3; 32 us and 20 us rest: more than 40 us from word to word
    sent, reply = converse(over_spi(read_register_once(Register(0x4C, 0))), iter([b"\0\0", bytes.fromhex("77775345")]))
    assert [exchange.send.hex() for exchange in sent if exchange.send] == ["fe00", "4c000000"]
    assert (sent[0].spi, sent[1].spi) == (bus, None)
    assert Register(0x4C, 0).answer(reply) == 0x5345
    sent, _ = converse(over_spi(write_register(Register(0x36), high=1)), iter([b"\0\0"]))
    assert sent[0].send.hex() == "b701"


def test_an_undriven_line_is_no_answer():
    assert Register(0x3C).answer(converse(over_spi(read_register_once(Register(0x3C))), iter([b"\xff" * 4]))[1]) is None


def test_a_waiting_is_only_that():
    def waiting():
        yield Exchange(listen_s=0.25)

    sent, _ = converse(over_spi(waiting()), iter(()))
    assert (sent[0].send, sent[0].listen_s, sent[0].enough) == (b"", 0.25, None)


def test_the_flat_dialect_is_fetched_register_by_register():
    plan = fetch(FLAT, FLAT.layouts[0], 1000.0)
    words = [cycle.word.hex() for cycle in plan.cycles]
    assert words == ["0000", "1200", "0200", "0400", "0600", "0800", "0a00", "0c00", "0e00", "1200", "0000"]
    assert plan.clock_hz <= 2_000_000
    for cycle in plan.cycles:
        assert cycle.stall_us >= 20
        assert 16e6 / plan.clock_hz + cycle.stall_us >= 40
    assert plan.bus_ns() == len(plan.cycles) * 40_000


@pytest.mark.parametrize(("layout", "words"), [(NARROW, 10), (WIDE, 17)])
def test_the_windowed_dialect_is_fetched_in_a_burst(layout, words):
    plan = fetch(WINDOWED, layout, 500.0)
    assert [cycle.word.hex() for cycle in plan.cycles] == ["0600", "0a00", "8000", *["0000"] * words]
    assert plan.clock_hz <= 1_000_000
    assert plan.cycles[2].stall_us >= 45
    assert min(cycle.stall_us for cycle in plan.cycles[3:]) >= 4


def test_what_a_bus_carries():
    assert spi_carries(FLAT)(FLAT.layouts[0]) > 1000.0
    assert 1000.0 < spi_carries(WINDOWED)(NARROW) < 2000.0
    assert 500.0 < spi_carries(WINDOWED)(WIDE) < spi_carries(WINDOWED)(NARROW)


# docs/protocols.md 1.5, synthetic vector, and COUNT 0x0102; the first answer belongs to what was sent before
FLAT_ANSWERS = bytes.fromhex("beef fe00 0102 c492 0064 ff9c 0000 0000 0000 1f40 0102")


def decode(frame, name):
    state = DRIVER.new_state(configured(name, Memory(SENSORS[name](*golden()))))
    rx, samples = np.zeros(4096, np.uint8), np.zeros(8, SAMPLE)
    rx[: 3 * len(frame)] = np.frombuffer(3 * frame, np.uint8)
    return samples[: in_c(DRIVER.decode)(rx, 3 * len(frame), state, samples)], state


def configured(name, memory, **options):
    found = memory.run(detect_spi())
    assert isinstance(found, Identity)
    return memory.run(DRIVER.configure(found, Options(**options)))


def test_answers_become_the_frame_of_a_uart():
    frame = fetch(FLAT, FLAT.layouts[0], 1000.0).frame(FLAT_ANSWERS)
    assert frame.hex() == "20fe00c4920064ff9c0000000000001f40000001020d"
    samples, _ = decode(frame, "g350")
    assert samples[0]["w"] == pytest.approx([1.25 * DPS, -1.25 * DPS, 0.0])
    assert samples[0]["f"] == pytest.approx([0.0, 0.0, G])
    assert samples[0]["temperature"] == pytest.approx(25.0)


@given(st.integers(0, 0xFFFF))
def test_words_of_two_samples_are_none(count):
    frame = fetch(FLAT, FLAT.layouts[0], 1000.0).frame(FLAT_ANSWERS[:-2] + count.to_bytes(2))
    assert bool(frame) == (count == 0x0102)


@pytest.mark.parametrize(
    ("flag", "new"), [("fe00", True), ("8000", True), ("0e01", True), ("0000", False), ("0001", False), ("ffff", False)]
)
def test_the_flag_word_tells_whether_a_sample_is_new(flag, new):
    assert fetch(FLAT, FLAT.layouts[0], 1000.0).is_new(bytes.fromhex(flag)) == new


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_is_found_and_identified_by_its_names(name):
    memory = Memory(SENSORS[name](*golden()))
    found = memory.run(detect_spi())
    assert found.spi
    assert found.model == {"g350": "M-G350"}.get(name) or found.model[2:].encode() == VARIANTS[name].product
    assert found.serial
    assert memory.spi.violations == {}
    assert b"\xbe\x08" not in memory.sent  # flash backup


def test_the_flat_sibling_has_a_table_of_filters_of_its_own():
    sensor = G350(*golden(), taps=TAPS_V340)
    product = b"V340PDD0"
    sensor._word |= {(0, 0x6A + i): product[i] | product[i + 1] << 8 for i in range(0, 8, 2)}
    memory = Memory(sensor)
    result = configured("v340", memory, rate_hz=125.0)
    assert (result.identity.model, result.rate_hz, result.warnings) == ("M-V340", 125.0, ())
    assert result.delay_ns == 3_500_000  # 8 taps at 1 kHz
    assert b"\xb8\x05" in memory.sent
    assert memory.spi.violations == {}


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("rate_hz", [1000.0, 500.0, 125.0, 15.625])
def test_samples_at_every_rate(name, rate_hz):
    memory = Memory(SENSORS[name](*golden()))
    result = configured(name, memory, rate_hz=rate_hz, self_test=rate_hz == 125.0)
    assert (result.rate_hz, result.warnings, result.identity.spi) == (rate_hz, (), True)
    assert result.delay_ns * rate_hz == pytest.approx(0.5e9 - rate_hz * 250_000)  # taps' group delay, no wire
    state = DRIVER.new_state(result)
    rx, samples = np.zeros(4096, np.uint8), np.zeros(64, SAMPLE)
    stream = b""
    for k in range(40):
        memory.now_s = max(memory.now_s, memory.spi.sensor.next_sample + 1e-5)
        stream += memory.sample()
        assert len(stream) == (k + 1) * result.frame_bytes
        assert memory.sample() == b""  # not twice
    rx[: len(stream)] = np.frombuffer(stream, np.uint8)
    n = in_c(DRIVER.decode)(rx, len(stream), state, samples)
    assert n == 40
    assert (state["lost"][0], state["bad"][0], state["junk"][0]) == (0, 0, 0)
    assert (np.diff(samples["tick"][:n]) == 1).all()
    assert samples["w"][:n] == pytest.approx(np.tile([1.25 * DPS, -1.25 * DPS, 0.0], (n, 1)), abs=0.01 * DPS)
    assert samples["f"][:n] == pytest.approx(np.tile([0.0, 0.0, G], (n, 1)), abs=1e-9)
    assert memory.spi.violations == {}


def test_more_than_the_bus_carries_is_lowered_with_a_warning():
    result = configured("g370", Memory(SENSORS["g370"](*golden())), rate_hz=2000.0)
    assert result.rate_hz == 1000.0
    assert "on SPI" in result.warnings[0]


@pytest.mark.parametrize("name", ["g350", "g370"])
def test_finer_words_where_there_is_time(name):
    length = configured(name, Memory(SENSORS[name](*golden())), rate_hz=500.0).frame_bytes
    assert length == (22 if name == "g350" else WIDE.length)


def test_news_and_data_ready_are_switched_on_whatever_they_were():
    memory = Memory(SENSORS["g350"](*golden()))
    rises = []
    memory.spi.sensor.on_data_ready = rises.append
    memory.bus = Bus(3, 500_000, 20)
    memory.words(bytes.fromhex("b300b400"))
    configured("g350", memory, rate_hz=500.0)
    assert len(rises) >= 3


def test_a_sensor_that_streams_on_its_uart_is_stopped():
    sensor = SENSORS["g350"](*golden())
    sensor.receive(bytes.fromhex("BA010DB9010D"), 0.9)
    result = configured("g350", Memory(sensor))
    assert result.rate_hz == 1000.0
    assert not sensor.streaming


def test_start_up_is_waited_for():
    memory = Memory(SENSORS["g370"](*golden()), now_s=0.1)
    assert isinstance(memory.run(detect_spi()), Identity)


class Dead:
    """A bus with nothing on it: the line in stays at one level."""

    def __init__(self, level):
        self.level, self.words, self.violations = level, 0, {}

    def transfer(self, data, t, clock_hz, mode):
        self.words += 1
        return bytes([self.level]) * len(data)


@pytest.mark.parametrize("level", [0x00, 0xFF])
def test_an_empty_bus_is_no_sensor(level):
    memory = Memory(SENSORS["g350"](*golden()))
    memory.spi = Dead(level)
    found = memory.run(detect_spi())
    assert isinstance(found, NoAnswer)
    assert "wired" in str(found)


def test_nothing_is_written_readonly():
    memory = Memory(SENSORS["g350"](*golden()))
    assert isinstance(memory.run(detect_spi(readonly=True)), NoAnswer)
    assert memory.sent == []


class Ramp(Constant):
    """Rates and forces that tell the time of the sample: in 1 ms they grow by 8 steps."""

    RADPS, MPS2 = 100.0 * DPS, 10.0  # per second

    def imu(self, t):
        return np.outer(t, [self.RADPS] * 3 + [self.MPS2] * 3)


@given(st.lists(st.floats(1e-4, 4e-3), min_size=10, max_size=40))
def test_whenever_it_is_fetched_a_flat_sample_is_of_one_piece_and_comes_once(pauses_s):
    memory = Memory(G350(Ramp(), ImuErrors(IDEAL, np.random.default_rng(1), 2000.0)))
    result = configured("g350", memory)
    state = DRIVER.new_state(result)
    stream = b""
    for pause_s in pauses_s:
        memory.now_s += pause_s
        stream += memory.sample()
    rx, samples = np.zeros(8192, np.uint8), np.zeros(128, SAMPLE)
    rx[: len(stream)] = np.frombuffer(stream, np.uint8)
    n = in_c(DRIVER.decode)(rx, len(stream), state, samples)
    assert n * result.frame_bytes == len(stream)
    times_s = np.hstack([samples["w"][:n] / Ramp.RADPS, samples["f"][:n] / Ramp.MPS2])
    assert np.ptp(times_s, axis=1).max(initial=0.0) < 0.4e-3
    assert np.diff(times_s[:, 0]).min(initial=1.0) > 0.6e-3
    assert memory.spi.violations == {}
