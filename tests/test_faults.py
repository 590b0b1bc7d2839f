"""`--faults`, layer by layer, in memory: the language, the line, the sensor, the device, the fixes; and that a driver
loses nothing good behind a damaged line."""

import math
import time
from collections import Counter

import numpy as np
import pytest
from faulty import FLAT, STREAMS, decode, emulated, fates, play

from imud.drivers.nmea.decoder import NmeaDecoder
from imud.drivers.sample import SUSPECT
from imud.firmware_sim.faults.fixes import FaultyFixes
from imud.firmware_sim.faults.sensor import FaultyErrors
from imud.firmware_sim.faults.spec import EXAMPLE, KINDS, SpecError, help_text, parse
from imud.firmware_sim.faults.wire import Wire
from imud.firmware_sim.fixes import Fix
from imud.firmware_sim.noise import M_G350
from imud.firmware_sim.sentence_playback import SentencePlayback, read

DEVICES = ("g350", "nmea")
MESSAGE = bytes(range(0x20, 0x40)) + b"\r"


# --- the language ---


def test_a_spec_selects_devices_faults_and_times():
    g350, nmea = parse("flip=0.01,cut=0.02@5;gnss:loss@20-40;imu:frozen=gx+az@30-35/60;g350:delay=0.1x0.5", DEVICES)
    assert [fault.name for fault in g350] == ["flip", "cut", "frozen", "delay"]
    assert [fault.name for fault in nmea] == ["flip", "cut", "loss"]
    assert (g350[0].value, g350[2].axes, g350[3].second) == (0.01, (0, 5), 0.5)
    frozen = g350[2].span
    assert [frozen.holds(t) for t in (29.9, 30.0, 34.9, 35.0, 90.0, 95.0)] == [False, True, True, False, True, False]
    assert [frozen.after(t) for t in (0.0, 30.0, 36.0, 91.0)] == [30.0, 35.0, 90.0, 95.0]
    assert [frozen.beginnings(t) for t in (29.0, 30.0, 89.0, 90.0)] == [0, 1, 1, 2]


@pytest.mark.parametrize(
    ("spec", "complaint"),
    [
        ("flop=1", "'flop=1': no fault of that name; there are cut, flip"),
        ("flip", "flip needs a value: share of the messages"),
        ("cut=1.5", "0 to 1"),
        ("flip=often", "'often' is no number"),
        ("flip=0.1x3", "flip has one value"),
        ("baro:flip=0.1", "no device 'baro' here; there are g350, nmea"),
        ("nmea:frozen", "not a fault of nmea"),
        ("frozen=gq", "no axis 'gq'; there are gx+gy"),
        ("unplug", "when? write @FROM-TO"),
        ("reset", "when? write @FROM"),
        ("unplug@3", "FROM must lie before TO"),
        ("loss@5-2", "FROM must lie before TO"),
        ("loss@2/1", "what repeats needs an end"),
        ("jump=30@noon", "'noon' is no time"),
        ("", None),
    ],
)
def test_an_invalid_spec_is_reported(spec, complaint):
    if complaint is None:
        assert parse(spec, DEVICES) == [[], []]
        return
    with pytest.raises(SpecError) as error:
        parse(spec, DEVICES)
    assert complaint in str(error.value)


def test_a_board_without_a_counter_has_no_jumps_of_it():
    with pytest.raises(SpecError, match="not a fault of seraccel"):
        parse("count=5@1", ["seraccel"])


def test_the_help_names_every_fault():
    assert all(f"  {name} " in help_text() for name in KINDS)


# --- the line ---


def wire(spec, seed=1, log=None):
    return Wire("g350", parse(spec, ["g350"])[0], np.random.default_rng(seed), log)


@pytest.mark.parametrize(
    ("name", "is_so"),
    [
        ("cut", lambda came: MESSAGE.startswith(came) and len(came) < len(MESSAGE)),
        ("flip", lambda came: 1 <= sum((a ^ b).bit_count() for a, b in zip(came, MESSAGE, strict=True)) <= 3),
        ("drop", lambda came: 1 <= len(MESSAGE) - len(came) <= 3),
        ("dup", lambda came: 1 <= len(came) - len(MESSAGE) <= 3),
        ("header", lambda came: [b for a, b in zip(MESSAGE, came, strict=True) if a != b] == [0x20]),
        ("cr", lambda came: [b for a, b in zip(MESSAGE, came, strict=True) if a != b] == [0x0D]),
        ("junk", lambda came: came.endswith(MESSAGE) and 1 <= len(came) - len(MESSAGE) <= 16),
        ("lose", lambda came: came == b""),
    ],
)
def test_a_share_of_the_messages_has_the_named_damage(name, is_so):
    line = wire(f"{name}=0.1")
    came = [line(MESSAGE, 0.001 * k)[0] for k in range(5000)]
    damaged = [bytes_ for bytes_ in came if bytes_ != MESSAGE]
    assert all(map(is_so, damaged))
    assert line.counts[name] == len(damaged)
    assert len(damaged) == pytest.approx(500, abs=4 * math.sqrt(450))


def test_shares_add_up_and_a_seed_repeats():
    runs = []
    for seed in (1, 1, 2):
        line = wire("cut=0.1,flip=0.1,drop=0.1,lose@3-4", seed)
        runs.append([line(MESSAGE, 0.001 * k)[0] for k in range(4000)])
    assert runs[0] == runs[1] != runs[2]
    assert sum(came != MESSAGE for came in runs[0][:3000]) == pytest.approx(900, abs=4 * math.sqrt(630))
    assert all(came == b"" for came in runs[0][3000:])


def test_a_message_held_up_holds_up_those_behind_it_and_nothing_is_lost():
    for spec, until in (("delay=1x0.5@1-1.02", 1.5), ("backlog@1-3", 3.0)):
        plain, _ = emulated("g350")
        device, log = emulated("g350", faults=spec)
        waiting = [(0.85, FLAT)]
        before, after = play(plain, 4.0, list(waiting)), play(device, 4.0, waiting)
        assert b"".join(data for _, data in after) == b"".join(data for _, data in before)
        quiet = [t for t, _ in after if 1.03 < t < until - 0.01]
        assert quiet == [] and any(until <= t < until + 0.1 for t, _ in after)
        assert Counter(m.fault for m in log)["delay"] == (20 if "delay" in spec else 0)


# --- the sensor ---


class Turning:
    end = math.inf

    def imu(self, t):
        return np.outer(np.sin(t), np.ones(6))


def sensed(spec, times):
    errors = FaultyErrors(M_G350, np.random.default_rng(1), 100.0, faults=parse(spec, ["g350"])[0])
    return errors, np.vstack([errors.measure(Turning(), part) for part in np.array_split(times, 7)])


def test_axes_freeze_saturate_and_fall_to_zero_while_the_others_go_on():
    times = np.arange(1000) / 100.0
    _, plain = sensed("", times)
    errors, values = sensed("frozen=gx@2-4,zero=gy@5-6,saturated=az@7-8", times)
    assert (values[:, [2, 3, 4]] == plain[:, [2, 3, 4]]).all()
    inside = (times >= 2.0) & (times < 4.0)
    assert len(set(values[inside, 0])) == 1 and values[200, 0] == plain[200, 0]
    assert (values[~inside, 0] == plain[~inside, 0]).all()
    assert (values[500:600, 1] == 0.0).all() and (values[:500, 1] == plain[:500, 1]).all()
    assert (values[700:800, 5] == errors.limit[5]).all() and (values[800:, 5] == plain[800:, 5]).all()


@pytest.mark.parametrize("name", STREAMS)
def test_every_inertial_device_shows_a_frozen_sensor(name):
    options = ("--streaming",) if name == "seraccel" else ()
    device, _ = emulated(name, "--scenario", "figure8", *options, faults="frozen@2-3")
    samples, _ = decode(name, play(device, 2.9, STREAMS[name][4]))
    late = samples[-20:]
    assert (late["f"] == late["f"][0]).all() and (late["w"] == late["w"][0]).all()
    assert not (samples["f"][:100] == samples["f"][0]).all()


# --- the device ---


@pytest.mark.parametrize("name", ["g350", "g370", "rga300"])
def test_a_reset_loses_the_configuration(name):
    device, _ = emulated(name, faults="reset@2")
    chunks = play(device, 6.0, STREAMS[name][4])
    assert chunks[-1][0] == pytest.approx(2.0, abs=0.02)
    again = play(device, 10.0, [(7.0, STREAMS[name][4][0][1])], begin=6.0)
    assert again and again[0][0] >= 7.0


def test_a_receiver_and_a_board_boot_again_by_themselves():
    device, log = emulated("nmea", "--no-fix", "1", faults="reset@5")
    play(device, 9.0)
    assert [round(m.t, 1) for m in log if m.sent.startswith(b"$PMTK010")] == [0.1, 5.1]
    device, log = emulated("seraccel", "--streaming", faults="reset@3")
    lines = [t for t, data in play(device, 5.0) if b"X=" in data]
    assert max(np.diff(lines)) == pytest.approx(0.23, abs=0.03)


def test_counters_jump():
    device, log = emulated("g350", faults="count=100@2")
    play(device, 3.0, STREAMS["g350"][4])
    counts = np.array([int.from_bytes(m.sent[19:21]) for m in log if len(m.sent) == 22])
    assert Counter(np.diff(counts).tolist()) == {2: len(counts) - 2, 102: 1}
    device, log = emulated("rga300", faults="count=10000@2")
    play(device, 3.0, STREAMS["rga300"][4])
    timers = np.array([int.from_bytes(m.sent[14:16]) for m in log if len(m.sent) == 24])
    steps = (-np.diff(timers)) & 0xFFFF
    assert sum(steps > 20000) == 1 and np.median(steps) == pytest.approx(0.01 / 0.79e-6, rel=0.4)


# --- the fixes ---


class Standing:
    def after(self, t, interval):
        return Fix(math.floor(t) + 1.0, math.floor(t) + 1.1, 45.0, 9.0, 100.0, 0.0, 0.0, 1.0)


def place(spec, t):
    fix = FaultyFixes(Standing(), parse(spec, ["nmea"])[0]).after(t - 1.0, 1.0)
    north, east = (fix.lat_deg - 45.0) * 111_195.0, (fix.lon_deg - 9.0) * 111_195.0 * math.cos(math.radians(45.0))
    return fix.valid, pytest.approx(north, abs=0.1), pytest.approx(east, abs=0.1)


def test_fixes_are_lost_jump_and_drift():
    assert place("loss@20-40", 19.0)[0] and not place("loss@20-40", 20.0)[0] and place("loss@20-40", 40.0)[0]
    assert place("jump=300@10-20", 15.0) == (True, 300.0, 0.0)
    assert place("jump=300x90@10-20", 15.0) == (True, 0.0, 300.0)
    assert place("jump=300@10-20", 20.0) == (True, 0.0, 0.0)
    assert place("ramp=2x90@10-30", 20.0) == (True, 0.0, 20.0)
    assert place("ramp=2x90@10-30", 30.0) == (True, 0.0, 0.0)


def test_a_receiver_without_a_fix_reports_it():
    device, log = emulated("nmea", "--no-fix", "1", faults="loss@5-10")
    play(device, 14.0)
    qualities = {round(m.t): m.sent.split(b",")[6] for m in log if m.sent.startswith(b"$GPGGA") and m.t > 2.5}
    assert b"0" in qualities.values() and b"1" in qualities.values()
    assert {t for t, quality in qualities.items() if quality == b"0"} == {t for t in qualities if 5 <= t < 10}


# --- what drivers make of it: nothing good is lost ---

EACH = ("cut", "flip", "drop", "dup", "header", "cr", "junk")
TOGETHER = ",".join(f"{name}=0.006" for name in EACH)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "faults"),
    [("g350", f"{kind}=0.03") for kind in EACH]
    + [("seraccel", f"{kind}=0.03") for kind in EACH]
    + [(name, TOGETHER) for name in STREAMS],
)
def test_no_good_frame_is_lost_behind_a_line_that_damages_others(name, faults):
    options = ("--streaming",) if name == "seraccel" else ()
    seconds = 4.0 if name.startswith("g3") else 28.0
    fate = fates(name, faults, seconds, "--scenario", "car", *options)
    assert fate["damaged"] > 0 or faults.startswith("junk")
    assert fate["good"] > 2500
    assert fate["lost"] <= 1  # the last is still on the line
    assert fate["suspected"] <= 1e-3 * fate["good"]


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["g350", "g370"])
def test_damage_that_no_check_finds_is_small(name):
    fate = fates(name, TOGETHER, 6.0, "--scenario", "car")
    samples = fate["samples"]
    good = samples[samples["flags"] & SUSPECT == 0]
    turned = np.degrees(np.abs(np.diff(good["w"], axis=0)).max()) * 1e-3  # deg, by one sample of 1 ms
    assert turned < 0.1
    assert np.abs(np.diff(good["f"], axis=0)).max() < 6.0


def heard(faults, seconds=25.0):
    """The fixes that the driver finds, by time of day, and the log."""
    device, log = emulated("nmea", "--no-fix", "0.5", "--scenario", "car", faults=faults)
    decoder = NmeaDecoder()
    fixes = [fix for t, data in play(device, seconds) for fix in decoder.feed(data, round(t * 1e9))]
    return {fix.utc_s: (fix.lat_deg, fix.lon_deg) for fix in fixes}, log


@pytest.mark.parametrize("kind", [*EACH, "lose"])
def test_no_whole_epoch_is_lost_and_no_damaged_one_is_used(kind):
    truth, _ = heard("")
    fixes, log = heard(f"{kind}=0.1")
    assert len(fixes) > 10
    assert fixes.items() <= truth.items()
    gga = [m for m in log if m.sent.startswith((b"$GPGGA", b"$GPRMC")) and m.sent.split(b",")[1][-4:] == b".000"]
    spoiled = {m.sent.split(b",")[1] for m in gga if not m.came.endswith(m.sent)}
    whole = {m.sent.split(b",")[1] for m in gga} - spoiled
    fix_times = {time.strftime("%H%M%S.000", time.gmtime(round(utc_s))).encode() for utc_s in fixes}
    assert len(whole - fix_times) <= 2  # before the first fix, and the last, which nothing ends


# --- recorded sentences ---


def test_a_log_of_sentences_is_played_as_it_was_recorded(tmp_path):
    log = tmp_path / "track.nmea"
    lines = [
        b"$PMTK010,001*2E\r\n",
        b"$GPGGA,235958.000,5212.98,N,00653.10,E,1,3,2.88,102.9,M,47.0,M,,*4D\r\n$GPVTG,0.00,T,,M,0.0,N,0.0,K,A*01\r\n",
        b"$GPGGA,235959.000,damaged\r\n",
        b"$GPGGA,000001.500,5212.98,N,00653.10,E,1,3,2.88,102.9,M,47.0,M,,*4D\r\n",
        b"$GPRMC,081437.000,A,5212.98,N,00653.10,E,0.0,0.0,050180,,,A*00\r\n",
    ]
    log.write_bytes(b"".join(lines))
    assert read(log) == [(0.0, lines[0] + lines[1]), (1.0, lines[2]), (3.5, lines[3]), (4.5, lines[4])]
    chunks = play(SentencePlayback(read(log), 9600), 6.0)
    assert b"".join(data for _, data in chunks) == b"".join(lines)
    twice = play(SentencePlayback(read(log), 9600, loop=True), 10.5)
    assert b"".join(data for _, data in twice) == b"".join(lines) * 2


def test_the_help_shows_every_fault_and_an_example_that_is_one():
    said = help_text()
    assert all(f"\n  {name} " in said for name in KINDS)
    assert f'"{EXAMPLE}"' in said
    assert [len(faults) for faults in parse(EXAMPLE, DEVICES)] == [4, 4]
