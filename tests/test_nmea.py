"""NMEA sentences and epochs. Oracles: pynmeagps for the fields, exact fractions for the arithmetic."""

import math
from collections import Counter
from datetime import date
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from nmea_lines import decode, gga, line, rmc, vtg
from pynmeagps import NMEAReader
from scripted import Mute, run

from imud.drivers.driver import Options
from imud.drivers.nmea.decoder import NmeaDecoder
from imud.drivers.nmea.driver import DRIVER
from imud.drivers.nmea.sentences import Splitter

# docs/protocols.md 4.1, from a real FV-M11
NO_FIX = b"$GPGGA,235946.005,8960.000000,N,00000.000000,E,0,0,,137.000,M,13.000,M,,*49\r\n"
NO_FIX_VTG = b"$GPVTG,0.00,T,,M,0.000,N,0.000,K,N*32\r\n"
FIX = b"$GPGGA,081437.000,5212.981473,N,00653.102458,E,1,3,2.88,102.907,M,47.093,M,,*5E\r\n"
FIX_VTG = b"$GPVTG,0.00,T,,M,0.042,N,0.079,K,A*35\r\n"
BOOT = b"$PMTK010,001*2E\r\n$POLYN,0,1\r\n$POLYN,2\r\n"


def fix_of(data):
    fixes, _ = decode(data)
    assert len(fixes) == 1
    return fixes[0]


def test_the_real_receivers_fix():
    fix = fix_of(BOOT + FIX + FIX_VTG)
    assert fix.lat_deg == float(Fraction(52) + Fraction("12.981473") / 60)
    assert fix.lon_deg == float(Fraction(6) + Fraction("53.102458") / 60)
    assert (fix.alt_msl_m, fix.geoid_sep_m, fix.height_m) == (102.907, 47.093, 150.0)
    assert (fix.quality, fix.satellites, fix.hdop, fix.utc_s) == (1, 3, 2.88, 8 * 3600 + 14 * 60 + 37)
    assert (fix.course_deg, fix.date) == (0.0, None)
    assert fix.speed_mps == float(Fraction("0.079") / Fraction("3.6"))


def test_novatels_word_for_a_differential_fix():
    assert fix_of(gga(rest="9,08,0.9,545.4,M,46.9,M,,")).quality == 2


@pytest.mark.parametrize(
    ("letter", "quality"), [("A", 1), ("D", 2), ("P", 3), ("R", 4), ("F", 5), ("E", 6), ("M", 7), ("S", 8)]
)
def test_a_mode_letter_means_what_gga_numbers(letter, quality):
    """NMEA 0183 v4.11, mode indicator and GGA's quality: manual input is 7, a simulator 8."""
    sentences = (
        rmc(tail=f",,,{letter}"),
        line(f"GPGLL,4807.038,N,01131.000,E,120000,A,{letter}"),
        line(f"GNGNS,120000,4807.038,N,01131.000,E,{letter}N,08,0.9,545.4,46.9,,"),
    )
    assert [fix_of(sentence).quality for sentence in sentences] == [quality] * 3


@pytest.mark.parametrize(
    ("text", "hdop"), [("", None), ("0", None), ("0.01", 0.01), ("98.99", 98.99), ("99.0", None), ("9999", None)]
)
def test_an_hdop_without_a_figure_is_unknown(text, hdop):
    assert fix_of(gga(rest=f"1,08,{text},545.4,M,46.9,M,,")).hdop == hdop


def test_the_real_receivers_search_is_a_state_and_no_fix():
    fixes, decoder = decode(BOOT + NO_FIX + NO_FIX_VTG)
    assert fixes == []
    assert (decoder.status.quality, decoder.status.satellites, decoder.status.arrival_ns) == (0, 0, 1)
    assert decoder.counters == {"other": 1, "no checksum": 2, "no fix": 1}


@st.composite
def positions(draw):
    decimals = draw(st.integers(0, 9))
    digits = draw(st.text("0123456789", min_size=decimals, max_size=decimals))
    point = "." + digits if digits else draw(st.sampled_from(["", "."]))
    lat, lon = draw(st.integers(0, 89)), draw(st.integers(0, 179))
    minutes = draw(st.integers(0, 59))
    return (f"{lat:02}{minutes:02}{point}", draw(st.sampled_from("NS"))), (f"{lon:03}{minutes:02}{point}", "E")


@given(positions(), st.integers(1, 8), st.integers(0, 40), st.decimals(-500, 9000, places=3), st.integers(0, 86399))
def test_gga_agrees_with_pynmeagps_and_is_exact(position, quality, satellites, altitude, second):
    (lat, ns), (lon, ew) = position
    time = f"{second // 3600:02}{second // 60 % 60:02}{second % 60:02}.25"
    sentence = gga(time, f"{lat},{ns}", f"{lon},{ew}", f"{quality},{satellites},1.25,{altitude},M,-12.5,M,,")
    fix = fix_of(sentence)
    oracle = NMEAReader.parse(sentence)
    if oracle.lat != "":  # it reads no minutes without decimals
        assert fix.lat_deg == pytest.approx(oracle.lat, abs=2e-10)
        assert fix.lon_deg == pytest.approx(oracle.lon, abs=2e-10)
    assert (fix.alt_msl_m, fix.geoid_sep_m, fix.hdop) == (oracle.alt, oracle.sep, oracle.HDOP)
    assert (fix.quality, fix.satellites) == (oracle.quality, oracle.numSV or None)
    assert fix.utc_s == second + 0.25
    exact = Fraction(int(lat[:2])) + Fraction(lat[2:].rstrip(".")) / 60
    assert fix.lat_deg == float(exact) * (1 if ns == "N" else -1)
    assert fix.lon_deg == float(Fraction(int(lon[:3])) + Fraction(lon[3:].rstrip(".")) / 60)


@given(st.decimals(0, 3000, places=3), st.decimals(0, 359, places=2))
def test_speeds_and_courses_are_exact(speed, course):
    fix = fix_of(gga() + vtg(course=str(course), kmh=str(speed)))
    assert fix.speed_mps == float(Fraction(speed) * 10 / 36)
    assert fix.course_deg == float(course)
    fix = fix_of(rmc(motion=f"{speed},{course}"))
    assert fix.speed_mps == float(Fraction(speed) * 1852 / 3600)
    assert fix.speed_mps == pytest.approx(NMEAReader.parse(rmc(motion=f"{speed},{course}")).spd * 1852 / 3600)


ACCEPTED = {
    "lower-case checksum": b"$GPGGA,1,*".replace(b"$GPGGA,1,*", gga()[:-4] + gga()[-4:-2].lower() + b"\r\n"),
    "LF only": gga().replace(b"\r", b""),
    "CR only": gga().replace(b"\n", b""),
    "noise before": b"\0\0\xff~" + gga(),
    "torn sentence before": gga()[:30] + gga(),
    "two dollars": b"$" + gga(),  # ST Teseo
    "noise instead of the line end": gga().strip() + b"\x86\x00*12$",
    "explicit plus": gga(rest="1,08,+0.9,+545.4,M,+46.9,M,,"),
    "no line end before the next": gga().strip() + b"$GPGSV,1\r\n",
    "talker GN": line(gga()[1:-5].replace(b"GPGGA", b"GNGGA")),
    "talker BD": line(gga()[1:-5].replace(b"GPGGA", b"BDGGA")),
    "13 fields": gga(rest="1,08,0.9,545.4,M,46.9,M,"),
    "15 fields": gga(rest="1,08,0.9,545.4,M,46.9,M,,,extra"),
    "longer than 82 characters": gga(
        lat="4807.0380000000,N", lon="01131.0000000000,E", rest="1,08,0.9,545.40000,M,46.9,M,,"
    ),
    "long proprietary sentence before": line("PMTKCHN," + ",".join(["31432"] * 32)) + gga(),
    "no decimals in time and minutes": gga("120000", "4807,N", "01131,E"),
    "one-digit satellites": gga(rest="1,8,0.9,545.4,M,46.9,M,,"),
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_deviations_of_real_receivers_are_accepted(name):
    fix = fix_of(ACCEPTED[name])
    assert math.isclose(fix.lat_deg, 48.117, abs_tol=2e-3)
    assert fix.satellites == 8


UNKNOWN = {
    "hdop": (
        gga(rest="1,08,99.99,545.4,M,46.9,M,,"),
        gga(rest="1,08,0.00,545.4,M,46.9,M,,"),
        gga(rest="1,08,,1,M,1,M,,"),
    ),
    "satellites": (gga(rest="1,,0.9,545.4,M,46.9,M,,"),),
    "alt_msl_m": (gga(rest="1,08,0.9,,M,46.9,M,,"), gga(rest="1,08,0.9,,,,,,")),
    "height_m": (gga(rest="1,08,0.9,545.4,M,,M,,"),),
    "utc_s": (gga(time=""),),
    "course_deg": (gga() + vtg(course=""), gga() + vtg(mode=",N"), gga()),
    "speed_mps": (gga() + line("GPVTG,,T,,M,,N,,K,A"), gga() + vtg(mode=",N"), gga()),
}


@pytest.mark.parametrize(("field", "data"), [(field, data) for field, cases in UNKNOWN.items() for data in cases])
def test_empty_fields_are_unknown(field, data):
    assert getattr(fix_of(data), field) is None


def test_vtg_in_its_forms():
    eight = fix_of(gga() + vtg(mode=""))
    assert eight.course_deg == 54.7
    old = fix_of(gga() + line("GPVTG,054.7,034.4,005.5,010.2"))
    assert old.speed_mps == eight.speed_mps == float(Fraction("10.2") / Fraction("3.6"))
    knots = fix_of(gga() + line("GPVTG,360.0,T,,M,005.5,N,,K,D"))
    assert (knots.speed_mps, knots.course_deg) == (float(Fraction("5.5") * 1852 / 3600), 0.0)


def test_sentences_without_checksums_only_for_who_wants_them():
    bare = gga()[:-5] + b"\r\n"
    damaged = gga().replace(b"4807", b"4808")
    for data, taken in ((bare, 1), (bare.replace(b"4807", b"4860"), 0), (damaged, 0), (bare[:-2] + b"$", 0)):
        for unchecked in (False, True):
            decoder = DRIVER.new_decoder(unchecked)
            assert len(decoder.feed(data, 1) + decoder.flush(1 << 62)) == taken * unchecked


REFUSED = {
    "wrong checksum": gga().replace(b"4807", b"4808"),
    "no checksum": gga()[:-5] + b"\r\n",
    "garbage": line(b"GPGGA,12\x0000"),
    "too long": line("GPGGA," + "1" * 600),
    "GGA latitude": (
        gga(lat="8960.000000,N"),
        gga(lat="36000.0000,N"),
        gga(lat="9000.0001,N"),
        gga(lat="4860.000,N"),
        gga(lat="4807.038,"),
        gga(lat=",N"),
        gga(lat="4807.038,E"),
        gga(lat="48o7.038,N"),
        gga(lat="-4807.038,N"),
    ),
    "GGA longitude": (gga(lon="18000.001,E"), gga(lon="1131.000,E"), gga(lon="01131.000,")),
    "GGA position missing": gga(lat=",", lon=","),
    "GGA time": (gga("240000"), gga("126000"), gga("120061"), gga("12000"), gga("12:00:00")),
    "GGA quality": (gga(rest="10,08,0.9,545.4,M,46.9,M,,"), gga(rest="x,08,0.9,545.4,M,46.9,M,,")),
    "GGA satellites": gga(rest="1,-8,0.9,545.4,M,46.9,M,,"),
    "GGA HDOP": (gga(rest="1,08,-1,545.4,M,46.9,M,,"), gga(rest="1,08,nan,545.4,M,46.9,M,,")),
    "GGA altitude": (gga(rest="1,08,0.9,5e4,M,46.9,M,,"), gga(rest="1,08,0.9,1_0,M,46.9,M,,")),
    "GGA unit": gga(rest="1,08,0.9,545.4,F,46.9,M,,"),
    "GGA too short": tuple(gga(rest="1,08,0.9,545.4,M,46.9,M".rsplit(",", cut)[0]) for cut in range(1, 7)),
    "VTG speed": (vtg(kmh="-1"), vtg(kmh="inf"), vtg(kmh="9999")),
    "VTG course": (vtg(course="360.1"), vtg(course="-1")),
    "VTG unit": line("GPVTG,1,T,,M,1,K,1,N,A"),
    "VTG mode": vtg(mode=",x"),
    "RMC status": rmc(status=""),
    "RMC mode": rmc(tail=",,,Z"),
    "GST sigma": line("GPGST,120000,,,,,x,1,1"),
    "GNS mode": line("GNGNS,120000,4807.038,N,01131.000,E,AX,08,0.9,545.4,46.9,,"),
    "GNS position missing": line("GNGNS,120000,,,,,AN,08,0.9,545.4,46.9,,"),
    "GLL status": line("GPGLL,4807.038,N,01131.000,E,120000"),
    "GLL latitude": line("GPGLL,9000.001,N,01131.000,E,120000,A,A"),
    "GLL position missing": line("GPGLL,,,,,120000,A,A"),
    "GLL mode": line("GPGLL,4807.038,N,01131.000,E,120000,A,Z"),
    "GSA dimensions": (line("GPGSA,A,,01"), line("GPGSA,A,4,01")),
    "ZDA date": (line("GPZDA,120000,31,02,2026,,"), line("GPZDA,120000,21,11,26,,")),
}


@pytest.mark.parametrize(
    ("reason", "data"),
    [(reason, data) for reason, cases in REFUSED.items() for data in (cases if isinstance(cases, tuple) else (cases,))],
)
def test_what_is_not_correct_is_refused_and_counted(reason, data):
    fixes, decoder = decode(data)
    assert fixes == []
    assert decoder.counters == {reason: 1}


@given(st.integers(0, len(FIX) - 3), st.integers(0, 255))
def test_no_damage_to_one_byte_changes_a_fix(at, value):
    damaged = bytearray(FIX)
    damaged[at] = value
    fixes, _ = decode(bytes(damaged))
    assert fixes in ([], decode(FIX)[0])


GOOD = [
    NO_FIX,
    NO_FIX_VTG,
    FIX,
    FIX_VTG,
    BOOT,
    rmc("081437.000"),
    gga("081438"),
    vtg(),
    gga()[:20],
    b"\0\xff",
    b"$" * 3,
]


@given(
    st.lists(st.one_of(st.sampled_from(GOOD), st.binary(max_size=40), st.just(b"$" + b"x" * 700)), max_size=20),
    st.data(),
)
def test_any_chunking_gives_the_same_fixes_and_counters(pieces, data):
    stream = b"".join(pieces)
    whole, chunked = NmeaDecoder(), NmeaDecoder()
    fixes = whole.feed(stream, 5)
    at, others = 0, []
    while at < len(stream):
        size = data.draw(st.integers(1, 50))
        others += chunked.feed(stream[at : at + size], 5)
        at += size
    assert others == fixes
    assert chunked.counters == whole.counters


def test_gst_and_zda_complete_the_fix():
    fix = fix_of(gga() + line("GPGST,120000.000,1,2,3,4,0.5,0.6,1.7") + line("GPZDA,120000.000,21,11,2026,00,00"))
    assert (fix.sigma_n_m, fix.sigma_e_m, fix.sigma_d_m) == (0.5, 0.6, 1.7)
    assert fix.date == date(2026, 11, 21)


@pytest.mark.parametrize("day", ["2208-1", "000000", "310294", ""])
def test_a_receiver_whose_date_is_none_gives_its_positions_without_one(day):
    """2208-1: a Telit HE910 since GPS's weeks rolled over in April 2019 (gpsd's april6_2019.log)."""
    fix = fix_of(rmc(day=day))
    assert (fix.lat_deg, fix.date) == (fix_of(rmc()).lat_deg, None)


def test_a_receiver_without_gga_gives_fixes_too():
    fix = fix_of(rmc(tail=",,,D"))
    assert (fix.quality, fix.height_m, fix.satellites) == (2, None, None)


def test_gns_and_gll_give_fixes_where_there_is_no_gga():
    fix = fix_of(line("GNGNS,112257.00,3844.24011,N,00908.43828,W,ADF,13,1.2,12.9,47.0,,,V"))
    assert (fix.quality, fix.satellites, fix.hdop, fix.alt_msl_m, fix.height_m) == (5, 13, 1.2, 12.9, 59.9)
    assert fix.lat_deg == float(Fraction(38) + Fraction("44.24011") / 60)
    assert decode(line("GNGNS,053231.438,,,,,NNNN,00,,,0.0,,0000"))[0] == []
    fix = fix_of(line("INGLL,4426.1130,N,07140.5579,W,194102,A"))  # gpsd's humminbird-M37.log
    assert (fix.quality, fix.height_m, fix.satellites, fix.utc_s) == (1, None, None, 19 * 3600 + 41 * 60 + 2)
    assert fix.lon_deg == -float(Fraction(71) + Fraction("40.5579") / 60)
    assert decode(line("GPGLL,,,,,,V,N"))[0] == []
    for status in ("V,N", "N,N", "N", "N,A"):  # N: no fix, in the words of some receivers
        fixes, decoder = decode(line(f"GPGLL,4807.038,N,01131.000,E,120000,{status}") + gga("120001", rest="0,,,,,,,,"))
        assert fixes == [] and decoder.counters["no fix"] == 2 and "GLL status" not in decoder.counters
    assert fix_of(gga(rest="1,08,0.9,545.4,M,46.9,M")).satellites == 8  # without age and station


def test_an_invalid_sentence_beside_a_valid_one_gives_no_position():
    """Both are at 0, 0 until somebody takes them for a position."""
    void = line("GNGNS,120000.000,,,,,NN,00,,,,,")
    assert fix_of(void + rmc()).lat_deg == pytest.approx(48.1173)
    assert fix_of(line("GPGLL,,,,,120000.000,V,N") + gga()).lat_deg == pytest.approx(48.1173)


def test_a_fix_without_satellites_in_gga_does_not_know_them():
    """Garmin 25 LP and Furuno GT-88 (gpsd's garmin25lp.log, furuno_gl_ga.log)."""
    assert fix_of(gga(rest="1,00,3.1,746.1,M,44.2,M,,")).satellites is None
    gns = line("GNGNS,120000.000,4807.038,N,01131.000,E,NDD,11,1.3,545.4,46.9,,,V")
    assert fix_of(gga(rest="2,00,1.3,545.4,M,46.9,M,,") + gns).satellites == 11


def test_a_receiver_is_recognised_by_one_sentence_of_a_kind_that_is_read_or_two_of_any():
    """That noise makes one with its checksum has a chance of 1e-11 per byte."""
    assert DRIVER.recognise(FIX).driver == "nmea"
    assert DRIVER.recognise(FIX_VTG).model == "NMEA receiver"
    assert DRIVER.recognise(line("HEHDT,101.1,T")).model == "NMEA device"
    own = line("PGRME,3.0,M,4.0,M,5.0,M")
    assert DRIVER.recognise(own) is None
    assert DRIVER.recognise(own + own).model == "NMEA device"
    for other in ("AB,1", "ABCDE,1", "VNYMR,+006.380,+000.023,-001.953,+1.0640,-0.2531", "GPTXT,01,01,02,ANTSTATUS=OK"):
        assert DRIVER.recognise(line(other)) is None
        assert DRIVER.recognise(line(other) + FIX).model == "NMEA receiver"
    for read in ("GPGSV,1,1,01,04,50,100,30", "GNGSA,A,1,,,,,,,,,,,,,,,", "GPZDA,120000.00,01,06,2026,00,00"):
        assert DRIVER.recognise(line(read)).model == "NMEA receiver"
    assert DRIVER.recognise(FIX_VTG[5:]) is None
    assert DRIVER.recognise(FIX_VTG[5:] + FIX_VTG + FIX_VTG).model == "NMEA receiver"
    assert DRIVER.recognise(FIX[:-2]) is None
    assert DRIVER.recognise(FIX.replace(b"1,3", b"1,4")) is None


def test_receivers_are_only_listened_to():
    device = Mute(9600)
    assert run(DRIVER.identify(), device)[0] is None
    configured, _ = run(DRIVER.configure(DRIVER.recognise(FIX), Options()), device)
    assert configured.identity.driver == "nmea"
    assert device.written == b""


def test_checksums_of_the_public_examples():
    sentences = list(Splitter(Counter()).feed(b"$PMTK220,1000*1F\r\n$PMTK251,9600*17\r\n$PMTK314,-1*04\r\n", 3))
    assert [(s.talker, s.kind, s.fields, s.arrival_ns) for s in sentences] == [
        ("P", "MTK220", ("1000",), 3),
        ("P", "MTK251", ("9600",), 3),
        ("P", "MTK314", ("-1",), 3),
    ]
