"""The emulated sensors' side of SPI, word by word, against docs/protocols.md 1.3 to 1.7; without the driver."""

import pytest
from spi_memory import golden

from imud.firmware_sim.epson_spi import EpsonSpi
from imud.firmware_sim.g350 import G350
from imud.firmware_sim.g370 import G370, Windowed

READY_S = 1.0
ONES = b"\xff\xff"


class Host:
    """Sends words as a careful host does, unless asked otherwise."""

    def __init__(self, spi):
        self.spi, self.now_s = spi, READY_S

    def send(self, *words, clock_hz=500_000, mode=3, stall_us=20.0):
        answers = []
        for word in words:
            answers.append(self.spi.transfer(bytes.fromhex(word), self.now_s, clock_hz, mode).hex())
            self.now_s += 4 * len(word) / clock_hz + stall_us * 1e-6
        return answers

    def wait(self, seconds):
        self.now_s += seconds
        self.spi.sensor.advance(self.now_s)


@pytest.fixture
def flat():
    return Host(EpsonSpi(G350(*golden())))


@pytest.fixture
def windowed():
    return Host(EpsonSpi(Windowed(G370, *golden())))


def test_the_answer_to_a_word_comes_with_the_next(flat):
    # MODE_CTRL 0x38: configuration mode b10, filter code 1; GLOB_CMD 0x3E; product "G350PD11", low bytes first
    assert flat.send("3800", "3e00", "6a00", "6c00", "6e00", "7000", "0000")[1:] == [
        "0401", "0000", "3347", "3035", "4450", "3131",
    ]  # fmt: skip
    assert flat.spi.violations == {}


def test_a_write_takes_effect_and_both_bytes_are_apart(flat):
    flat.send("b703", "b805")  # rate code 3, filter code 5
    assert flat.send("3600", "3800", "0000")[1:] == ["0300", "0405"]


def test_a_sample_of_the_flat_dialect_is_read_word_by_word(flat):
    flat.send("b702", "d001", "b901")
    flat.wait(0.0025)  # one sample at 500 per second
    words = ["0000", "0200", "0400", "0600", "0800", "0a00", "0c00", "0e00", "1200", "0000"]
    # docs/protocols.md 1.5, synthetic vector; COUNT in 2 kHz ticks
    assert flat.send(*words)[1:] == ["fe00", "c492", "0064", "ff9c", "0000", "0000", "0000", "1f40", "0004"]
    assert flat.send("0000", "0000")[1] == "0000"  # read: nothing new
    assert flat.spi.violations == {}


def test_a_burst_of_the_windowed_dialect_ends_in_the_sum_of_its_words(windowed):
    windowed.send("fe01", "8c07", "8df0", "8f70", "8502", "fe00", "8301")  # all fields, 32 bits, 500 per second
    windowed.wait(0.0025)
    windowed.send("8000", clock_hz=1_000_000, stall_us=45.0)
    answers = [int(word, 16) for word in windowed.send(*["0000"] * 18, clock_hz=1_000_000, stall_us=4.0)]
    assert answers[0] == 0xFE00
    assert answers[1:3] == [2634, 0]  # 25 degC
    assert answers[3:5] == [82, 32768]  # 1.25 dps in steps of 1/66 dps: 82.5
    assert answers[13:15] == [2500, 0]  # 1 G in steps of 0.4 mg
    assert answers[-1] == sum(answers[:-1]) & 0xFFFF
    assert windowed.spi.violations == {}


def test_another_command_ends_a_burst(windowed):
    windowed.send("fe00", "8301")
    windowed.wait(0.01)
    windowed.send("8000", stall_us=45.0)
    windowed.send("0000")
    assert windowed.send("4c00", "0000")[1] == "5345"


@pytest.mark.parametrize(
    ("rule", "how"),
    [
        ("stall", {"stall_us": 19.0}),
        ("period", {"stall_us": 21.0, "clock_hz": 2_000_000}),
        ("clock", {"clock_hz": 2_100_000, "stall_us": 40.0}),
        ("mode", {"mode": 0}),
    ],
)
def test_a_word_that_breaks_a_rule_is_ignored(flat, rule, how):
    flat.send("b703")
    answers = flat.send("b704", "b704", "3600", "3600", **how)
    assert answers[-1] == ONES.hex()
    assert set(flat.spi.violations) == {rule}
    flat.wait(1e-3)
    assert flat.send("3600", "0000")[1] == ("0300" if rule in ("mode", "clock") else "0400")


def test_a_transfer_of_several_words_has_no_stall(flat):
    assert flat.send("38003e000000")[0].endswith("ffffffff")
    assert flat.spi.violations == {"stall": 2}


def test_half_a_word_is_nothing(flat):
    assert flat.send("38") == ["ff"]
    assert flat.spi.violations == {"length": 1}


@pytest.mark.parametrize(
    ("stalls", "clock_hz", "rule"),
    [((44, 5), 1_000_000, "stall"), ((45, 3), 1_000_000, "stall"), ((45, 5), 1_500_000, "clock")],
)
def test_a_burst_has_rules_of_its_own(windowed, stalls, clock_hz, rule):
    windowed.send("fe00", "8301")
    windowed.wait(0.01)
    windowed.send("8000", clock_hz=1_000_000, stall_us=stalls[0])
    windowed.send("0000", "0000", clock_hz=clock_hz, stall_us=stalls[1])
    assert windowed.spi.violations[rule] >= 1


def test_nothing_is_read_in_uart_auto_mode_but_it_can_be_left(flat):
    flat.send("ba01", "b901")
    assert flat.send("3800", "0000")[1] == ONES.hex()
    assert flat.spi.violations == {"auto": 2}
    flat.send("b902")
    assert flat.send("3800", "0000")[1] == "0401"


def test_during_start_up_only_not_ready_can_be_read(flat):
    flat.now_s = 0.1
    assert flat.send("3e00", "0000", "3800", "0000")[1::2] == ["0400", ONES.hex()]


def test_a_soft_reset_starts_it_again(flat):
    flat.send("b703", "be80")
    assert flat.send("3e00", "0000")[1] == "0400"
    flat.wait(0.9)
    assert flat.send("3600", "0000")[1] == "0100"


def test_the_data_ready_line_rises_with_every_sample(flat):
    rises = []
    flat.spi.sensor.on_data_ready = rises.append
    flat.send("b702", "b901")
    begun_s = flat.now_s - 20e-6
    flat.wait(0.011)
    assert rises == pytest.approx([begun_s + 0.002 * k for k in range(1, 6)])
    assert flat.spi.sensor.next_sample == pytest.approx(begun_s + 0.012)


@pytest.mark.parametrize("control", ["b400", "b402", "b404"])  # off; on, but low when ready
def test_msc_ctrl_sets_the_data_ready_line(flat, control):
    rises = []
    flat.spi.sensor.on_data_ready = rises.append
    flat.send(control, "b901")
    flat.wait(0.01)
    assert rises == []
