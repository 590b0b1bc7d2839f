"""Talking to a Crossbow DMU: who it is, what it can do, its relatives, and others who are none."""

import struct

import pytest
from crossbow_packets import SUMS, packet
from hypothesis import given
from hypothesis import strategies as st
from scripted import G350, Line, Mute, Speaker, run

from imud.drivers.crossbow.driver import DRIVER
from imud.drivers.crossbow.protocol import change_baud, find_zero
from imud.drivers.crossbow.signatures import SERIES_440
from imud.drivers.detect import detect
from imud.drivers.driver import Identity, Options, Unsupported
from imud.drivers.epson.driver import DRIVER as EPSON
from imud.firmware_sim.uart import garble


class Rga(Line):
    """A unit in memory, after the papers. sends: its packets; silent: commands that it does not know; each answer
    takes it `busy_s`."""

    def __init__(
        self,
        baud=38400,
        rate_hz=100.0,
        streaming=False,
        sends=packet,
        silent="",
        part=300,
        deaf_s=0.0,
        serial=None,
        busy_s=0.0,
    ):
        super().__init__(baud)
        self.busy_s, self.answers = busy_s, []
        self.serial = serial or b"\xff\0\0\x75\x5a\xcf"
        self.rate_hz, self.streaming, self.sends, self.silent = rate_hz, streaming, sends, silent
        self.next_s, self.pending, self.part, self.deaf_s = 0.0, b"", part, deaf_s
        self.zeroed_s = None

    def one(self):
        clock = -round(self.now_s / 0.79e-6)
        return self.sends(clock=clock) if self.sends is not packet else packet(clock=clock, part=self.part)

    def receive(self, data):
        if self.now_s < self.deaf_s:
            return
        self.pending += data
        while self.pending:
            command, self.pending = self.pending[:1], self.pending[1:]
            if command == b"z":
                if not self.pending:
                    self.pending = command
                    return
                self.zeroed_s, self.pending = self.now_s + self.pending[0] * 0.35, self.pending[1:]
            elif command == b"b":
                self.say(b"B")
                self.baud = 57600
            elif command.decode("latin1") not in self.silent:
                self.obey(command)

    def obey(self, command):
        if command in (b"P", b"C", b"G"):
            self.streaming = command == b"C"
            self.next_s = self.now_s
        replies = {
            b"R": b"H", b"S": self.serial, b"v": b"\xffRGA300CA $", b"V": b"\xffupper$", b"a": b"A",
        }  # fmt: skip
        reply = self.one() if command == b"G" else replies.get(command, b"")
        begin_s = max([self.now_s] + [due_s for due_s, _ in self.answers])
        self.answers.append((begin_s + self.busy_s * bool(reply), reply))
        self.answer()

    def answer(self):
        while self.answers and self.answers[0][0] <= self.now_s:
            self.say(self.answers.pop(0)[1])

    def pass_time(self, seconds):
        super().pass_time(seconds)
        self.answer()
        if self.zeroed_s is not None and self.now_s >= self.zeroed_s:
            self.zeroed_s = None
            self.say(b"Z")
        while self.streaming and self.now_s >= self.next_s:
            self.say(self.one())
            self.next_s += 1.0 / self.rate_hz


@pytest.mark.parametrize("deaf_s", [0.0, 1.5])
def test_a_polled_unit_is_asked(deaf_s):
    found, seconds = run(detect(), Rga(deaf_s=deaf_s))
    assert found == Identity("crossbow", "DMU RGA300CA", "30042", "RGA300CA", 38400, "crossbow-dmu")
    assert seconds < 2.0 + 2.5 * deaf_s


@pytest.mark.parametrize("busy_s", [0.1, 0.22])
@pytest.mark.parametrize("polled", [False, True])
def test_a_unit_that_answers_late_is_found_and_set_up(busy_s, polled):
    unit = Rga(busy_s=busy_s)
    found, _ = run(detect(), unit)
    assert (found.serial, found.firmware) == ("30042", "RGA300CA")
    result, _ = run(DRIVER.configure(found, Options(polled=polled)), unit)
    assert (result.request is not None, unit.streaming) == (polled, not polled)
    assert not polled or 0.5 / busy_s < result.rate_hz < 1.0 / busy_s


@pytest.mark.parametrize(("busy_s", "rate_hz"), [(0.0, 133.0), (0.0072, 133.0), (0.0082, 66.0), (0.02, 33.0)])
def test_a_polled_unit_is_asked_no_faster_than_it_answers(busy_s, rate_hz):
    unit = Rga(busy_s=busy_s)
    unit.host_baud = 38400
    result, _ = run(DRIVER.configure(Identity("crossbow", "", baud=38400), Options(polled=True)), unit)
    assert (result.rate_hz, unit.answers) == (rate_hz, [])


def test_a_unit_that_sends_nothing_by_itself_is_asked():
    unit = Rga(silent="C")
    unit.host_baud = 38400
    result, _ = run(DRIVER.configure(Identity("crossbow", "", baud=38400), Options()), unit)
    assert result.request.command == b"G" and "does not stream" in result.warnings[0]
    assert run(DRIVER.configure(Identity("crossbow", "", baud=38400), Options(readonly=True)), unit)[0] is None


@pytest.mark.parametrize("rate_hz", [20.0, 100.0, 160.0])
def test_a_stream_is_recognised_without_a_byte_written(rate_hz):
    unit = Rga(rate_hz=rate_hz, streaming=True)
    found, seconds = run(detect(), unit)
    assert (found.driver, found.model, found.baud) == ("crossbow", "DMU RGA300CA", 38400)
    assert unit.written == b""
    assert seconds < 10.0


@pytest.mark.parametrize("name", list(SUMS))
def test_a_stream_with_another_checksum_is_recognised_and_reported(name):
    def odd(clock):
        return packet(clock=clock, checksum=SUMS[name])

    unit = Rga(streaming=True, sends=odd)
    unit.host_baud = 38400
    found, _ = run(detect(baud=38400), unit)
    assert found.driver == "crossbow"
    result, _ = run(DRIVER.configure(found, Options()), unit)
    assert bool(result.warnings) == (name != "bytes")
    assert result.rate_hz == 100.0


@pytest.mark.parametrize("rate_hz", [10.0, 33.0, 100.0, 160.0])
def test_configuring_starts_the_stream_and_measures_its_rate(rate_hz):
    unit = Rga(rate_hz=rate_hz, streaming=True)
    found, _ = run(detect(), unit)
    result, _ = run(DRIVER.configure(found, Options()), unit)
    assert unit.streaming
    assert (result.rate_hz, result.period_ns, result.frame_bytes) == (rate_hz, 790, 24)
    assert result.gyro_axes == (False, False, True)
    assert (result.identity.serial, result.identity.firmware, result.identity.baud) == ("30042", "RGA300CA", 38400)
    assert (result.delay_ns, result.warnings) == (6_250_000, ())


class Disturbed(Rga):
    """Of its stream, one byte in 40 arrives changed: half of its packets are not whole."""

    count = 0

    def say(self, data):
        if not self.streaming:
            return super().say(data)
        at = range(self.count, self.count + len(data))
        self.count += len(data)
        return super().say(bytes(byte ^ (k % 40 == 7) for byte, k in zip(data, at, strict=True)))


@pytest.mark.parametrize("rate_hz", [10.0, 100.0])
def test_a_disturbed_line_does_not_change_the_rate(rate_hz):
    unit = Disturbed(rate_hz=rate_hz, streaming=True)
    unit.host_baud = 38400
    result, _ = run(DRIVER.configure(Identity("crossbow", "", baud=38400), Options(readonly=True)), unit)
    assert result.rate_hz == rate_hz


def test_a_stream_at_a_speed_that_a_user_chose_is_read_at_that_speed():
    unit = Rga(baud=19200, rate_hz=60.0, streaming=True)
    found, _ = run(detect(), unit)
    assert (found.model, found.baud, unit.host_baud) == ("DMU RGA300CA", 19200, 19200)
    result, _ = run(DRIVER.configure(found, Options()), unit)
    assert (result.rate_hz, result.delay_ns) == (60.0, 12_500_000)


def test_readonly_takes_the_stream_as_it_is():
    unit = Rga(streaming=True)
    found, _ = run(detect(readonly=True), unit)
    result, _ = run(DRIVER.configure(found, Options(readonly=True)), unit)
    assert result.rate_hz == 100.0
    assert unit.written == b""


def test_unusual_properties_are_reported():
    unit = Rga(part=301)
    unit.host_baud = 38400
    result, _ = run(DRIVER.configure(Identity("crossbow", "", baud=38400), Options()), unit)
    assert ["part number 301" in warning for warning in result.warnings] == [True]
    assert run(DRIVER.configure(Identity("crossbow", "", baud=38400), Options()), Mute(38400))[0] is None


@pytest.mark.parametrize(
    ("silent", "serial", "firmware"), [("S", "", "RGA300CA"), ("v", "30042", "upper"), ("G", "30042", "RGA300CA")]
)
def test_a_unit_that_answers_not_everything(silent, serial, firmware):
    found, _ = run(detect(), Rga(silent=silent))
    assert (found.serial, found.firmware) == (serial, firmware)


def test_a_unit_that_gives_its_serial_number_as_text():
    found, _ = run(detect(), Rga(serial=b"SN 30042\r\n"))
    assert found.serial == "SN 30042"


def test_a_stream_that_nothing_stops_is_taken_as_it_is():
    unit = Rga(streaming=True, silent="RPCGSvV")
    found, _ = run(detect(), unit)
    result, _ = run(DRIVER.configure(found, Options()), unit)
    assert (result.rate_hz, result.identity.model) == (100.0, "DMU RGA300CA")


def ff(length):
    def one(clock):
        body = struct.pack(">hH", -3, clock & 0xFFFF).rjust(length - 2, b"\x12")
        return b"\xff" + body + bytes([sum(body) & 0xFF])

    return one


def vg700(clock):
    body = struct.pack(">hH", -3, clock & 0xFFFF).rjust(22, b"\x12")
    return b"\xaa\x55" + body + struct.pack(">H", sum(body))


def test_a_unit_of_which_no_packet_comes_whole_is_not_said_to_be_of_another_model():
    """Its checksums are wrong, or the line disturbs them; it answers all the same."""
    found, _ = run(detect(), Rga(sends=lambda clock: b"\xaa\x55" + bytes(22)[:-1] + b"\x01"))
    assert isinstance(found, Unsupported) and "no whole packet" in str(found)


@pytest.mark.parametrize("streaming", [True, False])
@pytest.mark.parametrize(
    ("sends", "says"), [(ff(18), "IMU"), (ff(22), "VG or"), (ff(30), "AHRS"), (vg700, "VG700MB")]
)  # fmt: skip
def test_relatives_are_named(sends, says, streaming):
    found, _ = run(detect(), Rga(sends=sends, streaming=streaming))
    assert isinstance(found, Unsupported)
    assert says in found.model
    assert "at 38400 baud, but it cannot be used" in str(found)


def crc16(data):
    """CRC-16/AUG-CCITT by long division of the whole message. Its check value is E5CC."""
    bits = int.from_bytes(data, "big") << 16
    bits ^= 0x1D0F << (8 * len(data))
    for i in range(8 * len(data) - 1, -1, -1):
        if bits >> (i + 16) & 1:
            bits ^= 0x11021 << i
    return bits


def test_the_later_series_is_named():
    assert crc16(b"123456789") == 0xE5CC

    def series_440(clock):
        body = b"S1\x18" + struct.pack(">H", clock & 0xFFFF) + b"\x12" * 22
        return b"UU" + body + struct.pack(">H", crc16(body))

    found, _ = run(detect(), Rga(sends=series_440, streaming=True))
    assert (type(found), found.model) == (Unsupported, SERIES_440)


@given(st.binary(max_size=1500))
def test_noise_is_no_device(noise):
    assert DRIVER.recognise(noise) is None


def test_others_are_not_taken_for_one():
    assert DRIVER.recognise(b"\x20" + b"\xff" * 60) is None
    assert DRIVER.recognise(b"X=-0.501 Y=-0.007 Z= 0.082\r\n" * 30) is None
    for device in (G350(), G350().start(), Speaker(38400, b"$GPVTG,0.00,T,,M,0.042,N,0.079,K,A*35\r\n" * 2)):
        found, _ = run(detect(), device)
        assert found.driver != "crossbow"
    assert run(DRIVER.identify(), Speaker(0, b"HHHH", period_s=0.01, first_s=0.0))[0] is None


def test_nothing_that_an_epson_is_asked_moves_a_dmu():
    """At none of its speeds: no zeroing, no change of speed, no stream."""
    epson = Mute(1)
    heard = b""
    for baud in EPSON.bauds:
        epson.written.clear()
        run(EPSON.identify(), epson)
        heard += garble(bytes(epson.written), baud, 38400) if baud != 38400 else bytes(epson.written)
    assert heard
    assert not set(heard) & set(b"zbC")


def test_asking_for_a_dmu_leaves_an_epson_as_it_was():
    device = G350(38400)
    device.host_baud = 38400
    before = dict(device.byte)
    assert run(DRIVER.identify(), device)[0] is None
    assert device.byte == before
    assert run(detect("epson", 38400), device)[0].model == "M-G350"


def test_asking_a_silent_line_takes_little_of_the_time_that_detection_has():
    line = Mute(38400)
    assert run(DRIVER.identify(), line)[0] is None
    assert run(DRIVER.identify(), line)[1] < 0.35  # answers may come late
    assert line.written == b"PRPR"


def test_finding_the_gyro_zero_takes_its_time():
    unit = Rga(streaming=True)
    unit.host_baud = 38400
    done, seconds = run(find_zero(10), unit)
    assert done
    assert 3.5 <= seconds < 4.0
    assert not run(find_zero(1), Mute(38400))[0]


@pytest.mark.parametrize(("hundreds", "seconds"), [(1, 5.5), (20, 15.0), (255, 120.0)])
def test_a_gyro_zero_that_does_not_come_is_waited_for_as_long_as_it_may_take(hundreds, seconds):
    """5 ms a sample, and 5 s; at most two minutes."""
    done, waited = run(find_zero(hundreds), Mute(38400))
    assert not done
    assert waited == pytest.approx(seconds, abs=0.1)


def test_changing_the_speed():
    unit = Rga(streaming=True)
    unit.host_baud = 38400
    assert run(change_baud(57600), unit)[0]
    assert unit.host_baud == 57600
    assert not run(change_baud(57600), Mute(38400))[0]
