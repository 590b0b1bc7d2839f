"""The start-up dialogue with Epson's windowed sensors, against a device in memory (`scripted.py`)."""

import pytest
from scripted import G350, WINDOWED_RATES, Windowed, run

from imud.drivers.driver import Identity, Options, Unsupported
from imud.drivers.epson.driver import DRIVER
from imud.drivers.epson.models import MODELS
from imud.sensor_errors.profiles import PROFILES

FLASH_BACKUP, INITIAL_BACKUP = bytes.fromhex("8A080D"), bytes.fromhex("8A100D")  # GLOB_CMD in window 1
FLAT_STOP = bytes.fromhex("B9020D")  # in window 1: into the rotation matrix


def identify(device):
    device.host_baud = device.baud
    return run(DRIVER.identify(), device)


def configure(device, **options):
    device.host_baud = device.baud
    return run(DRIVER.configure(Identity("epson", "", baud=device.baud), Options(**options)), device)[0]


def matrix(device):
    return [device.byte[1, 0x38 + i] for i in range(36)]


def test_a_device_at_rest_is_identified_without_a_trace():
    device = Windowed()
    before = dict(device.byte)
    found, seconds = identify(device)
    assert found == Identity("epson", "M-G364PDCA", "W0000456", "0230", profile="epson-windowed")
    assert seconds < 0.4  # every word is read twice
    assert device.byte == before
    assert FLAT_STOP not in device.written


@pytest.mark.parametrize("product", ["G320PDG0", "G354PDH0", "G362PDC1", "G365PDF1", "G366PDG0", "G370PDF1"])
def test_every_model_is_identified_by_its_name(product):
    found, _ = identify(Windowed(product=product))
    assert found.model == f"M-{product}"


@pytest.mark.parametrize("product", ["G999PDX0", "\0" * 8])
def test_a_model_of_unknown_scales_is_refused_by_name(product):
    found, _ = identify(Windowed(product=product))
    assert isinstance(found, Unsupported)
    assert product.strip("\0") in found.model
    assert configure(Windowed(product=product)) is None


@pytest.mark.parametrize("window", [0, 1])
@pytest.mark.parametrize("code", [0, 1, 7])
def test_a_stream_is_stopped_and_the_rotation_matrix_not_written(window, code):
    device = Windowed().start(code, window=window)
    before = matrix(device)
    found, _ = identify(device)
    assert isinstance(found, Identity)
    assert not device.sampling
    assert matrix(device) == before


def test_a_device_left_with_the_other_window_open_keeps_its_rotation_matrix():
    device = Windowed()
    device.window, before = 1, matrix(device)
    assert configure(device).frame_bytes == 36
    assert matrix(device) == before


def test_start_up_is_waited_for():
    device = Windowed(boot_s=0.9)
    assert identify(device)[0] is None  # nothing to tell it from an empty line yet: the detection comes again
    device.now_s = 1.0
    assert isinstance(identify(device)[0], Identity)


def test_the_flat_dialect_is_not_mistaken():
    assert identify(G350())[0].model == "M-G350"
    device = G350()
    device.byte |= {0x4D: 0x53, 0x4C: 0x00}
    assert identify(device)[0].model == "M-G350"


def test_configuration_ends_in_a_numbered_checked_stream_of_32_bits_at_full_rate():
    device = Windowed()
    result = configure(device)
    assert result.identity == Identity("epson", "M-G364PDCA", "W0000456", "0230", 460800, "epson-windowed")
    assert (result.rate_hz, result.period_ns, result.frame_bytes, result.warnings) == (1000.0, 1_000_000, 36, ())
    assert result.delay_ns == 250_000 + round(360 / 460800 * 1e9)  # two taps at 2 kHz delay by half a period
    assert device.automatic
    written = [device.byte[1, address] for address in (0x05, 0x06, 0x08, 0x0D, 0x0C, 0x0F)]
    assert written == [1, 1, 1, 0xF0, 0x03, 0x70]
    assert FLASH_BACKUP not in device.written
    assert INITIAL_BACKUP not in device.written


@pytest.mark.parametrize("code", sorted(WINDOWED_RATES.keys() - {0x0D}))  # which is CR, and ends a command
def test_every_rate_has_the_shortest_filter_that_is_valid(code):
    device, rate_hz = Windowed(921600), WINDOWED_RATES[code]
    result = configure(device, rate_hz=rate_hz)
    assert (result.rate_hz, result.warnings) == (rate_hz, ())
    taps = 1 << device.byte[1, 0x06]
    assert taps >= 2000.0 / rate_hz > taps / 2
    assert device.byte[1, 0x05] == code


@pytest.mark.parametrize(("wanted", "taps"), [(0, 2), (2, 2), (4, 4), (8, 8), (16, 16), (32, 32), (64, 64), (128, 128)])
def test_a_longer_filter_may_be_asked_for(wanted, taps):
    device = Windowed()
    result = configure(device, filter_taps=wanted)
    assert 1 << device.byte[1, 0x06] == taps
    assert result.delay_ns == round((taps - 1) / 2 / 2000.0 * 1e9) + round(360 / 460800 * 1e9)
    assert result.warnings == ()


@pytest.mark.parametrize(("taps", "rate_hz"), [(1, 1000.0), (100, 1000.0), (4, 250.0)])
def test_a_filter_that_is_not_possible_is_refused_and_the_possible_ones_are_listed(taps, rate_hz):
    device = Windowed()
    answer = configure(device, filter_taps=taps, rate_hz=rate_hz)
    assert isinstance(answer, Unsupported)
    possible = [count for count in (1, 2, 4, 8, 16, 32, 64, 128) if count * rate_hz >= 2000]
    assert f"imu.filter_taps = {taps} is not possible at {rate_hz:g} samples/s" in str(answer)
    assert f"possible: {', '.join(map(str, possible))}, or 0" in str(answer)
    assert device.byte[1, 0x06] == 1, "left as it was"


@pytest.mark.parametrize(
    ("baud", "wanted_hz", "possible_hz", "frame_bytes"),
    [
        (921600, 2000.0, 2000.0, 36),
        (460800, 2000.0, 2000.0, 22),
        (460800, 1000.0, 1000.0, 36),
        (230400, 1000.0, 1000.0, 22),
        (115200, 1000.0, 500.0, 22),
        (115200, 250.0, 250.0, 36),
        (19200, 1000.0, 80.0, 22),
        (9600, 1000.0, 31.25, 22),
    ],
)
def test_the_rate_comes_first_and_the_finest_words_that_fit_second(baud, wanted_hz, possible_hz, frame_bytes):
    result = configure(Windowed(baud), rate_hz=wanted_hz)
    assert (result.rate_hz, result.frame_bytes) == (possible_hz, frame_bytes)
    assert frame_bytes * 10 * possible_hz < baud
    assert bool(result.warnings) == (possible_hz != wanted_hz)


def test_a_sensor_that_keeps_to_16_bits_is_taken_with_them():
    device = Windowed()
    device.stuck = {(1, 0x0F): 0}
    result = configure(device)
    assert (result.frame_bytes, result.warnings) == (22, ())


@pytest.mark.parametrize(
    ("stuck", "complaint", "rate_hz"),
    [({(1, 0x05): 2}, "keeps rate code 2", 500.0), ({(1, 0x06): 5}, "keeps filter code 5", 1000.0)],
)
def test_a_register_that_reads_back_differently_is_used_and_reported(stuck, complaint, rate_hz):
    device = Windowed()
    device.stuck = stuck
    result = configure(device)
    assert result.rate_hz == rate_hz
    assert complaint in " ".join(result.warnings)


@pytest.mark.parametrize(
    ("product", "before", "after"),
    [("G330PDG0", 1, 0), ("G366PDG0", 1, 0), ("G370PDG0", 1, 0), ("G370PDT0", 1, 0), ("G370PDF1", 1, 1)],
)
def test_the_range_of_16_g_is_left_where_there_is_one(product, before, after):  # py_esensorlib: DLT_CTRL, high byte
    device = Windowed(product=product)
    device.byte |= {(1, 0x13): before, (1, 0x12): 0xCC}
    assert configure(device).warnings == ()
    assert (device.byte[1, 0x13], device.byte[1, 0x12]) == (after, 0xCC)


def test_a_range_that_stays_is_reported():
    device = Windowed(product="G366PDG0")
    device.stuck = {(1, 0x13): 1}
    device.byte |= device.stuck
    assert "range of 8 G" in " ".join(configure(device).warnings)


def test_a_filter_that_is_still_changing_is_no_complaint():
    device = Windowed()
    device.stuck = {(1, 0x06): 0x21}  # code 1, busy
    assert configure(device).warnings == ()


@pytest.mark.thorough
def test_frames_without_a_checksum_are_no_success():
    device = Windowed()
    device.stuck = {(1, 0x0C): 0x02}
    assert configure(device) is None


def test_a_hardware_error_is_reported():
    device = Windowed()
    device.byte[0, 0x04] = 0x20
    assert "hardware error" in " ".join(configure(device).warnings)


@pytest.mark.parametrize(
    ("diagnosis", "test_s", "complaint"), [(0, 0.15, ""), (0x20, 0.15, "failed"), (0, 9.0, "does not end")]
)
def test_the_self_test_is_run_when_wanted(diagnosis, test_s, complaint):
    device = Windowed()
    device.test_s, device.byte[0, 0x05] = test_s, diagnosis
    result = configure(device, self_test=True)
    assert bytes.fromhex("83040D") in device.written
    assert complaint in " ".join(result.warnings)
    assert bool(result.warnings) == bool(complaint)
    assert result.frame_bytes == 36
    untested = Windowed()
    configure(untested)
    assert bytes.fromhex("83040D") not in untested.written


@pytest.mark.parametrize("bit", range(16))
def test_the_self_test_fails_by_each_of_its_bits_alone(bit):
    """DIAG_STAT in the data sheets: bit 1 sums up, bits 11 to 14 are the accelerometers and the three gyros."""
    device = Windowed()
    device.test_s, device.byte[0, 0x04], device.byte[0, 0x05] = 0.15, 1 << bit & 0xFF, 1 << bit >> 8
    assert ("test failed" in " ".join(configure(device, self_test=True).warnings)) == (bit in (1, 11, 12, 13, 14))


def test_a_running_stream_of_another_host_is_reconfigured():
    device = Windowed().start(4, fields=0xF007, wide=0x70, window=1)
    assert configure(device).frame_bytes == 36


def test_a_sensor_that_another_host_left_waiting_for_pulses_samples_by_its_own_clock():
    device = Windowed().start()
    device.byte[1, 0x02] = 0x86  # EXT_SEL
    result = configure(device)
    assert (result.rate_hz, result.frame_bytes, result.warnings) == (1000.0, 36, ())


@pytest.mark.parametrize(("fields", "wide"), [(0xF006, 0), (0xF007, 0x70), (0xF003, 0x30), (0x3000, 0)])
def test_a_stream_is_recognised_by_itself_whatever_its_layout(fields, wide):
    device = Windowed().start(fields=fields, wide=wide)
    device.host_baud = device.baud
    device.pass_time(0.01)
    heard = bytes(device.outgoing)
    assert DRIVER.recognise(heard[7:]) == Identity("epson", "")
    assert DRIVER.recognise(heard[:30]) is None


def test_readonly_needs_to_know_the_model():
    device = Windowed().start(fields=0xF003, wide=0x70)
    assert isinstance(configure(device, readonly=True), Unsupported)
    known = Identity("epson", "M-G364PDCA", baud=460800)
    result, _ = run(DRIVER.configure(known, Options(readonly=True)), device)
    assert (result.rate_hz, result.frame_bytes) == (1000.0, 36)
    assert device.written == b""


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_table_of_models_is_sound(model):
    assert model.rates
    assert model.profile in PROFILES
    for rate in model.rates.values():
        assert model.taps(rate) * rate >= model.filter_hz
    assert all(16383 < end <= 32767 for end in model.range_lsb)  # a range that would use no bit of the word is a slip
