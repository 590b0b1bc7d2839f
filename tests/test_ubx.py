"""u-blox receivers: frames and epochs. Oracle: pyubx2 encodes for ours."""

import math
from collections import Counter
from datetime import date

import pytest
from hypothesis import given
from hypothesis import strategies as st
from nmea_lines import gga
from ubx_messages import ITOW, KNOWN, TIME, cov, eoe, message, pvt

from imud.configuration.settings import Gnss
from imud.drivers.registry import by_name
from imud.drivers.ubx.decoder import UbxDecoder
from imud.drivers.ubx.frames import Framer, frame
from imud.sensors.gnss import record, refusal
from imud.sensors.receiver import Receiver


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
    receiver = Receiver(by_name("ubx"), Gnss(), 0)
    spoofed = message("NAV", "NAV-STATUS", iTOW=ITOW, spoofDetState=3)
    assert receiver.feed(pvt() + spoofed + eoe(), 0) == []
    assert receiver.refused == {"spoofing": 1}
    assert any("spoofing" in fault for fault in receiver.faults(0))
    hint, now_ns = message("NAV", "NAV-STATUS", iTOW=ITOW + 200, spoofDetState=2), 4_000_000_000
    assert len(receiver.feed(pvt(ITOW + 200) + hint + eoe(ITOW + 200), now_ns)) == 1
    assert any("signs of spoofing" in fault for fault in receiver.faults(now_ns))


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
