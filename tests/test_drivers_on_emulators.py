"""Every emulated device with its driver at every baud rate, from switching on to samples, in memory, unhurried.

The truth that the samples are held against is the emulators' scenario: at rest, 10 deg of roll and -5 deg of pitch.
"""

import numpy as np
import pytest
from emulated import PITCH, ROLL, device
from framer_properties import Decoder
from scripted import run

from imud.drivers.detect import detect
from imud.drivers.driver import Identity, Options
from imud.drivers.registry import by_name

LOCAL = 9.7971  # normal gravity there (WGS-84)
F = LOCAL * np.array([np.sin(PITCH), -np.cos(PITCH) * np.sin(ROLL), -np.cos(PITCH) * np.cos(ROLL)])  # specific force
EPSON_BAUDS = (460800, 230400, 115200, 19200, 9600, 921600)
MODELS = {"g350": "M-G350", "g364": "M-G364PDCA", "g365": "M-G365PDF1", "g370": "M-G370PDF1"}
GLOB_CMD = (0xBE, 0x8A)  # its low byte, written; in the flat dialect and the windowed one
DETECTED_S = 12.0  # "within seconds", on a line that is tried at all speeds
LOST_AT_START = 2  # frames may be cut where listening begins


def detected(wire):
    found, seconds = run(detect(), wire)
    assert isinstance(found, Identity), found
    assert found.baud == wire.unit.uart.baud
    assert seconds < DETECTED_S
    assert not [command for command in wire.written.split(b"\r") if writes_flash(command)]
    return found


def writes_flash(command):
    """Whether an Epson sensor takes it for the backup of its registers, of the present or the initial values."""
    return len(command) == 2 and command[0] in GLOB_CMD and bool(command[1] & 0x18)


def sampled(wire, found, seconds=2.0, **options):
    """Configured stream, and what its decoder makes of so many seconds of it."""
    driver = by_name(found.driver)
    configured, _ = run(driver.configure(found, Options(**options)), wire)
    assert configured is not None
    wire.outgoing.clear()
    decoding = Decoder(driver, configured).feed(wire.stream(seconds, configured.request))
    return configured, decoding


def is_right(configured, decoding, seconds, tolerance):
    """Samples at the rate that was promised, numbered without a gap, and true."""
    samples = np.array(decoding.samples)
    assert len(samples) == pytest.approx(seconds * configured.rate_hz, rel=0.02, abs=2)
    assert decoding["lost"] == decoding["errors"] == 0
    periods = np.diff(samples["tick"]) * configured.period_ns * 1e-9 * configured.rate_hz
    assert periods.mean() == pytest.approx(1.0, rel=0.02)
    assert samples["f"].mean(axis=0) == pytest.approx(F, abs=tolerance)
    assert np.abs(samples["w"]).max() < 1e-3


@pytest.mark.thorough
@pytest.mark.parametrize("baud", EPSON_BAUDS)
@pytest.mark.parametrize("name", MODELS)
def test_an_epson_sensor_is_detected_and_sampled_at_every_baud_rate(name, baud):
    wire = device(name, baud)
    found = detected(wire)
    assert found.model == MODELS[name]
    configured, decoding = sampled(wire, found)
    is_right(configured, decoding, 2.0, 0.005)
    assert decoding["junk"] <= LOST_AT_START * configured.frame_bytes
    assert configured.frame_bytes * 10 * configured.rate_hz < baud


@pytest.mark.parametrize("baud", EPSON_BAUDS)
@pytest.mark.parametrize("name", ["g350", "g364"])
def test_an_epson_sensor_is_polled(name, baud):
    wire = device(name, baud)
    configured, decoding = sampled(wire, detected(wire), rate_hz=125.0, polled=True)
    is_right(configured, decoding, 2.0, 0.005)
    assert decoding["junk"] == 0


@pytest.mark.parametrize("polled", [False, True])
@pytest.mark.parametrize("baud", [38400])
def test_a_crossbow_is_detected_and_sampled(baud, polled):
    wire = device("rga300", baud, rate_hz=100.0)
    found = detected(wire)
    assert (found.model, found.serial) == ("DMU RGA300CA", "30042")
    configured, decoding = sampled(wire, found, rate_hz=50.0 if polled else 1000.0, polled=polled)
    assert configured.rate_hz == (50.0 if polled else 100.0)
    is_right(configured, decoding, 2.0, 0.005)
    assert np.array(decoding.samples)["down"].mean(axis=0) == pytest.approx(-F / LOCAL, abs=1e-3)


@pytest.mark.parametrize("baud", [57600, 38400, 19200, 9600])
def test_a_seraccel_is_detected_and_sampled_at_every_baud_rate(baud):
    wire = device("seraccel", baud)
    configured, decoding = sampled(wire, detected(wire), 5.0)
    is_right(configured, decoding, 5.0, 0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("baud", [4800, 9600, 19200, 38400, 57600, 115200])
def test_an_nmea_receiver_is_detected_and_read_at_every_baud_rate(baud):
    wire = device("nmea", baud)
    found = detected(wire)
    decoder = by_name("nmea").new_decoder()
    heard = wire.stream(8.0, step_s=1e-2)
    fixes = [fix for i in range(0, len(heard), 7) for fix in decoder.feed(heard[i : i + 7], i)] + decoder.flush(1 << 62)
    assert 5 <= len(fixes) <= 9
    assert found.driver == "nmea"
    assert all(abs(fix.lat_deg - 35.0) < 1e-5 and abs(fix.lon_deg - 139.0) < 1e-5 for fix in fixes)


def test_a_polled_sensor_that_is_asked_less_often_than_it_samples_numbers_what_it_skipped():
    """The numbers come from the device: they are right however late the questions were."""
    wire = device("g350", 460800)
    found = detected(wire)
    driver = by_name("epson")
    configured, _ = run(driver.configure(found, Options(rate_hz=125.0, polled=True)), wire)
    heard = wire.stream(1.0, configured.request)
    wire.stream(0.1)
    decoding = Decoder(driver, configured).feed(heard + wire.stream(1.0, configured.request))
    assert decoding.ticks[-1] == pytest.approx(2.1 * 125.0, abs=3)
    assert decoding["lost"] == pytest.approx(0.1 * 125.0, abs=2)
