"""The serial accelerometer recognised, and a dialogue that never writes into a stream."""

import pytest
from scripted import Line, Mute, Speaker, run
from seraccel_lines import BINARY, GOLDEN, RAW, SUCCESSOR, raw

from imud.drivers.detect import detect
from imud.drivers.driver import Identity, Options
from imud.drivers.epson.driver import DRIVER as EPSON
from imud.drivers.findings import UnrecognisedData
from imud.drivers.seraccel.driver import DRIVER
from imud.drivers.seraccel.ranges import RANGES
from imud.drivers.seraccel.signatures import PIECE, stream_in
from imud.firmware_sim.uart import garble

MENU = (  # the successor's words, shortened
    b"--- Serial Accelerometer Dongle MMA7361 ---\n\r          Firmware Version 6.0\n\n\r"
    b"[2] Output Mode (Gravity Values)\n\r[4] Sensor Range (+/- 1.5g)\n\r[x] Exit\n\rSelection: "
)


OTHER_MENU = b"1) Calibrate\n\r2) Mode\n\r3) Frequency\n\r4) Range\n\r5) Baud\n\rx) exit\n\rSelection: "


@pytest.mark.parametrize(
    "heard",
    [
        GOLDEN[5:] + GOLDEN + GOLDEN[:9],
        (GOLDEN * 2).lower(),
        OTHER_MENU,
        SUCCESSOR * 5,
        RAW * 5,
        BINARY * 6,
        BINARY[3:] + BINARY * 7,
        MENU,
        MENU[60:],
    ],
)
def test_the_board_is_recognised(heard):
    found = DRIVER.recognise(heard)
    assert (found.driver, found.profile) == ("seraccel", "mma7260")
    assert found.firmware == ("6.0" if b"Firmware Version" in heard else "")
    assert EPSON.recognise(heard * 20) is None


@pytest.mark.parametrize(
    "heard",
    [
        b"",
        GOLDEN[:-2],
        SUCCESSOR + b"hello\n" + SUCCESSOR * 2,
        b"$GPGGA,081437.000,5212.981473,N,00653.102458,E,1,3,2.88,102.907,M,47.093,M,,*5E\r\n" * 3,
        b"Selection: ",
        b"1.0 2.0 3.0 4.0\n" * 9,
        bytes(range(256)) * 4,
        BINARY * 3,
    ],
)
def test_others_are_not(heard):
    assert DRIVER.recognise(heard) is None


class Board(Line):
    """The firmware of the successor as docs/protocols.md §3 tells it: menu, `x`, any byte stops."""

    def __init__(self, baud=57600, line=GOLDEN, rate_hz=50.0, streaming=False, menu=MENU):
        super().__init__(baud)
        self.line, self.rate_hz, self.streaming, self.menu = line, rate_hz, streaming, menu
        self.next_s = 0.0
        self.into_stream = b""  # what the host should not have written

    def receive_from(self, data):
        if self.streaming:
            self.into_stream += data
        if data and self.host_baud != self.baud:
            data = garble(data, self.host_baud, self.baud)
        self.written += data
        self.receive(data)

    def receive(self, data):
        for byte in data:
            if self.streaming or byte not in b"xX":
                self.streaming = False
                self.say(self.menu)
            else:
                self.streaming, self.next_s = True, self.now_s + 0.03
                self.say(b"x\n\n\r")

    def pass_time(self, seconds):
        super().pass_time(seconds)
        while self.streaming and self.now_s >= self.next_s:
            self.next_s += 1.0 / self.rate_hz
            self.say(self.line)


def configure(device, **options):
    device.host_baud = device.baud
    return run(DRIVER.configure(Identity("seraccel", "SerAccel", baud=device.baud), Options(**options)), device)[0]


@pytest.mark.parametrize("baud", [57600, 38400, 19200, 9600])
@pytest.mark.parametrize("line", [GOLDEN, SUCCESSOR, RAW, BINARY])
def test_a_running_stream_is_found_and_never_written_into(baud, line):
    device = Board(baud, line, streaming=True, rate_hz=30.0)
    found, seconds = run(detect(), device)
    assert (found.driver, found.baud) == ("seraccel", baud)
    result = configure(device)
    assert result.rate_hz == pytest.approx(30.0, rel=0.03)
    assert result.gyro_axes == (False, False, False)
    assert result.frame_bytes == len(line)
    assert device.into_stream == b""
    assert seconds < 12.0


@pytest.mark.parametrize("baud", [57600, 38400, 19200, 9600])
def test_a_board_in_its_menu_is_found_and_started(baud):
    device = Board(baud)
    found, _ = run(detect("seraccel"), device)
    assert (found.driver, found.baud, found.firmware) == ("seraccel", baud, "6.0")
    result = configure(device)
    assert (result.identity.model, result.rate_hz) == ("SerAccel (±1.5 g)", pytest.approx(50.0, rel=0.03))
    assert device.streaming
    assert device.into_stream == b""


def test_every_driver_asking_does_not_disturb_it_for_good():
    device = Board()
    found, seconds = run(detect(), device)
    assert found.driver == "seraccel"
    assert configure(device).rate_hz == pytest.approx(50.0, rel=0.03)
    assert device.into_stream == b""
    assert seconds < 8.0


@pytest.mark.parametrize(("rate_hz", "expected_hz"), [(1.0, 1.0), (3.0, 3.0), (7.0, 7.0), (125.0, None)])
def test_the_rate_is_the_received_one(rate_hz, expected_hz):
    result = configure(Board(streaming=True, rate_hz=rate_hz))
    assert result.rate_hz == (expected_hz if expected_hz else pytest.approx(rate_hz, rel=0.02))
    assert result.period_ns == pytest.approx(1e9 / result.rate_hz)
    assert result.delay_ns == pytest.approx(1_060_000 + len(GOLDEN) * 10e9 / 57600, abs=2)


@pytest.mark.parametrize("row", RANGES, ids=lambda row: f"{row.g:g} g")
def test_the_range_of_counts_is_that_of_the_menu_or_else_found_by_gravity(row):
    line = raw((512, 511, round((1650 + row.mv_per_g) * 1023 / 3300)), b"\n\r")
    menu = MENU.replace(b"1.5g", b"%.1fg" % row.g)
    assert configure(Board(line=line, menu=menu)).identity.model == row.model
    judged = configure(Board(line=line, streaming=True))
    assert judged.identity.model == row.model
    assert f"±{row.g:g} g" in judged.warnings[0]


def test_readonly_writes_nothing():
    waiting = Board()
    assert configure(waiting, readonly=True) is None
    assert waiting.written == b""
    assert configure(Board(streaming=True), readonly=True).rate_hz == pytest.approx(50.0, rel=0.03)


@pytest.mark.parametrize("device", [Mute(57600), Speaker(57600, b"hello, I am a coffee machine\r\n", period_s=0.05)])
def test_what_does_not_play_along_is_not_configured(device):
    assert configure(device) is None
    assert b"x" not in device.written


def test_a_stranger_that_talks_is_not_written_to():
    device = Speaker(57600, b"hello, I am a coffee machine\r\n", period_s=0.05)
    assert isinstance(run(detect("seraccel"), device)[0], UnrecognisedData)
    assert device.written == b""


@pytest.mark.parametrize(
    "sent",
    [
        b"-12.31,3.05,171.80\r\n",  # angles of a breakout board
        b"X: 21.45 Y: -4.10 Z: 43.75\r\n",  # a magnetometer's field, microtesla
        b"1024 0512 0760\r\n",  # of a converter with more bits
        b"-5 12 7\r\n",
    ],
)
def test_three_numbers_that_no_board_sends_are_another_device(sent):
    device = Speaker(57600, sent, period_s=0.02)
    found, _ = run(detect(), device)
    assert isinstance(found, UnrecognisedData) and found.baud == 57600
    assert device.written == b""


def test_an_unknown_menu_is_not_left():
    device = Board(menu=b"[1] Coffee\r\n[x] Exit\r\nSelection: ")
    device.host_baud = device.baud
    assert run(DRIVER.identify(), device)[0] is None
    assert b"x" not in device.written


def test_the_probe_has_no_effect_in_the_menu_at_any_baud_rate():
    heard = {byte for talker in DRIVER.bauds for listener in DRIVER.bauds for byte in garble(b"\xff", talker, listener)}
    assert not heard & set(range(0x20, 0x7F))


@pytest.mark.parametrize("received", [bytes(4000), b"x" * 4000, b"1\r\n" * 1000], ids=["zeros", "text", "lines"])
def test_garbage_without_a_line_end_is_read_once_and_not_from_each_of_its_bytes(received):
    assert all(PIECE.match(received, at) for at in range(len(received)))  # a search that may fail begins at each anew
    assert stream_in(received) is None
