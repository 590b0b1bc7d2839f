"""The emulated FV-M11 against the real receiver's power-up log (gpsd's test/daemon/mtk-3301.log) and pynmeagps."""

import math
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pynmeagps import NMEAReader

from imud.firmware_sim import sentences
from imud.firmware_sim.fixes import Fix, SimulatedFixes
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.nmea import FvM11
from imud.firmware_sim.scenarios import SCENARIOS
from imud.firmware_sim.sentences import Epoch, with_checksum

UTC_0 = datetime(2026, 3, 1, 23, 59, 40, 300_000, tzinfo=UTC).timestamp()  # soon midnight, and not on a whole second
FOREVER = 1e6
EPOCH = datetime(2008, 8, 23, 8, 14, 37, tzinfo=UTC).timestamp()


def trajectory(name="car"):
    return Trajectory(SCENARIOS[name](0.0, 0.0, 0.0), 35.6586, 139.7454, 60.0)


def receiver(name="car", ideal=True, seed=1, **options):
    source = SimulatedFixes(trajectory(name), np.random.default_rng(seed), UTC_0, ideal)
    return FvM11(source, UTC_0, **options)


def said(unit, until):
    """Lines with the time at which their last byte arrived."""
    lines, text, t = [], b"", 0.0
    while t < until:
        unit.advance(t)
        text += unit.uart.take(t, unit.uart.baud)
        *whole, text = text.split(b"\r\n")
        lines += [(t, line.decode("ascii")) for line in whole]
        t = max(min(unit.uart.due(), unit.deadline()), t + 1e-6)
    return lines


def parse(lines):
    return [(t, NMEAReader.parse((line + "\r\n").encode(), validate=1)) for t, line in lines if line.startswith("$GP")]


def epoch(fix=None, utc=EPOCH, valid=True):
    return Epoch(utc, fix, valid)


LOGGED = Fix(
    0.0, 0.1, 52 + 12.981473 / 60, 6 + 53.102458 / 60, 102.907 + 47.093, 0.0203, 0.0, 2.88, satellites=3
)  # 0.0203 m/s are the log's 0.039 kn and 0.073 km/h


# --- lines of the real log, byte for byte ---


@pytest.mark.parametrize(
    "form, line",
    [
        (sentences.gga, "$GPGGA,081437.000,5212.981473,N,00653.102458,E,1,3,2.88,102.907,M,47.093,M,,*5E"),
        (sentences.rmc, "$GPRMC,081437.000,A,5212.981473,N,00653.102458,E,0.039,0.00,230808,,,A*52"),
        (sentences.vtg, "$GPVTG,0.00,T,,M,0.039,N,0.073,K,A*33"),
    ],
)
def test_lines_with_a_fix_are_those_of_the_log(form, line, monkeypatch):
    monkeypatch.setattr(sentences, "GEOID_SEPARATION_M", 47.093)
    assert [with_checksum(body) for body in form(epoch(LOGGED))] == [line.encode() + b"\r\n"]


@pytest.mark.parametrize(
    "form, line",
    [
        (sentences.gga, "$GPGGA,235946.005,8960.000000,N,00000.000000,E,0,0,,137.000,M,13.000,M,,*49"),
        (sentences.rmc, "$GPRMC,235946.005,V,8960.000000,N,00000.000000,E,0.000,0.00,050180,,,N*47"),
        (sentences.vtg, "$GPVTG,0.00,T,,M,0.000,N,0.000,K,N*32"),
        (sentences.gsa, "$GPGSA,A,1,,,,,,,,,,,,,,,*1E"),
    ],
)
def test_lines_without_a_fix_are_those_of_the_log(form, line):
    unknown = epoch(utc=datetime(1980, 1, 5, 23, 59, 46, 5000, tzinfo=UTC).timestamp(), valid=False)
    assert [with_checksum(body) for body in form(unknown)] == [line.encode() + b"\r\n"]


def test_the_epoch_before_the_first_fix_has_position_but_quality_0(monkeypatch):
    monkeypatch.setattr(sentences, "GEOID_SEPARATION_M", 47.093)
    early = Fix(0.0, 0.1, 52 + 12.978993 / 60, 6 + 53.097906 / 60, 150.0, 0.0, 0.0, 2.88, satellites=3)
    line = "$GPGGA,081434.590,5212.978993,N,00653.097906,E,0,3,,102.907,M,47.093,M,,*42"
    assert [with_checksum(body) for body in sentences.gga(epoch(early, EPOCH - 2.41, valid=False))] == [
        line.encode() + b"\r\n"
    ]


def test_channels_are_longer_than_nmea_allows():
    line = with_checksum(sentences.channels(epoch())[0])
    assert len(line) == 205
    assert len(line.split(b",")) == 33


@given(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))
def test_any_position_reads_back_to_a_ten_millionth_of_a_degree(lat, lon):
    fix = Fix(0.0, 0.1, lat, lon, 0.0, None, None, 1.0)
    message = NMEAReader.parse(with_checksum(sentences.gga(epoch(fix))[0]), validate=1)
    assert message.lat == pytest.approx(lat, abs=2e-8) and message.lon == pytest.approx(lon, abs=2e-8)


def test_unknown_speed_and_course_are_empty():
    blind = Fix(0.0, 0.1, 1.0, 2.0, 3.0, None, None, 1.0)
    assert sentences.vtg(epoch(blind)) == ["GPVTG,,T,,M,,N,,K,A"]


# --- the receiver's life ---


def test_boot_text_then_search_then_jump_to_utc():
    lines = said(receiver(no_fix_s=3.0, rate_hz=1.0), 5.5)
    assert [line for _, line in lines[:4]] == [
        "$PMTK010,001*2E",
        "$POLYN,TIME,RESTART_OCCURRED",
        "$POLYN,EPH,0,00000000",
        "$POLYN,ALM,0,00000000",
    ]
    reports = [(t, m) for t, m in parse(lines) if m.msgID == "GGA"]
    assert [m.quality for _, m in reports] == [0, 0, 0, 0, 1, 1]
    assert [m.time.microsecond for _, m in reports[:3]] == [305000] * 3  # the clock before the fix, and its own grid
    assert [m.time.microsecond for _, m in reports[4:]] == [0, 0]
    assert reports[3][1].numSV == 8 and reports[2][1].numSV == 0
    dates = [m.date.year for _, m in parse(lines) if m.msgID == "RMC"]
    assert dates == [1980, 1980, 1980, 2026, 2026, 2026]
    times = [t for t, _ in lines]
    assert times == sorted(times)


def test_fixes_fall_on_whole_utc_seconds_through_midnight():
    messages = parse(said(receiver(no_fix_s=0.0), 30.0))
    stamps = [
        datetime.combine(m.date, m.time, UTC).timestamp() for _, m in messages if m.msgID == "RMC" and m.status == "A"
    ]
    assert stamps == [math.ceil(UTC_0) + i for i in range(len(stamps))] and len(stamps) >= 29


def test_order_within_an_epoch_and_every_fifth():
    unit = receiver(no_fix_s=0.0)
    unit.receive(with_checksum("PMTK314,0,1,1,1,5,5,0,0,0,0,0,0,0,0,0,0,0,0,1"), 0.0)
    kinds = [line[1:8].split(",")[0] for _, line in said(unit, 12.0)][5:]  # after the boot text and the answer
    plain, fifth = (
        ["GPGGA", "GPRMC", "PMTKCHN", "GPVTG"],
        ["GPGGA", "GPGSA", *["GPGSV"] * 3, "GPRMC", "PMTKCHN", "GPVTG"],
    )
    assert kinds[: len(plain) * 4 + len(fifth) + 4] == plain * 4 + fifth + plain


@pytest.mark.parametrize("baud", [4800, 9600, 115200])
def test_reports_are_late_by_computing_and_by_the_line(baud):
    unit = receiver(no_fix_s=0.0, baud=baud)
    first = said(unit, 2.2)[4:7]  # GGA, RMC, VTG of the first epoch, at 0.7 s
    assert [line[:6] for _, line in first] == ["$GPGGA", "$GPRMC", "$GPVTG"]
    done = 0.7 + 0.1
    for t, line in first:
        done += (len(line) + 2) * 10 / baud
        assert t == pytest.approx(done, abs=33 * 10 / baud)


def test_latency_wobbles_but_never_runs_ahead():
    source = SimulatedFixes(trajectory(), np.random.default_rng(2), UTC_0)
    late, t = [], 0.0
    for _ in range(200):
        fix = source.after(t, 1.0)
        assert fix.t == pytest.approx(t + 1.0 if t else 0.7, abs=1e-6)
        late.append(fix.arrival - fix.t)
        t = fix.t
    assert min(late) >= 0.1 and max(late) < 0.13 and np.std(late) > 1e-3


def test_a_slow_line_falls_behind_and_then_loses_whole_sentences():
    unit = receiver(no_fix_s=0.0, baud=4800, rate_hz=5.0)  # 5 x 200 bytes a second on a line for 480
    messages = parse(said(unit, 20.0))  # parse: every checksum is good
    assert unit.lost > 20
    behind = [t - m.time.second - m.time.microsecond * 1e-6 for t, m in messages if m.msgID == "GGA"]
    assert (behind[-1] - behind[0]) % 60.0 == pytest.approx(2048 * 10 / 4800, abs=1.0)


# --- what it says against the truth ---


def test_ideal_fixes_are_the_truth():
    truth = trajectory()
    checked = 0
    for _, m in parse(said(receiver(no_fix_s=0.0, rate_hz=5.0, baud=38400), 40.0)):
        if m.msgID != "GGA" and m.msgID != "RMC":
            continue
        seconds = m.time.hour * 3600 + m.time.minute * 60 + m.time.second + m.time.microsecond * 1e-6
        x = truth.at(np.array([(seconds - (23 * 3600 + 59 * 60 + 40.3)) % 86400.0]))
        assert m.lat == pytest.approx(math.degrees(x.lat[0]), abs=2e-8)
        assert m.lon == pytest.approx(math.degrees(x.lon[0]), abs=2e-8)
        speed = math.hypot(*x.v_n[0, :2])
        if m.msgID == "GGA":
            assert m.alt + m.sep == pytest.approx(x.height[0], abs=1e-3)
        else:
            assert m.spd == pytest.approx(speed * 3600 / 1852, abs=1e-3)
            if speed > 1.0:
                assert m.cog == pytest.approx(math.degrees(math.atan2(x.v_n[0, 1], x.v_n[0, 0])) % 360, abs=0.006)
                checked += 1
    assert checked > 100


def test_vtg_agrees_with_rmc_in_both_units():
    messages = [m for _, m in parse(said(receiver(ideal=False, no_fix_s=0.0), 30.0))]
    pairs = [(a, b) for a, b in pairwise(messages) if (a.msgID, b.msgID) == ("RMC", "VTG")]
    assert len(pairs) > 25
    for rmc, vtg in pairs:
        assert (rmc.spd, rmc.cog) == (vtg.sogn, vtg.cogt) and vtg.sogk == pytest.approx(1.852 * vtg.sogn, abs=2e-3)


def test_course_is_zero_at_rest():
    courses = [m.cog for _, m in parse(said(receiver("rest", ideal=False, no_fix_s=0.0), 60.0)) if m.msgID == "RMC"]
    assert len(courses) > 50 and set(courses) == {0.0}


def test_position_errors_have_their_size_and_their_memory():
    errors = []
    for seed in range(60):
        source = SimulatedFixes(trajectory("rest"), np.random.default_rng(seed), UTC_0)
        t, track = 0.0, []
        for _ in range(31):
            fix = source.after(t, 1.0)
            t = fix.t
            track.append(pymap3d.geodetic2ned(fix.lat_deg, fix.lon_deg, fix.height_m, 35.6586, 139.7454, 60.0))
        errors.append(track)
    errors = np.array(errors)  # receiver, time, axis
    slow, white = np.array([1.5, 1.5, 2.5]), np.array([0.2, 0.2, 0.4])
    assert errors.std(axis=(0, 1)) == pytest.approx(1.03 * np.hypot(slow, white), rel=0.2)
    memory = (errors[:, 0] * errors[:, 30]).mean(axis=0) / (errors[:, 0] ** 2).mean(axis=0)
    assert memory.mean() == pytest.approx(math.exp(-1.0), abs=0.2)  # tau 30 s
    steps = np.diff(errors, axis=1).std(axis=(0, 1))
    expected = np.hypot(slow * math.sqrt(2 * (1 - math.exp(-1 / 30))), white * math.sqrt(2))
    assert steps == pytest.approx(1.03 * expected, rel=0.1)


# --- commands ---


def answers(unit, command, t=0.2):
    unit.uart.take(t, unit.uart.baud)
    unit.advance(t)
    while unit.uart.due() < math.inf:
        unit.uart.take(unit.uart.due(), unit.uart.baud)
    baud = unit.uart.baud
    unit.receive(command, t)
    return unit.uart.take(FOREVER, baud).decode()


# commands with the checksums of docs/protocols.md §4.3; of the answers one is from a real log, the rest differ by XOR
@pytest.mark.parametrize(
    "command, answer",
    [
        (b"$PMTK000*32\r\n", "$PMTK001,000,3*30\r\n"),
        (b"$PMTK220,200*2C\r\n", "$PMTK001,220,3*30\r\n"),
        (b"$PMTK220,100*2F\r\n", "$PMTK001,220,2*31\r\n"),  # 10 Hz: it has only 5
        (b"$PMTK300,200,0,0,0,0*2F\r\n", "$PMTK001,300,3*33\r\n"),
        (b"$PMTK314,-1*04\r\n", "$PMTK001,314,3*36\r\n"),
        (b"$PMTK251,57600*2C\r\n", "$PMTK001,251,3*36\r\n"),  # at the old speed
        (with_checksum("PMTK251,1234"), "$PMTK001,251,2*37\r\n"),
        (with_checksum("PMTK604"), "$PMTK001,604,1*30\r\n"),
        (b"$PMTK220,200*2D\r\n", ""),  # checksum
        (b"$PMTK220,200\r\n", ""),
        (b"$GPGGA,,*00\r\n", ""),
        (with_checksum("PMTKxyz"), ""),
        (b"noise\r\n\xff\xfe$PM$PMTK000*32\r\n", "$PMTK001,000,3*30\r\n"),
    ],
)
def test_commands_are_acknowledged(command, answer):
    assert answers(receiver(), command) == answer


def test_a_receiver_without_pmtk220():
    unit = receiver(periods=(300,))
    assert answers(unit, b"$PMTK220,200*2C\r\n") == "$PMTK001,220,1*32\r\n"
    assert answers(unit, b"$PMTK300,200,0,0,0,0*2F\r\n") == "$PMTK001,300,3*33\r\n"


@pytest.mark.parametrize("command", [b"$PMTK220,200*2C\r\n", b"$PMTK300,200,0,0,0,0*2F\r\n"])
def test_the_fix_rate_can_be_set(command):
    unit = receiver(no_fix_s=0.0, baud=38400)
    unit.receive(command, 0.2)
    stamps = [m.time.microsecond for _, m in parse(said(unit, 6.0)) if m.msgID == "GGA"]
    assert stamps[:10] == [0, 200000, 400000, 600000, 800000, 0, 200000, 400000, 600000, 800000]


def test_only_the_selected_sentences_are_sent_and_the_default_returns():
    unit = receiver(no_fix_s=0.0)
    unit.receive(b"$PMTK314,0,0,1,1,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0*28\r\n", 0.2)
    assert {line[:6] for _, line in said(unit, 8.0)[5:]} == {"$GPGGA", "$GPVTG"}
    unit.receive(b"$PMTK314,-1*04\r\n", 8.0)
    assert {line[:6] for t, line in said(unit, 20.0) if t > 8.5} == {"$GPGGA", "$GPRMC", "$GPVTG", "$GPGSA", "$GPGSV"}
    assert "PMTK001,314,2" in answers(unit, with_checksum("PMTK314,1,1"), 21.0)


def test_a_new_baud_rate_holds_after_the_answer_and_0_is_the_default():
    unit = receiver(no_fix_s=0.0, baud=4800)
    assert answers(unit, b"$PMTK251,57600*2C\r\n") == "$PMTK001,251,3*36\r\n"
    assert unit.uart.baud == 57600
    assert len(parse(said(unit, 3.0))) >= 6
    answers(unit, with_checksum("PMTK251,0"), 4.0)
    assert unit.uart.baud == 4800


@given(st.lists(st.binary(max_size=400), max_size=6))
def test_garbage_never_raises(chunks):
    unit = receiver()
    for i, chunk in enumerate(chunks):
        unit.receive(chunk, 0.01 * i)
    assert "$PMTK001,000,3*30" in answers(unit, b"\r\n$PMTK000*32\r\n")


@given(st.lists(st.integers(0, 40), max_size=6))
def test_chunking_of_commands_does_not_matter(cuts):
    text = b"$PMTK000*32\r\n$PMTK314,-1*04\r\n"
    cuts = sorted({min(cut, len(text)) for cut in cuts})
    unit = receiver()
    for a, b in zip([0, *cuts], [*cuts, len(text)], strict=True):
        unit.receive(text[a:b], 0.0)
    assert unit.uart.take(FOREVER, 9600) == b"$PMTK001,000,3*30\r\n$PMTK001,314,3*36\r\n"
