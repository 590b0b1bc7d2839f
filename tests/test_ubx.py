"""u-blox receivers: frames, epochs, the set-up and the emulator. Oracle: pyubx2 encodes for ours, and decodes ours."""

import io
import math
import struct
from collections import Counter
from datetime import date

import numpy as np
import pytest
from emulated import REST, UTC, Emulated
from hypothesis import given
from hypothesis import strategies as st
from nmea_lines import gga
from pyubx2 import GET, UBXMessage, UBXReader
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE
from scripted import Mute, Speaker, run

from imud.configuration.settings import Gnss
from imud.drivers.detect import detect
from imud.drivers.driver import GnssConfigured, Identity, Options, Unsupported
from imud.drivers.findings import UnrecognisedData
from imud.drivers.registry import by_name
from imud.drivers.ubx import setup
from imud.drivers.ubx.decoder import UbxDecoder
from imud.drivers.ubx.frames import Framer, frame
from imud.firmware_sim import ublox
from imud.firmware_sim.fixes import Fix as TrueFix
from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.ublox import NEO_M8N, Ublox
from imud.firmware_sim.ublox_frames import Report
from imud.sensors.gnss import record, refusal
from imud.sensors.receiver import Receiver

DRIVER = by_name("ubx")
ITOW = 200_000_000
TIME = {"year": 2026, "month": 11, "day": 23, "hour": 7, "min": 33, "second": 2}
KNOWN = {"validDate": 1, "validTime": 1, "fullyResolved": 1}
PLACE = {"lat": 48.1173, "lon": -11.5166667, "height": 592300, "hMSL": 545400, "hAcc": 1500, "vAcc": 2500}
MOTION = {"velN": 3000, "velE": -4000, "velD": 500, "gSpeed": 5000, "headMot": 306.8699, "sAcc": 120}
VARIANCES = {"posCovNN": 1.0, "posCovEE": 4.0, "posCovDD": 9.0, "velCovNN": 0.01, "velCovEE": 0.04, "velCovDD": 0.09}


def message(group, name, **fields):
    return UBXMessage(group, name, GET, **fields).serialize()


def pvt(itow=ITOW, **changes):
    flags = {"fixType": 3, "gnssFixOk": 1, "numSV": 14, "pDOP": 1.5}
    return message("NAV", "NAV-PVT", **{"iTOW": itow, **TIME, **KNOWN, **flags, **PLACE, **MOTION, **changes})


def cov(itow=ITOW, **changes):
    return message("NAV", "NAV-COV", **{"iTOW": itow, "posCovValid": 1, "velCovValid": 1, **VARIANCES, **changes})


def eoe(itow=ITOW):
    return message("NAV", "NAV-EOE", iTOW=itow)


def decode(data, decoder=None):
    decoder = decoder or UbxDecoder()
    return decoder.feed(data, 1) + decoder.flush(10**10), decoder


def fix_of(data):
    (fix,), _ = decode(data)
    return fix


def test_an_epoch_has_all_that_its_messages_say():
    fix = fix_of(pvt() + cov() + message("NAV", "NAV-DOP", iTOW=ITOW, hDOP=0.8, vDOP=1.2) + eoe())
    assert (fix.lat_deg, fix.lon_deg) == pytest.approx((48.1173, -11.5166667), abs=1e-7)
    assert (fix.height_m, fix.alt_msl_m) == pytest.approx((592.3, 545.4))
    assert (fix.quality, fix.satellites, fix.hdop, fix.dimensions) == (1, 14, 0.8, 3)
    assert (fix.sigma_n_m, fix.sigma_e_m, fix.sigma_d_m) == pytest.approx((1.0, 2.0, 3.0))
    assert fix.velocity_mps == pytest.approx((3.0, -4.0, 0.5))
    assert fix.velocity_sigma_mps == pytest.approx((0.1, 0.2, 0.3))
    assert (fix.speed_mps, fix.course_deg) == pytest.approx((5.0, 306.8699))
    assert (fix.date, fix.utc_s) == (date(2026, 11, 23), 7 * 3600 + 33 * 60 + 2)


def test_without_a_covariance_each_axis_has_the_whole_accuracy():
    for data in (pvt(), pvt() + cov(posCovValid=0, velCovValid=0), pvt() + cov(posCovNN=math.nan, velCovEE=-1.0)):
        fix = fix_of(data)
        assert (fix.sigma_n_m, fix.sigma_e_m, fix.sigma_d_m) == (1.5, 1.5, 2.5)
        assert fix.velocity_sigma_mps == (0.12, 0.12, 0.12)


@pytest.mark.parametrize(
    ("flags", "quality"),
    [
        ({"diffSoln": 1}, 2),
        ({"diffSoln": 1, "carrSoln": 2}, 4),
        ({"diffSoln": 1, "carrSoln": 1}, 5),
        ({"fixType": 4}, 1),
        ({"fixType": 1}, 6),
        ({"fixType": 0}, 0),
        ({"fixType": 5}, 0),
        ({"gnssFixOk": 0}, 0),
        ({"invalidLlh": 1}, 0),
    ],
)
def test_qualities_are_those_of_nmea(flags, quality):
    fixes, decoder = decode(pvt(**flags) + eoe())
    assert [fix.quality for fix in fixes] == ([quality] if quality else [])
    assert (decoder.status.quality, decoder.counters["no fix"]) == (quality, int(not quality))


def test_a_two_dimensional_fix_knows_neither_height_nor_vertical_velocity():
    row = record(fix_of(pvt(fixType=2)), 0, 0)[0]
    assert math.isnan(row["height"]) and math.isnan(row["v"][2])
    assert list(row["v"][:2]) == [3.0, -4.0]


@pytest.mark.parametrize("missing", KNOWN)
def test_a_time_that_is_not_resolved_is_none(missing):
    fix = fix_of(pvt(**{missing: 0}))
    assert fix.utc_s is None
    assert "no time" in str(refusal(fix, Gnss()))
    utc = {("sec" if name == "second" else name): value for name, value in TIME.items()}
    other = message("NAV", "NAV-TIMEUTC", iTOW=ITOW, validUTC=1, nano=-250_000_000, **utc)
    assert fix_of(pvt(**{missing: 0}) + other).utc_s == 7 * 3600 + 33 * 60 + 1.75


def test_fractions_of_a_second_may_be_negative_also_at_midnight():
    assert fix_of(pvt(nano=-1_000_000)).utc_s == pytest.approx(7 * 3600 + 33 * 60 + 1.999, abs=1e-6)
    fix = fix_of(pvt(hour=0, min=0, second=0, nano=-2_000_000))
    assert (fix.date, fix.utc_s) == (date(2026, 11, 22), pytest.approx(86399.998))
    assert fix_of(pvt(second=60)).utc_s == 7 * 3600 + 34 * 60


def test_impossible_contents_are_counted_and_not_used():
    for bad, reason in (
        (pvt(month=13), "time"),
        (frame((1, 7), bytes(40)), "too short"),
        (pvt(lat=95.0), "NAV-PVT position"),
    ):
        fixes, decoder = decode(bad + eoe())
        assert (fixes, decoder.counters[reason]) == ([], 1)


def test_the_end_of_an_epoch_makes_its_fix_ready():
    decoder = UbxDecoder()
    assert decoder.feed(pvt() + cov(), 5) == [] and decoder.pending
    (fix,) = decoder.feed(eoe(), 9)
    assert (fix.arrival_ns, decoder.pending) == (5, False)
    assert decoder.feed(cov(), 10) == [] and decoder.counters["late"] == 1


def test_without_its_end_an_epoch_ends_as_the_one_before_or_with_the_next():
    decoder = UbxDecoder()
    assert decoder.feed(pvt(0) + cov(0), 0) == []
    (first,) = decoder.feed(pvt(200), 200)
    (second,) = decoder.feed(cov(200), 201)
    assert (first.arrival_ns, second.arrival_ns, second.sigma_e_m) == (0, 200, 2.0)
    assert decoder.feed(pvt(400), 400) == []
    third, fourth = decoder.feed(pvt(600) + cov(600), 600)
    assert (third.sigma_e_m, fourth.sigma_e_m) == (1.5, 1.5), "a covariance was lost, so the next one was not expected"
    assert decoder.counters["late"] == 1
    assert decoder.feed(pvt(800), 800) == []
    assert decoder.feed(cov(800), 800)[0].sigma_e_m == 2.0


def test_an_epoch_is_ended_by_silence():
    decoder = UbxDecoder()
    assert decoder.feed(pvt(), 0) == decoder.flush(10**8) == []
    assert len(decoder.flush(3 * 10**8)) == 1


def test_the_sky_has_nmeas_numbers():
    rows = [(0, 5, 1), (1, 123, 1), (2, 11, 0), (6, 7, 1), (4, 1, 0)]
    fields = {}
    for i, (system, number, used) in enumerate(rows, 1):
        values = {
            "gnssId": system,
            "svId": number,
            "svUsed": used,
            "cno": 40 + i,
            "elev": 10 * i,
            "azim": 300,
            "orbitSource": 1,
        }
        fields |= {f"{name}_{i:02d}": value for name, value in values.items()}
    _, decoder = decode(message("NAV", "NAV-SAT", iTOW=ITOW, version=1, numSvs=len(rows), **fields) + pvt() + eoe())
    seen = [(one.system, one.number, one.used, one.signal_dbhz, one.elevation_deg) for one in decoder.sky.satellites]
    assert seen == [(0, 5, True, 41, 10), (1, 36, True, 42, 20), (2, 11, False, 43, 30), (6, 71, True, 44, 40)]
    assert decoder.sky.pdop == 1.5


@pytest.mark.parametrize(
    ("data", "jamming", "spoofing"),
    [
        (message("NAV", "NAV-STATUS", iTOW=ITOW, spoofDetState=3), None, 2),
        (message("SEC", "SEC-SIG", version=2, jammingState=2, spoofingState=1), 1, 0),
        (message("MON", "MON-HW", jammingState=3), 2, None),
    ],
)
def test_interference_is_reported(data, jamming, spoofing):
    decoder = decode(data + pvt() + eoe())[1]
    assert (decoder.status.jamming, decoder.status.spoofing) == (jamming, spoofing)


def test_forged_signals_are_a_fault_and_their_fixes_are_refused():
    receiver = Receiver(DRIVER, Gnss(), 0)
    spoofed = message("NAV", "NAV-STATUS", iTOW=ITOW, spoofDetState=3)
    assert receiver.take(pvt() + spoofed + eoe(), 0) == []
    assert receiver.refused == {"spoofing": 1}
    assert any("spoofing" in fault for fault in receiver.faults(0))
    hint = message("NAV", "NAV-STATUS", iTOW=ITOW + 200, spoofDetState=2)
    assert len(receiver.take(pvt(ITOW + 200) + hint + eoe(ITOW + 200), 1)) == 1
    assert any("signs of spoofing" in fault for fault in receiver.faults(1))


def test_a_heading_is_that_of_a_moving_base_with_whole_ambiguities():
    good = {"gnssFixOK": 1, "relPosValid": 1, "carrSoln": 2, "isMoving": 1, "relPosHeadingValid": 1}
    for flags in (good, *({**good, name: 0} for name in good)):
        data = message("NAV", "NAV-RELPOSNED", version=1, iTOW=ITOW, relPosHeading=123.4, accHeading=0.5, **flags)
        fix = fix_of(pvt() + data + eoe())
        expected = (123.4, 0.5) if flags is good else (None, None)
        assert (fix.heading_deg, fix.heading_sigma_deg) == pytest.approx(expected, abs=1e-4)


# frames

MIXED = b"".join(
    [gga(), pvt(0), cov(0), eoe(0), b"\xd3\x00\x13" + bytes(range(22)), gga("120001.000"), pvt(200), eoe(200)]
)
FALSE = [
    b"\xb5",
    b"\xb5\x62",
    b"\xb5\x62\x01",
    b"\xb5\x62\x01\x07\x5c\x00",
    b"\xb5\x62\x01\x07\xff\x1f",
    b"\xb5\xb5\x62\x07",
]


def framed(*pieces):
    framer = Framer(Counter())
    return [(one.kind, one.payload) for i, piece in enumerate(pieces) for one in framer.feed(piece, i)]


def test_any_chunking_gives_the_same_frames_among_other_protocols():
    whole = framed(MIXED)
    assert [kind for kind, _ in whole] == [(1, 7), (1, 0x36), (1, 0x61), (1, 7), (1, 0x61)]
    assert all(framed(MIXED[:at], MIXED[at:]) == whole for at in range(len(MIXED)))
    assert framed(*(bytes([byte]) for byte in MIXED)) == whole


@pytest.mark.parametrize("false", FALSE)
def test_a_false_sync_costs_nothing_but_itself(false):
    framer = Framer(Counter())
    list(framer.feed(false, 0))
    assert [(one.kind, one.arrival_ns) for one in framer.feed(pvt(), 1)] == [((1, 7), 1)], "at once"


def test_the_arrival_is_that_of_the_first_byte():
    framer, data = Framer(Counter()), gga() + pvt()
    start, arrivals = len(gga()), []
    for i, byte in enumerate(data):
        arrivals += [one.arrival_ns for one in framer.feed(bytes([byte]), i)]
    assert arrivals == [start]


@given(st.lists(st.one_of(st.binary(max_size=40), st.sampled_from([pvt(), cov(), *FALSE]))), st.data())
def test_good_frames_come_through_garbage(pieces, draw):
    data = b"".join(pieces)
    at = draw.draw(st.integers(0, len(data)))
    found = framed(data, pvt())
    assert found[-1] == ((1, 7), pvt()[6:-2])
    assert framed(data[:at], data[at:], pvt()) == found
    assert len(found) >= 1 + sum(piece in (pvt(), cov()) for piece in pieces)


@pytest.mark.parametrize("at", range(2, 100))
def test_a_frame_with_a_wrong_byte_is_dropped(at):
    bad = bytearray(pvt())
    bad[at] ^= 0x10
    fixes, decoder = decode(bytes(bad) + pvt(ITOW + 200) + eoe(ITOW + 200))
    assert len(fixes) == 1
    assert decoder.counters["wrong checksum"] == (at not in (2, 5)), "a class or length that there is not is no frame"


# the set-up and the emulated receivers


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
@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
def test_a_receiver_as_from_the_factory_is_set_up_if_it_is_named(options, model, rate_hz):
    device = wire(**options)
    configured = set_up(device, fix_rate_hz=rate_hz)
    assert (configured.identity.model, configured.identity.baud, configured.warnings) == (model, 115200, ())
    fixes, decoder = fixes_of(device, configured)
    assert len(fixes) == pytest.approx(3 * (rate_hz or 5.0), abs=2)
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


def test_nobody_answers():
    assert run(DRIVER.identify(), Mute(38400))[0] is None
    assert isinstance(run(detect("ubx", 9600), Speaker(9600, gga()))[0], UnrecognisedData)


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
