"""u-blox receivers: the set-up and the emulator. Oracle: pyubx2 decodes ours, and has the keys of the database."""

import io
import struct

import numpy as np
import pytest
from emulated import REST, UTC, Emulated
from nmea_lines import gga
from pyubx2 import GET, UBXMessage, UBXReader
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE
from scripted import Mute, Speaker, run

from imud.drivers.detect import detect
from imud.drivers.driver import GnssConfigured, Identity, Options, Unsupported
from imud.drivers.findings import UnrecognisedData
from imud.drivers.registry import by_name
from imud.drivers.ubx import setup
from imud.drivers.ubx.frames import frame
from imud.firmware_sim import ublox
from imud.firmware_sim.fixes import Fix as TrueFix
from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.ublox import NEO_M8N, Ublox
from imud.firmware_sim.ublox_frames import Report

DRIVER = by_name("ubx")


def wire(emulated=Emulated, rate_hz=1.0, **options):
    source = SimulatedFixes(REST, np.random.default_rng(1), UTC, True)
    return emulated(Ublox(source, UTC, rate_hz=rate_hz, **{"no_fix_s": 0.0, **options}))


def fixes_of(device, configured, seconds=3.0):
    decoder = by_name(configured.identity.driver).new_decoder()
    data = device.stream(seconds, step_s=1e-3)
    return [fix for i in range(0, len(data), 7) for fix in decoder.feed(data[i : i + 7], i)], decoder


def set_up(device, name="ubx", **options):
    found, _ = run(detect(name), device)
    assert isinstance(found, Identity), found
    return run(by_name(found.driver).configure(found, Options(**options)), device)[0]


def test_keys_and_messages_are_those_of_the_database():
    for kind, key in setup.KEY_OF_MESSAGE.items():
        name = UBXMessage(*(bytes([byte]) for byte in kind), GET).identity.replace("-", "_")
        for shift, port in enumerate(("UART1", "UART2", "USB")):
            assert UBX_CONFIG_DATABASE[f"CFG_MSGOUT_UBX_{name}_{port}"] == (key + shift, "U001")
    for shift, port in ((setup.UART1, "UART1"), (setup.UART2, "UART2"), (setup.USB, "USB")):
        assert UBX_CONFIG_DATABASE[f"CFG_{port}OUTPROT_UBX"][0] == setup.OUT_UBX[shift]
        assert UBX_CONFIG_DATABASE[f"CFG_{port}OUTPROT_NMEA"][0] == setup.OUT_NMEA[shift]
    assert {port: UBX_CONFIG_DATABASE[f"CFG_UART{port}_BAUDRATE"] for port in (1, 2)} == {
        port: (key, "U004") for port, key in setup.BAUDRATE.items()
    }
    assert UBX_CONFIG_DATABASE["CFG_RATE_MEAS"] == (setup.RATE_MEAS, "U002")
    assert UBX_CONFIG_DATABASE["CFG_RATE_NAV"] == (setup.RATE_NAV, "U002")
    assert all(setup.KEY_OF_MESSAGE[kind] == key for key, kind in ublox._KEYS.items())


@pytest.mark.parametrize(("options", "model"), [({}, "u-blox ZED-F9P"), ({"model": NEO_M8N}, "u-blox NEO-M8N-0")])
@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_a_receiver_as_from_the_factory_is_set_up_if_it_is_named(options, model, rate_hz):
    device = wire(**options)
    configured = set_up(device, fix_rate_hz=rate_hz)
    assert (configured.identity.model, configured.identity.baud, configured.warnings) == (model, 115200, ())
    fixes, decoder = fixes_of(device, configured)
    assert len(fixes) == pytest.approx(3 * rate_hz, abs=2)
    assert decoder.counters["noise bytes"] < 200, "no sentences any more"
    assert (fixes[-1].lat_deg, fixes[-1].height_m, fixes[-1].hdop) == pytest.approx((35.0, 60.0, 1.0), abs=0.2)
    assert len(decoder.sky.satellites) == 9
    assert (decoder.status.jamming, decoder.status.spoofing) == (0, 0)


@pytest.mark.parametrize("model", [ublox.ZED_F9P, NEO_M8N])
def test_a_receiver_that_sends_ubx_beside_nmea_is_found_by_itself(model):
    device = wire(mixed=True, model=model)
    assert len(fixes_of(device, set_up(device, None))[0]) >= 13


def test_a_receiver_that_sends_nmea_alone_is_not_written_to():
    device = wire()
    assert run(detect(), device)[0].driver == "nmea"
    assert device.written == b""


class Untouchable(Emulated):
    def receive_from(self, data):
        assert not data


def test_readonly_writes_nothing_and_takes_what_comes():
    device = wire(Untouchable, mixed=True)
    found, _ = run(detect(readonly=True), device)
    configured, _ = run(DRIVER.configure(found, Options(readonly=True)), device)
    fixes, decoder = fixes_of(device, configured)
    assert len(fixes) >= 2 and fixes[-1].velocity_mps == (0.0, 0.0, 0.0)
    assert decoder.counters["noise bytes"] > 500


def test_a_named_baud_rate_is_kept_and_bounds_the_rate():
    device = wire(baud=9600)
    configured = set_up(device, fix_rate_hz=5.0, keep_baud=True)
    assert (configured.identity.baud, device.unit.lost) == (9600, 0)
    assert "5 fixes a second do not fit through 9600 baud: 1 instead" in configured.warnings[0]
    fixes, _ = fixes_of(device, configured, 5.0)
    assert 4 <= len(fixes) <= 5 and device.unit.lost == 0


def test_a_receiver_that_ignores_commands_is_left_as_it_is():
    device = wire(mixed=True, answers=False)
    configured = set_up(device, None)
    assert isinstance(configured, GnssConfigured) and "left as it is" in configured.warnings[0]
    assert len(fixes_of(device, configured)[0]) >= 2


def test_a_receiver_without_nav_pvt_is_named_and_not_used():
    old = ublox.Model("7.03 (45969)", "00040007", (), False, frozenset(), 9600, 200)
    refused = set_up(wire(model=old))
    assert isinstance(refused, Unsupported)
    assert "NAV-PVT" in str(refused)


def test_a_receiver_that_sends_other_messages_and_does_not_answer_is_named_and_not_used():
    old = frame((0x01, 0x02), bytes(28)) + frame((0x01, 0x12), bytes(36))  # NAV-POSLLH, NAV-VELNED
    device = Speaker(38400, old)
    device.host_baud = device.baud
    refused, _ = run(DRIVER.configure(Identity("ubx", "u-blox receiver", baud=38400), Options()), device)
    assert isinstance(refused, Unsupported) and "no NAV-PVT" in str(refused)


def test_nobody_answers():
    assert run(DRIVER.identify(), Mute(38400))[0] is None
    other, _ = run(detect("ubx", 9600), Speaker(9600, gga()))
    assert isinstance(other, Unsupported) and "with the driver ubx: name nmea, or no driver" in str(other)
    assert isinstance(run(detect("ubx", 9600), Speaker(9600, b"hello, this is none"))[0], UnrecognisedData)


class Busy(Mute):
    """A receiver whose answer waits in its buffer behind `backlog` bytes of its sentences."""

    def __init__(self, baud, backlog):
        super().__init__(baud)
        self.backlog, self.answers_s = backlog, None

    def receive(self, data):
        if frame((0x0A, 0x04)) in data and self.answers_s is None:
            self.answers_s = self.now_s + self.backlog * 10 / self.baud

    def pass_time(self, seconds):
        super().pass_time(seconds)
        if self.answers_s is not None and self.now_s >= self.answers_s:
            self.answers_s = None
            self.say(frame((0x0A, 0x04), b"EXT CORE 3.01".ljust(30, b"\0") + b"00080000".ljust(10, b"\0")))


@pytest.mark.parametrize("baud", [9600, 19200, 115200])
def test_an_answer_is_waited_for_as_long_as_the_line_takes_for_what_is_ahead_of_it(baud):
    found, _ = run(detect("ubx"), Busy(baud, 900))
    assert (found.driver, found.baud) == ("ubx", baud)


def test_settings_go_to_ram_alone():
    device = wire()
    set_up(device)
    sent = [parsed for _, parsed in UBXReader(io.BytesIO(bytes(device.written)), msgmode=1, protfilter=2)]
    assert {one.payload[1] for one in sent if one.identity == "CFG-VALSET"} == {1}
    assert "CFG-CFG" not in {one.identity for one in sent}, "which saves"


FIX = TrueFix(
    1.0, 1.1, 48.1, -11.2, 500.25, 5.0, 306.87, 0.8, 7, True, (1.0, 2.0, 3.0), (3.0, -4.0, 0.5), (0.1, 0.2, 0.3)
)


def test_the_emulators_messages_are_what_pyubx2_reads():
    report = Report(1763883182.25, FIX, jamming=2, spoofing=3, heading_deg=222.5)
    parsed = {kind: UBXReader.parse(form(report)) for kind, form in ublox._FORMS.items()}
    fix = parsed[1, 7]
    assert (fix.lat, fix.lon, fix.height, fix.numSV, fix.gnssFixOk) == (48.1, -11.2, 500250, 7, 1)
    assert (fix.velN, fix.velE, fix.velD, fix.gSpeed, fix.sAcc) == (3000, -4000, 500, 5000, 374)
    assert (fix.year, fix.month, fix.day, fix.hour, fix.min, fix.second, fix.nano) == (
        2025,
        11,
        23,
        7,
        33,
        2,
        250_000_000,
    )
    assert fix.iTOW == parsed[1, 0x61].iTOW == (7 * 3600 + 33 * 60 + 2 + 18) * 1000 + 250, "a Sunday"
    assert (parsed[1, 0x36].posCovEE, parsed[1, 0x36].velCovDD) == (4.0, pytest.approx(0.09))
    assert (parsed[1, 4].hDOP, parsed[1, 3].spoofDetState) == (0.8, 3)
    assert (parsed[0x27, 9].jammingState, parsed[0x27, 9].spoofingState, parsed[0x0A, 9].jammingState) == (2, 3, 2)
    assert (parsed[1, 0x3C].relPosHeading, parsed[1, 0x3C].isMoving, parsed[1, 0x3C].carrSoln) == (222.5, 1, 2)
    assert (parsed[1, 0x35].numSvs, parsed[1, 0x35].svId_01, parsed[1, 0x35].cno_01) == (9, 21, 45)
    assert (parsed[1, 0x21].sec, parsed[1, 0x21].validUTC) == (2, 1)
    assert UBXReader.parse(ublox.ubx.pvt(Report(1.8e9, None))).fixType == 0


def test_frames_are_those_of_pyubx2():
    assert frame((0x06, 0x01), bytes((1, 7, 1))) == UBXMessage(b"\x06", b"\x01", 1, payload=b"\x01\x07\x01").serialize()
    pairs = [("CFG_RATE_MEAS", 200), ("CFG_UART1_BAUDRATE", 115200), ("CFG_UART1OUTPROT_NMEA", 0)]
    ours = setup.values([(UBX_CONFIG_DATABASE[name][0], value) for name, value in pairs])
    assert ours == UBXMessage.config_set(1, 0, pairs).serialize()


def test_keys_that_a_receiver_does_not_have_reject_the_whole_command():
    device = wire()
    device.host_baud = 38400
    for pairs, answer in (
        ([(setup.RATE_MEAS, 500), (0x20910009, 1)], 1),
        ([(setup.RATE_MEAS, 100), (0x209101B5, 1)], 0),
    ):
        device.receive_from(setup.values(pairs))
        acks = [one for one in setup.frames(device.stream(0.1)) if one.kind[0] == 5]
        assert [(one.kind, one.payload) for one in acks] == [((5, answer), b"\x06\x8a")]
    assert device.unit._interval == 0.5


def test_unknown_speeds_and_torn_commands_are_refused():
    device = wire(model=NEO_M8N)
    device.host_baud = 9600
    change = struct.pack("<BBHIIHHHH", 1, 0, 0, 0x8D0, 12345, 7, 3, 0, 0)
    device.receive_from(frame((6, 0), change)[:-1] + b"\0" + frame((6, 0), change))
    assert [one.kind for one in setup.frames(device.stream(0.2)) if one.kind[0] == 5] == [(5, 0)]


@pytest.mark.parametrize("sigma_deg", [None, 0.3])
def test_a_receiver_with_two_antennas_tells_the_heading(sigma_deg):
    source = SimulatedFixes(REST, np.random.default_rng(1), UTC, heading_sigma_deg=sigma_deg)
    device = Emulated(Ublox(source, UTC, no_fix_s=0.0))
    fixes, _ = fixes_of(device, set_up(device))
    headings = [fix.heading_deg for fix in fixes]
    assert len(headings) >= 13
    if sigma_deg is None:
        assert set(headings) == {None}
    else:
        assert all(abs((heading + 180.0) % 360.0 - 180.0) < 5.0 * sigma_deg for heading in headings)
