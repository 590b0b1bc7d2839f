"""Ports to which nothing is ever written: every driver takes the stream as it is, or says what is missing.

The devices fail on any byte that they receive.
"""

import numpy as np
import pytest
from emulated import TouchedError, streaming
from framer_properties import Decoder
from scripted import run
from test_drivers_on_emulators import is_right

from imud.drivers.detect import detect
from imud.drivers.driver import GnssConfigured, Identity, ImuConfigured, Options, Unsupported
from imud.drivers.registry import by_name
from imud.errors import UsageError
from imud.setup import choices
from imud.setup.config import load


def overheard(wire, **options):
    found, _ = run(detect(readonly=True), wire)
    assert isinstance(found, Identity), found
    driver = by_name(found.driver)
    return driver, run(driver.configure(found, Options(readonly=True, **options)), wire)[0]


def test_the_devices_of_this_test_do_fail_when_written_to():
    with pytest.raises(TouchedError):
        run(detect("epson", 460800), streaming("g350", 9600))


@pytest.mark.parametrize(
    ("name", "baud", "rate_hz"), [("g350", 460800, 125.0), ("g350", 115200, 125.0), ("rga300", 38400, 100.0)]
)
def test_streams_that_identify_their_layout(name, baud, rate_hz):
    wire = streaming(name, baud)
    driver, configured = overheard(wire)
    assert configured.rate_hz == rate_hz
    is_right(configured, Decoder(driver, configured).feed(wire.stream(2.0)), 2.0, 0.01)


@pytest.mark.parametrize("wide", [0x00, 0x70])
@pytest.mark.parametrize("fields", [0xF001, 0xF003, 0xF005, 0xF007])  # checksum; COUNT; GPIO; both
def test_windowed_frames_are_learned_from_the_stream(fields, wide):
    wire = streaming("g365", 460800, fields=fields, wide=wide)
    driver, configured = overheard(wire, model="G365PDF")
    assert (configured.rate_hz, configured.identity.model) == (125.0, "M-G365PDF")
    decoding = Decoder(driver, configured).feed(wire.stream(2.0))
    is_right(configured, decoding, 2.0, 0.01)
    assert decoding["junk"] < configured.frame_bytes


@pytest.mark.parametrize(
    ("fields", "model", "complaint"),
    [
        (0xF007, "", "do not identify the model; set imu.model to one of G320, G330,"),
        (0xF006, "G365PDF", "frames of 22 bytes without a checksum"),
        (0x3003, "G365PDF", "frames of 18 bytes with a checksum"),
        (0xF007, "G350", "imu.model says G350, but the frames are of another kind"),
        (0x7007, "G365PDF", "do not begin with FLAG"),
        (0xF007, "G320", "show 0.5 g: is imu.model right?"),
    ],
)
def test_what_a_stream_does_not_show_is_reported(fields, model, complaint):
    _, answer = overheard(streaming("g365", 460800, fields=fields), model=model)
    assert isinstance(answer, Unsupported)
    assert complaint in str(answer)


def test_a_windowed_model_named_for_a_flat_stream_is_refused():
    _, answer = overheard(streaming("g350", 460800), model="G365PDF")
    assert "of G350, V340" in str(answer)


def test_receiver_and_accelerometer():
    _, configured = overheard(streaming("nmea", 9600), set_up_nmea=True)
    assert isinstance(configured, GnssConfigured)
    wire = streaming("seraccel", 57600)
    driver, configured = overheard(wire)
    assert isinstance(configured, ImuConfigured)
    samples = np.array(Decoder(driver, configured).feed(wire.stream(2.0)).samples)
    assert np.linalg.norm(samples["f"].mean(axis=0)) == pytest.approx(9.8, abs=0.05)


def test_ports_are_readonly_by_the_settings():
    ports = 'ports=["/dev/a:epson@460800","/dev/b"]'
    for readonly, expected in [("true", [True, True]), ('["/dev/b"]', [False, True]), ("false", [False, False])]:
        opened = choices.ports(load(None, [ports, f"readonly={readonly}"]))
        assert [options.readonly for _, options in opened] == expected
    with pytest.raises(UsageError, match="readonly names /dev/c, but the ports are /dev/a, /dev/b"):
        choices.ports(load(None, [ports, 'readonly=["/dev/c"]']))
