"""Detection: which device, at which speed, and a reason that helps where there is none. On lines in memory."""

import random
from pathlib import Path

import pytest
from emulated import streaming
from scripted import G350, Mute, Speaker, Windowed, run

from imud.drivers.detect import _merged, detect
from imud.drivers.driver import GnssConfigured, Identity, Options, Unsupported
from imud.drivers.findings import Echo, Silence, UnrecognisedData
from imud.drivers.registry import by_name, drivers, names
from imud.drivers.ubx.driver import Ubx
from imud.drivers.ubx.frames import SYNC
from imud.drivers.ubx.frames import frame as ubx_frame
from imud.firmware_sim import ublox
from imud.firmware_sim.ublox_frames import Report

BURST = (
    b"$GPGGA,081437.000,5212.981473,N,00653.102458,E,1,3,2.88,102.907,M,47.093,M,,*5E\r\n"
    b"$GPVTG,0.00,T,,M,0.042,N,0.079,K,A*35\r\n"
)
QUERY_S = 0.12  # at most, for each speed of each driver
LISTEN_S = 1.33  # at most, for each speed
BOOT = b"$PMTK010,001*2E\r\n$POLYN,1\r\n"


def test_the_registry_finds_every_driver_by_its_folder():
    folders = {path.parent.name for path in (Path(__file__).parents[1] / "drivers").glob("*/driver.py")}
    assert names() == tuple(sorted(folders))
    assert [by_name(name).name for name in names()] == list(names())
    assert {driver.kind for driver in drivers()} == {"imu", "gnss"}
    with pytest.raises(KeyError, match=f"there are: {', '.join(names())}"):
        by_name("eposn")


@pytest.mark.parametrize("baud", [460800, 230400, 115200, 19200, 9600])
def test_a_silent_imu_is_asked_at_every_speed(baud):
    found, seconds = run(detect(), G350(baud))
    assert found == Identity("epson", "M-G350", "A0000123", "0113", baud, "m-g350")
    assert seconds < (2.2 if baud == 460800 else 1.1 + QUERY_S * sum(len(driver.bauds) for driver in drivers()))


@pytest.mark.parametrize("boot_s", [0.8, 2.0, 3.0])
@pytest.mark.parametrize("silent", [True, False])
def test_an_imu_that_is_starting_up_is_waited_for(boot_s, silent):
    found, seconds = run(detect(), G350(boot_s=boot_s, silent_boot=silent))
    assert isinstance(found, Identity)
    assert seconds < 10.0


@pytest.mark.parametrize("baud", [460800, 230400, 115200, 19200])
def test_a_streaming_imu_is_recognised_without_a_byte_written(baud):
    device = G350(baud).start(1 if baud > 200000 else 5)
    found, seconds = run(detect(), device)
    assert (found.driver, found.baud) == ("epson", baud)
    assert device.written == b""
    assert seconds < 7.0


@pytest.mark.parametrize("streams", [True, False], ids=["streaming", "silent"])
def test_the_speed_at_which_a_device_was_found_before_is_tried_first(streams):
    baud, seconds = 19200, {}
    for last_baud in (0, 12345, baud):
        device = G350(baud).start(5) if streams else G350(baud)
        found, seconds[last_baud] = run(detect(last_baud=last_baud), device)
        assert (found.driver, found.baud) == ("epson", baud)
    assert seconds[0] == seconds[12345] > 1.2 * seconds[baud]
    assert next(detect(last_baud=baud)).baud == baud


@pytest.mark.parametrize("new", [(2400,), (115200,), (921600, 300), (230400, 4800)])
@pytest.mark.parametrize("name", ["aaa", "zzz"])
def test_a_new_driver_changes_nothing_in_when_the_others_are_listened_to(name, new):
    known = {driver.name: driver.bauds for driver in drivers()}
    before, after = (
        list(_merged([bauds for _, bauds in sorted(those.items())])) for those in (known, known | {name: new})
    )
    assert after[:4] == before[:4]
    assert set(after) == {*before, *new}


class Pseudo(G350):
    """A pseudo-terminal: what one end says the other hears, whatever the speed."""

    def say(self, data):
        self.outgoing += data

    def receive_from(self, data):
        self.written += data
        self.receive(data)


def test_a_streaming_imu_on_a_line_without_speed_gets_the_speed_that_carries_its_full_rate():
    device = Pseudo().start()
    found, _ = run(detect(), device)
    assert (found.driver, found.baud, device.host_baud) == ("epson", 460800, 460800)
    named, _ = run(detect(baud=38400), Pseudo().start())
    assert (named.driver, named.baud) == ("epson", 38400)


@pytest.mark.parametrize("baud", [4800, 9600, 38400, 57600, 115200, 19200])
def test_a_receiver_is_recognised_without_a_byte_written(baud):
    device = Speaker(baud, BURST, first_s=0.95)
    found, seconds = run(detect(), device)
    assert (found.driver, found.baud) == ("nmea", baud)
    assert device.written == b""
    assert seconds < LISTEN_S * len({baud for driver in drivers() for baud in driver.bauds})


@pytest.mark.parametrize("baud", [230400, 460800, 921600])
def test_a_receiver_at_a_speed_that_its_driver_does_not_know_is_read_at_that_speed(baud):
    for last_baud in (0, baud):
        device = Speaker(baud, BURST)
        found, _ = run(detect(last_baud=last_baud), device)
        assert (found.driver, found.baud, device.host_baud) == ("nmea", baud, baud)


@pytest.mark.parametrize("baud", [230400, 460800, 921600])
@pytest.mark.parametrize("first_s", [1.5, 3.0])
def test_so_is_one_that_begins_to_send_while_it_is_looked_for(baud, first_s):
    device = Speaker(baud, BURST, first_s=first_s)
    found, _ = run(detect(), device)
    assert (found.driver, found.baud, device.host_baud) == ("nmea", baud, baud)


@pytest.mark.parametrize("readonly", [False, True])
@pytest.mark.parametrize("order", [1, -1], ids=["sentences first", "frames first"])
def test_a_receiver_whose_frames_bring_no_fixes_is_read_by_its_sentences(readonly, order):
    raw = ubx_frame((0x02, 0x15), bytes(112)) + ubx_frame((0x01, 0x35), bytes(8))
    parts = [BURST, raw][::order]
    device = Speaker(9600, b"".join(parts))
    found, _ = run(detect(readonly=readonly), device)
    assert (found.driver, found.baud) == ("nmea", 9600)
    assert bool(device.written) is not readonly
    named, _ = run(detect("ubx", readonly=readonly), Speaker(9600, b"".join(parts)))
    assert named.driver == "ubx"


@pytest.mark.parametrize("first_s", [1.5, 3.0, 5.5, 9.0])
def test_a_receiver_whose_only_burst_comes_while_others_are_asked_is_found(first_s):
    """As in power-save mode, with a fix every ten seconds."""
    device = Speaker(9600, BURST, period_s=60.0, first_s=first_s)
    device.say = device.outgoing.extend  # a pseudo-terminal, which has no speed
    found, _ = run(detect(), device)
    assert isinstance(found, Identity) and found.driver == "nmea"


def test_a_device_of_another_driver_than_is_named_is_named():
    found, _ = run(detect("seraccel"), Speaker(9600, BURST))
    assert (type(found), found.driver, found.baud) == (Unsupported, "nmea", 9600)
    assert "its port is named with the driver seraccel: name nmea, or no driver" in str(found)


def test_a_receiver_that_names_its_maker():
    found, _ = run(detect(baud=4800), Speaker(4800, BOOT + BURST))
    assert found.model == "MediaTek NMEA receiver"


@pytest.mark.parametrize("end", [b"\n\r", b" \r", b"\r"])
@pytest.mark.parametrize("start_s", [0.3, 0.3077])
def test_lines_as_long_as_the_frames_of_an_epson_are_text(end, start_s):
    """The successor of the SerAccel ends its lines with LF CR; a number above zero begins with a blank: 0x20."""
    text = b" 0.101\t-0.203\t 0.972" if len(end) > 1 else b"  0.101\t-0.203\t 0.972"
    board = Speaker(57600, text + end, period_s=0.02, first_s=start_s)
    assert len(board.burst) == 22
    found, _ = run(detect(), board)
    assert (found.driver, found.baud) == ("seraccel", 57600)
    assert not board.written


def test_what_the_user_names_is_all_that_is_tried():
    device = G350(230400)
    found, seconds = run(detect("epson", 230400), device)
    assert (found.baud, device.host_baud) == (230400, 230400)
    assert seconds < 1.5
    assert isinstance(run(detect("epson", 9600), G350(230400))[0], Silence)
    receiver = Speaker(9600, BURST)
    assert isinstance(run(detect("epson"), receiver)[0], UnrecognisedData)
    silent = G350()
    assert isinstance(run(detect("nmea"), silent)[0], Silence)
    assert silent.written == b""


class Modem(Mute):
    """Answers whatever ends in CR."""

    def receive(self, data):
        self.say(b"\r\nERROR\r\n" * data.count(b"\r"))


def test_a_device_that_answers_but_is_not_known_is_not_called_silent():
    found, _ = run(detect(), Modem(115200))
    assert isinstance(found, UnrecognisedData) and found.baud == 115200
    assert "text, but of no device that imud knows" in str(found) and "ERROR" in str(found)


def test_an_imu_that_never_becomes_ready_is_named():
    found, _ = run(detect(), G350(boot_s=1e3, silent_boot=False))
    assert "of an Epson sensor that says that it is not ready" in str(found)


def test_readonly_never_writes():
    device = G350()
    found, seconds = run(detect(readonly=True), device)
    assert isinstance(found, Silence)
    assert device.written == b""
    assert seconds < 10.0


def test_silence_is_explained_in_time():
    found, seconds = run(detect(), Mute(9600))
    assert seconds < 11.0, "the drivers together ask for longer, or at more speeds, than a user waits"
    assert "silent at all of " in str(found)
    for baud in ("460800", "4800", "9600"):
        assert baud in str(found)


class Loopback(Mute):
    """TX and RX connected with each other."""

    def receive_from(self, data):
        super().receive_from(data)
        self.outgoing += data


class OnAnyLine(G350):
    """On a pseudo-terminal, or behind a network: bytes pass at every speed."""

    def receive_from(self, data):
        self.baud = self.host_baud
        super().receive_from(data)


@pytest.mark.parametrize("boot_s", [1.8, 2.2, 2.6, 3.0, 3.4])
def test_a_line_without_speeds_is_not_held_to_the_one_at_which_its_device_was_ready(boot_s):
    found, _ = run(detect(), OnAnyLine(boot_s=boot_s))
    assert (found.model, found.baud) == ("M-G350", 460800)


def test_an_echo_is_reported_at_once():
    found, seconds = run(detect(), Loopback(9600))
    assert isinstance(found, Echo)
    assert seconds < 3.0


def test_an_unknown_device_is_reported_and_not_written_to():
    device = Speaker(9600, b"hello, I am a coffee machine\r\n")
    found, _ = run(detect(), device)
    assert isinstance(found, UnrecognisedData)
    assert "bytes received at" in str(found)
    assert "text, but of no device" in str(found)
    assert "hello, I am a coffee machine" in str(found)
    assert device.written == b""


@pytest.mark.parametrize("baud", [115200, 9600])
def test_a_stream_at_another_speed_than_the_one_named_is_called_garbage(baud):
    found, _ = run(detect("epson", baud, readonly=True), streaming("g350", 460800))
    assert "garbage, as of a line at another baud rate" in str(found)
    assert "leave out @BAUD" in str(found)


def test_garbage_is_the_same_news_whatever_its_bytes():
    one, other = (UnrecognisedData(bytes([128 + byte]) * 200, baud, (baud,)) for byte, baud in ((1, 9600), (2, 4800)))
    assert (str(one) != str(other)) and one.summary == other.summary


def test_a_silent_line_at_a_named_baud_rate_reports_that_no_other_was_tried():
    found, _ = run(detect("epson", 115200), G350(460800))
    assert str(found).startswith("silent at 115200 baud")
    assert "leave out @BAUD" in str(found)


def test_damaged_sentences_are_shown_as_they_are():
    found, _ = run(
        detect(), Speaker(9600, b"$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,*00\r\n")
    )
    assert "NMEA sentences with wrong checksums" in str(found)
    assert "$GPGGA,092750.000" in str(found)


def test_a_receiver_that_sends_only_gll_is_recognised():
    found, _ = run(detect(), Speaker(4800, b"$GPGLL,5742.00,N,01158.20,E,054130,A*22\r\n"))
    assert (found.model, found.baud) == ("NMEA receiver", 4800)


@pytest.mark.parametrize("baud", [4800, 9600, 38400])
@pytest.mark.parametrize("period_s", [1.0, 1.33, 1.7, 2.0])
def test_an_instrument_that_sends_a_sentence_now_and_then_is_recognised_in_all_phases(baud, period_s):
    """None may come while its speed is listened to; at other speeds it is garbage."""
    compass = b"$HEHDT,101.1,T*2E\r\n"
    for phase in range(10):
        device = Speaker(baud, compass, period_s=period_s, first_s=0.02 + 0.1 * phase * period_s)
        found, _ = run(detect(), device)
        assert (found.model, found.baud) == ("NMEA device", baud)
        assert found.driver == "nmea"


def test_a_little_garbage_is_listened_to_longer_before_it_is_called_that():
    """Not what is text, at the right speed: that is another device."""
    seconds = {}
    for name, data in (("garbage", bytes(range(128, 168))), ("text", b"I am a coffee machine, and I am ready\r\n")):
        found, seconds[name] = run(detect(), Speaker(2400 if name == "garbage" else 9600, data))
        assert isinstance(found, UnrecognisedData)
    assert seconds["text"] < LISTEN_S * 10 + 1.0 < seconds["garbage"] < 38.0


class Glitched(Speaker):
    """30 bytes of garbage at plug-in; the device at its end, if any, starts up late, and sends by turns."""

    def __init__(self, baud, *bursts):
        super().__init__(baud, b"", 0.5, 12.0 if bursts else 1e9)
        self.bursts = bursts

    def pass_time(self, seconds):
        before_s = self.now_s
        if self.bursts and self.now_s + seconds >= self.next_s:
            self.burst = self.bursts[int(self.next_s / self.period_s) % len(self.bursts)]
        super().pass_time(seconds)
        if before_s < 0.1 <= self.now_s:
            self.outgoing += bytes(range(128, 158))


def test_after_a_glitch_the_speeds_of_nmea_are_listened_to_longer_if_that_was_not_done_yet():
    seconds = {}
    for patient in (True, False):
        found, seconds[patient] = run(detect(patient=patient), Glitched(9600))
        assert isinstance(found, UnrecognisedData) and found.is_sparse
    assert seconds[True] - seconds[False] == pytest.approx(2.3 * len(by_name("nmea").bauds), abs=0.3)


def test_a_receiver_that_is_found_by_listening_longer_is_read_by_the_protocol_of_its_fixes():
    found, seconds = run(detect(), Glitched(38400, BURST, ublox.ubx.pvt(Report(1.8e9, None))))
    assert seconds > 12.0
    assert (found.driver, found.baud) == ("ubx", 38400)


@pytest.mark.parametrize("talker", ["GP", "BD", "II"])
def test_sentences_without_checksums_are_called_that(talker):
    bare = f"${talker}GGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,\r\n"
    line = Speaker(9600, bare.encode())
    found, _ = run(detect(), line)
    assert (found.model, found.baud) == ("NMEA receiver without checksums", 9600)
    driver = by_name(found.driver)
    refused, _ = run(driver.configure(found, Options()), line)
    assert isinstance(refused, Unsupported) and "gnss.require_checksum=false" in str(refused)
    assert isinstance(run(driver.configure(found, Options(unchecked=True)), line)[0], GnssConfigured)


@pytest.mark.parametrize(
    ("begin", "whose", "advice"),
    [
        ("b562 0107 5c00", "u-blox receiver in UBX,", "have it send NAV-PVT or NMEA, and name either the driver ubx"),
        ("a0a2 005b", "SiRF", "which imud does not read: have it send NMEA"),
    ],
)
def test_a_receiver_in_binary_is_named(begin, whose, advice):
    binary = bytes.fromhex(begin) + random.Random(1).randbytes(94)
    found, _ = run(detect(), Speaker(9600, binary, period_s=0.5))
    assert whose in str(found)
    assert advice in str(found)


@pytest.mark.parametrize("whole", [True, False])
def test_a_driver_that_is_a_native_protocol_by_half_is_treated_as_any_other(whole, monkeypatch):
    """As the registry warns: it queries a silent line, and the common protocol's driver, by name the first, is used."""
    native = Ubx()
    native.name = "zzz"
    if not whole:
        monkeypatch.delattr(Ubx, "sends_fixes")
    known = (*(driver for driver in drivers() if driver.name != "ubx"), native)
    monkeypatch.setattr("imud.drivers.detect.drivers", lambda: known)
    queried = []
    silent = Mute(9600)
    silent.receive = lambda data: queried.append(bytes(data))
    run(detect(), silent)
    assert any(data.startswith(SYNC) for data in queried) != whole
    found, _ = run(detect(), Speaker(9600, ublox.ubx.pvt(Report(1.8e9, None)) + BURST))
    assert found.driver == ("zzz" if whole else "nmea")


@pytest.mark.parametrize("glitch", [b"\0", b"\xff\x00\xfe"])
def test_glitches_on_an_idle_line_do_not_hide_the_device(glitch):
    device = G350()
    device.host_baud = device.baud
    device.pass_time = lambda seconds, tick=device.pass_time: (tick(seconds), glitches(device, glitch))
    assert isinstance(run(detect(), device)[0], Identity)


def glitches(device, glitch):
    if 0.5 < device.now_s < 0.5011:
        device.outgoing += glitch


def test_a_later_model_is_asked_or_recognised():
    asked, seconds = run(detect(), Windowed())
    assert (asked.driver, asked.model, asked.baud) == ("epson", "M-G364PDCA", 460800)
    assert seconds < 3.0
    heard = Windowed(230400).start(2)
    found, _ = run(detect(), heard)
    assert (found.driver, found.baud) == ("epson", 230400)
    assert heard.written == b""


def test_a_model_without_known_scales_is_named():
    found, _ = run(detect(), Windowed(product="G999PDX0"))
    assert isinstance(found, Unsupported)
    assert "G999PDX0 at 460800 baud, but it cannot be used" in str(found)
