"""Epson's start-up dialogue, against a device in memory written from the data sheet's side (`scripted.py`)."""

import random

import pytest
from scripted import G350, Mute, Speaker, run

from imud.drivers.driver import Identity, Options
from imud.drivers.epson.driver import DRIVER
from imud.drivers.epson.models import G350 as G350_ROW
from imud.drivers.epson.models import V340 as V340_ROW

FLASH_BACKUP = bytes.fromhex("BE080D")


def identify(device):
    device.host_baud = device.baud
    return run(DRIVER.identify(), device)


def configure(device, identity=None, **options):
    device.host_baud = device.baud
    identity = identity or Identity("epson", "M-G350", baud=device.baud)
    return run(DRIVER.configure(identity, Options(**options)), device)[0]


def test_a_device_at_rest_is_identified_without_a_trace():
    device = G350()
    found, seconds = identify(device)
    assert found == Identity("epson", "M-G350", "A0000123", "0113", profile="m-g350")
    assert seconds < 0.5
    assert FLASH_BACKUP not in device.written
    assert device.restarts == 0


def test_the_v340_is_identified_by_its_name():
    found, _ = identify(G350(product="V340PDD0"))
    assert found.model == "M-V340"


@pytest.mark.parametrize("missing", ["silent", "zero", "garbage"])
def test_a_device_without_a_name_is_an_m_g350(missing):
    device = G350(product="\xff" * 4 if missing == "garbage" else "\0" * 8, serial="\0" * 8)
    device.byte |= {0x72: 0, 0x73: 0}
    if missing == "silent":
        device.absent = set(range(0x4C, 0x80, 2)) - {0x50}
    found, seconds = identify(device)
    assert found == Identity("epson", "M-G350", profile="m-g350")
    assert seconds < 1.2


class Unhurried(G350):
    """Misses what comes too soon after the last command, as the data sheet warns."""

    def __init__(self, pause_s):
        super().__init__()
        self.pause_s, self.heard_s, self.missed = pause_s, -1.0, 0

    def obey(self, address, value):
        soon, self.heard_s = self.now_s - self.heard_s < self.pause_s, self.now_s
        if soon:
            self.missed += 1
        else:
            super().obey(address, value)


class Disturbed(G350):
    """On a line that loses or damages one command in twenty, and one answer in twenty."""

    def __init__(self, seed):
        super().__init__()
        self.random = random.Random(seed)

    def obey(self, address, value):
        if self.random.random() > 0.05:
            super().obey(address, value)

    def say(self, data):
        if len(data) == 4 and self.random.random() < 0.05:
            at, bit = self.random.randrange(4), 1 << self.random.randrange(8)
            flipped = bytes((*data[:at], data[at] ^ bit, *data[at + 1 :]))
            data = self.random.choice((b"", flipped, data[:at] + data[at + 1 :], data[:at] + b"\r" + data[at:]))
        super().say(data)


@pytest.mark.parametrize("seed", range(20))
def test_a_disturbed_line_costs_neither_the_serial_number_nor_a_setting(seed):
    device = Disturbed(seed)
    configured = next(filter(None, (configure(device) for _ in range(5))))
    assert configured.identity.serial == "A0000123"
    assert (configured.rate_hz, configured.frame_bytes, configured.warnings) == (1000.0, 22, ())
    assert (device.rate_hz, device.byte[0x38], device.byte[0x50]) == (1000.0, 1, 1)


def test_commands_keep_the_pause_that_slow_lines_need_after_answers_too():
    device = Unhurried(0.005)
    assert configure(device).rate_hz == 1000.0
    assert device.missed == 0


@pytest.mark.parametrize("silent", [True, False])
def test_start_up_is_waited_for(silent):
    device = G350(boot_s=0.9, silent_boot=silent)
    found, seconds = identify(device)
    if silent:  # nothing to tell it from an empty line yet: the detection comes again
        assert found is None
        device.now_s = 1.0
        found, seconds = identify(device)
    assert isinstance(found, Identity)
    assert seconds < 1.5


@pytest.mark.parametrize("code", [1, 4, 7])
def test_a_stream_is_stopped(code):
    found, _ = identify(G350().start(code))
    assert isinstance(found, Identity)


def test_silence_is_left_after_a_moment():
    found, seconds = identify(Mute(460800))
    assert found is None
    assert seconds < 0.7  # half a second of it for answers that come late


@pytest.mark.parametrize("burst", [b"$GPGGA,,,,,,0,,,,,,,,*66\r\n", bytes(range(256)), b"\x3e\x00\x00\x0d" * 50])
def test_other_talkers_are_not_taken_for_an_imu(burst):
    found, seconds = identify(Speaker(460800, burst, period_s=0.01))
    assert found is None
    assert seconds < 2.0


def test_one_fitting_answer_may_be_chance():
    class Parrot(Mute):
        def receive(self, data):
            if data.startswith(b"\x3e") and self.written.count(b"\x3e") == 1:
                self.say(b"\x3e\x00\x00\r")

    found, seconds = identify(Parrot(460800))
    assert found is None
    assert seconds < 2.0


def test_an_automatic_stream_is_recognised_by_itself():
    device = G350().start()
    device.host_baud = device.baud
    device.pass_time(0.01)
    stream = bytes(device.outgoing)
    assert DRIVER.recognise(stream).model == "M-G350"
    assert DRIVER.recognise(stream[7:]).model == "M-G350"
    assert DRIVER.recognise(stream[:60]) is None
    assert DRIVER.recognise(bytes(300)) is None


def test_configuration_ends_in_a_numbered_stream_at_full_rate():
    device = G350()
    result = configure(device)
    assert result.identity == Identity("epson", "M-G350", "A0000123", "0113", 460800, "m-g350")
    assert (result.rate_hz, result.period_ns, result.frame_bytes, result.warnings) == (1000.0, 1_000_000, 22, ())
    wire_ns = round(220 / 460800 * 1e9)
    assert result.delay_ns == 250_000 + wire_ns  # two taps at 2 kHz delay by half a period
    assert device.sampling
    assert [device.byte[address] for address in (0x37, 0x38, 0x3A, 0x50)] == [1, 1, 1, 1]
    assert FLASH_BACKUP not in device.written


@pytest.mark.parametrize(
    ("rate_hz", "code", "taps_code"),
    [(1000.0, 1, 1), (500.0, 2, 2), (250.0, 3, 3), (125.0, 4, 4), (62.5, 5, 5), (31.25, 6, 6), (15.625, 7, 7)],
)
def test_every_rate_has_the_shortest_filter_that_is_valid(rate_hz, code, taps_code):
    device = G350()
    result = configure(device, rate_hz=rate_hz)
    assert (device.byte[0x37], device.byte[0x38]) == (code, taps_code)
    assert result.rate_hz == rate_hz
    assert result.period_ns * rate_hz == 1e9
    assert result.warnings == ()


def test_filter_rules_of_the_two_models():
    for model, hz in ((G350_ROW, 2000.0), (V340_ROW, 1000.0)):
        for rate in model.rates.values():
            assert model.taps(rate) == max(hz / rate, min(model.tap_codes))


@pytest.mark.parametrize(
    ("baud", "possible_hz"), [(460800, 1000.0), (230400, 1000.0), (115200, 500.0), (19200, 62.5), (9600, 31.25)]
)
def test_a_rate_that_does_not_fit_on_the_line_is_lowered_with_a_warning(baud, possible_hz):
    result = configure(G350(baud))
    assert result.rate_hz == possible_hz
    assert result.frame_bytes * 10 * possible_hz < baud
    assert bool(result.warnings) == (possible_hz != 1000.0)


def test_a_rate_that_the_sensor_has_not_is_answered_with_those_it_has():
    result = configure(G350(115200), rate_hz=333.0)
    assert result.rate_hz == 250.0
    assert result.warnings == (
        "333 samples/s wanted, 250 set; possible at 115200 baud: 500, 250, 125, 62.5, 31.25, 15.625",
    )


def test_a_sensor_that_another_host_left_waiting_for_pulses_samples_by_its_own_clock():
    device = G350().start()
    device.byte[0x34] = 0x86  # EXT_SEL
    assert configure(device).rate_hz == 1000.0


def test_a_running_stream_is_reconfigured():
    device = G350().start(4)
    assert configure(device, rate_hz=500.0).rate_hz == 500.0


@pytest.mark.parametrize(
    ("stuck", "complaint", "rate_hz"),
    [
        ({0x37: 2}, "keeps rate code 2", 500.0),
        ({0x38: 5}, "keeps filter code 5", 1000.0),
        ({0x50: 0}, "does not number its samples", 1000.0),
    ],
)
def test_a_register_that_reads_back_differently_is_used_and_reported(stuck, complaint, rate_hz):
    device = G350()
    device.stuck = stuck
    result = configure(device)
    assert result.rate_hz == rate_hz
    assert complaint in " ".join(result.warnings)
    assert result.frame_bytes == (20 if 0x50 in stuck else 22)


def test_a_hardware_error_is_reported():
    device = G350()
    device.byte[0x3C] = 0x20
    assert "hardware error" in " ".join(configure(device).warnings)


def test_a_device_that_does_not_read_back_is_used_all_the_same():
    device = G350()
    device.absent = {0x36, 0x38, 0x3C, 0x4C, 0x50, *range(0x6A, 0x80, 2)}
    result = configure(device)
    assert result.rate_hz == 1000.0
    assert "configuration mode" in " ".join(result.warnings)


@pytest.mark.parametrize("device", [Mute(460800), Speaker(460800, b"hello\r\n", period_s=0.05)])
def test_what_does_not_answer_is_not_configured(device):
    assert configure(device) is None


def test_no_stream_is_no_success():
    device = G350()
    device.stuck = {0x3A: 0}
    assert configure(device) is None


@pytest.mark.parametrize(("code", "rate_hz"), [(1, 1000.0), (3, 250.0), (7, 15.625)])
def test_readonly_takes_the_stream_as_it_is(code, rate_hz):
    device = G350().start(code)
    result = configure(device, readonly=True)
    assert (result.rate_hz, result.frame_bytes) == (rate_hz, 22)
    assert device.written == b""


def test_the_stream_of_a_sensor_that_does_not_answer_is_used_as_it_is():
    device = G350().start(4)
    device.receive = lambda data: None
    result = configure(device)
    assert (result.rate_hz, result.frame_bytes) == (125.0, 22)
    assert "does not answer" in " ".join(result.warnings)


def test_readonly_cannot_start_a_stream():
    device = G350()
    assert configure(device, readonly=True) is None
    assert device.written == b""


@pytest.mark.parametrize(
    ("heard", "uart", "still_powered"),
    [
        (True, 0x01, True),
        (False, 0x01, False),  # it was silent: it may have been switched on just now
        (True, 0x03, False),  # AUTO_START: it streams after each power-on
    ],
)
def test_a_stream_that_only_a_set_up_starts_shows_that_the_sensor_was_not_switched_off(heard, uart, still_powered):
    device = G350().start()
    device.byte[0x3A] = uart
    found = Identity("epson", "M-G350", baud=device.baud, streaming=heard)
    assert configure(device, found).still_powered == still_powered


def test_a_sensor_that_was_reset_is_not_taken_for_one_that_streamed_on():
    device = G350()
    assert not configure(device, Identity("epson", "M-G350", baud=device.baud, streaming=True)).still_powered
