"""Satellites from GSV and GSA: against pynmeagps, and what is lost, torn or wrong makes no satellites."""

import pynmeagps
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nmea_lines import line

from imud.drivers.fix import Satellite
from imud.drivers.nmea.decoder import NmeaDecoder

# as a u-blox M8 sends them (protocol 18, NMEA 4.1 without signal numbers)
GSV = (
    "GPGSV,3,1,11,03,03,111,00,04,15,270,00,06,01,010,00,13,06,292,00",
    "GPGSV,3,2,11,14,25,170,00,16,57,208,39,18,67,296,40,19,40,246,00",
    "GPGSV,3,3,11,22,42,067,42,24,14,311,43,46,30,200,35",
    "GLGSV,1,1,02,70,-05,123,,81,33,321,28",
)
GSA = ("GNGSA,A,3,16,18,22,24,46,,,,,,,,1.7,1.0,1.3", "GNGSA,A,3,81,,,,,,,,,,,,1.7,1.0,1.3")


SECOND = 1_000_000_000


def sky(*bodies: str):
    decoder = NmeaDecoder()
    decoder.feed(b"".join(map(line, bodies)), 1)
    return decoder.sky


def test_gsv_and_gsa_together_give_satellites_of_all_systems():
    reported = sky(*GSV, *GSA)
    found = {(s.system, s.number): s for s in reported.satellites}
    assert found[0, 16] == Satellite(0, 16, 57, 208, 39, used=True)
    assert found[1, 46] == Satellite(1, 46, 30, 200, 35, used=True)  # SBAS 133 in GPS' list
    assert found[6, 70] == Satellite(6, 70, -5, 123, None, used=False)
    assert found[6, 81].used and not found[0, 3].used
    assert len(reported.satellites) == 13
    assert (reported.pdop, reported.vdop) == (1.7, 1.3)


def test_as_another_decoder_reads_it():
    expected = set()
    for body in GSV:
        message = pynmeagps.NMEAReader.parse(line(body))
        for k in range(1, 5):
            if svid := getattr(message, f"svid_{k:02d}", None):
                fields = (getattr(message, f"{name}_{k:02d}") for name in ("elv", "az", "cno"))
                expected.add((svid, *(None if value == "" else value for value in fields)))
    reported = {(s.number, s.elevation_deg, s.azimuth_deg, s.signal_dbhz) for s in sky(*GSV).satellites}
    assert reported == expected


def test_systems_by_gsa_s_last_field_and_signals_of_one_satellite():
    reported = sky(
        "GAGSV,1,1,02,04,50,100,30,09,20,200,25,7",
        "GAGSV,1,1,01,04,50,100,44,2",  # the other signal, stronger
        "GBGSV,1,1,01,04,10,020,33,1",
        "GNGSA,A,3,04,,,,,,,,,,,,1.7,1.0,1.3,3",
    ).satellites
    assert set(reported) == {
        Satellite(2, 4, 50, 100, 44, used=True),
        Satellite(2, 9, 20, 200, 25, used=False),
        Satellite(3, 4, 10, 20, 33, used=False),
    }


def used(reported):
    return {(s.system, s.number) for s in reported.satellites if s.used}


@pytest.mark.parametrize("named", [True, False], ids=["NMEA 4.11", "NMEA 4.0"])
def test_a_system_without_satellites_in_use_takes_none_from_another(named):
    end = [",1", ",2"] if named else ["", ""]
    fix, none = f"GNGSA,A,3,16,18,,,,,,,,,,,1.7,1.0,1.3{end[0]}", f"GNGSA,A,3,,,,,,,,,,,,,1.7,1.0,1.3{end[1]}"
    assert used(sky(*GSV, fix, none)) == {(0, 16), (0, 18)}
    lost = f"GNGSA,A,1,,,,,,,,,,,,,,,{end[0]}"
    assert used(sky(*GSV, fix, none, GSV[3], lost, none)) == set()


def test_a_system_with_more_satellites_in_use_than_a_sentence_holds():
    """As receivers of all bands send it, with 13 and more of BeiDou."""
    two = ("GNGSA,A,3,07,08,,,,,,,,,,,1.7,1.0,1.3,4", "GNGSA,A,3,29,,,,,,,,,,,,1.7,1.0,1.3,4")
    both = ["GBGSV,1,1,04,07,50,100,30,08,20,200,25,29,50,100,30,30,20,200,25,1"]
    assert used(sky(*both, *two)) == {(3, 7), (3, 8), (3, 29)}
    assert used(sky(*both, *two, *both, two[1])) == {(3, 29)}


@pytest.mark.parametrize(("period_s", "epochs"), [(0.1, 30), (1.0, 9)])
def test_satellites_in_use_are_those_of_an_epoch_also_if_nothing_else_comes_between(period_s, epochs):
    decoder = NmeaDecoder()
    decoder.feed(line("GBGSV,1,1,04,07,50,100,30,08,20,200,25,29,50,100,30,30,20,200,25,1"), SECOND)
    for k in range(epochs):
        first = "07,08" if k < epochs // 3 else "08,"
        two = (f"GNGSA,A,3,{first},,,,,,,,,,,1.7,1.0,1.3,4", "GNGSA,A,3,29,,,,,,,,,,,,1.7,1.0,1.3,4")
        decoder.feed(b"".join(map(line, two)), SECOND + round(k * period_s * SECOND))
    assert used(decoder.sky) == {(3, 8), (3, 29)}


def test_satellites_of_navic_and_qzss_are_not_those_of_gps():
    reported = sky("GPGSV,1,1,01,04,50,100,30,1", "GIGSV,1,1,01,04,20,020,45,1", "QZGSV,1,1,01,02,60,030,40,1",
                   "GNGSA,A,3,04,,,,,,,,,,,,1.7,1.0,1.3,6")  # fmt: skip
    assert set(reported.satellites) == {
        Satellite(0, 4, 50, 100, 30, used=False),
        Satellite(5, 2, 60, 30, 40, used=False),
    }


def test_what_is_said_of_one_system_no_more_is_shown_no_longer():
    """GLONASS is switched off at 5 s, and GSA at 15 s."""
    decoder, shown = NmeaDecoder(), []
    for second in range(1, 40):
        bodies = [*GSV[:3], *(GSV[3:] if second <= 5 else ()), *(GSA if second <= 15 else ())]
        decoder.feed(b"".join(map(line, bodies)), second * SECOND)
        shown.append((second, {s.system for s in decoder.sky.satellites}, bool(used(decoder.sky))))
    assert [second for second, systems, _ in shown if 6 in systems] == list(range(1, 16))
    assert [second for second, _, any_used in shown if any_used] == list(range(1, 26))
    assert decoder.sky.dops_arrival_ns == 15 * SECOND


def test_lists_of_all_bands_of_all_systems():
    """17 of them, as a receiver of all bands sends."""
    signals = {"GP": "168", "GL": "13", "GA": "1257", "GB": "158BC", "GQ": "168"}
    bodies = [
        f"{talker}GSV,1,1,01,0{k},50,100,30,{signal}"
        for talker, all_of in signals.items()
        for k, signal in enumerate(all_of, 1)
    ]
    assert len(bodies) == 17 and len(sky(*bodies).satellites) == 17


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_list_with_a_sentence_lost_leaves_the_one_before(lost):
    before = "GPGSV,1,1,01,31,45,180,50"
    numbers = [s.number for s in sky(before, *(body for i, body in enumerate(GSV[:3]) if i != lost)).satellites]
    assert numbers == [31]


def test_a_shrinking_sky_and_fields_that_make_no_sense():
    reported = sky(*GSV[:3], "GPGSV,1,1,04,07,45,361,50,08,91,10,50,,,,,09,45,180,50").satellites
    assert [s.number for s in reported] == [9]


@given(st.lists(st.sampled_from([*GSV, *GSA]) | st.text("0123456789,.-ANGPSV", max_size=60).map("GPGSV,".__add__)))
def test_no_sentences_raise_and_all_is_bounded(bodies):
    reported = sky(*bodies)
    assert len({(s.system, s.number) for s in reported.satellites}) == len(reported.satellites)
    for s in reported.satellites:
        assert s.elevation_deg is None or -90 <= s.elevation_deg <= 90


def test_an_endless_list_is_cut_off():
    decoder = NmeaDecoder()
    for k in range(1, 1001):
        decoder.feed(line(f"GPGSV,1000,{k},4000" + "".join(f",{n},10,10,10" for n in range(1, 5))), k)
    assert len(decoder.sky.satellites) <= 4
