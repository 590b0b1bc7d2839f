"""Data of an RTK base for the receiver (`--rtcm`): whole frames alone, from a server or a file. Oracle: pyrtcm."""

import os
import socket
import sys
import time
from collections import Counter
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyrtcm import calc_crc24q

from imud.daemon.corrections import STALE_NS, Corrections
from imud.daemon.port_states import PortState
from imud.daemon.ports import Port
from imud.drivers.driver import Options
from imud.drivers.errors import PortLostError
from imud.drivers.rtcm import RtcmFramer
from imud.drivers.transport.portspec import PortSpec
from imud.errors import ConfigError

STATION = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")  # RTCM 10403's example of 1005
SECOND = 10**9


def frame(payload):
    head = b"\xd3" + len(payload).to_bytes(2, "big") + payload
    return head + calc_crc24q(head).to_bytes(3, "big")


@given(st.binary(max_size=1023), st.integers(0, 8231))
def test_a_frame_is_taken_if_its_checksum_is_that_of_pyrtcm_and_not_with_one_bit_changed(payload, bit):
    data = bytearray(frame(payload))
    assert list(RtcmFramer(Counter()).feed(bytes(data))) == [data]
    data[bit // 8 % len(data)] ^= 1 << bit % 8
    assert data not in list(RtcmFramer(Counter()).feed(bytes(data) + bytes(1030)))


def test_bytes_of_which_every_second_may_begin_a_long_frame_cost_few_steps_each():
    """A checksum for each of them would be 500 steps a byte, 60 ms for each reading of the loop."""
    data, steps = b"\xd3\x03" * 4096, 0

    def count(*_):
        nonlocal steps
        steps += 1
        return count

    framer, before = RtcmFramer(Counter()), sys.gettrace()
    sys.settrace(count)
    try:
        found = list(framer.feed(data))
    finally:
        sys.settrace(before)
    assert found == []
    assert len(data) < steps < 20 * len(data)


def test_whole_frames_come_through_among_anything_else():
    data = (
        b"HTTP/1.1 200\r\n\xd3" + STATION + frame(b"") + STATION[:9] + frame(bytes(1023)) + b"$GPGGA\xd3\xff" + STATION
    )
    good = [STATION, frame(b""), frame(bytes(1023)), STATION]
    for size in (1, 7, len(data)):
        framer = RtcmFramer(counters := Counter())
        assert [one for i in range(0, len(data), size) for one in framer.feed(data[i : i + size])] == good
        assert counters["noise bytes"] == len(data) - sum(map(len, good))


@given(st.lists(st.one_of(st.binary(max_size=30), st.just(STATION), st.just(b"\xd3\x00"))))
def test_what_is_given_on_are_frames(pieces):
    framer = RtcmFramer(Counter())
    found = [one for piece in [*pieces, bytes(1100), STATION] for one in framer.feed(piece)]
    assert found[-1] == STATION
    assert all(calc_crc24q(one) == 0 for one in found)
    assert found.count(STATION) >= 1 + pieces.count(STATION)


@pytest.mark.parametrize("source", ["base", "host:", ":2101", "host:99999", "host:x", "ntrip://host/MOUNT"])
def test_sources_are_addresses_or_paths(source):
    with pytest.raises(ConfigError, match=r"gnss\.rtcm"):
        Corrections(source)


def received(corrections, expected):
    """What comes until it is as long as expected; times advance by a tenth of a second."""
    data, end, now_ns = b"", time.monotonic() + 30.0, SECOND
    while len(data) < len(expected) and time.monotonic() < end:
        data += b"".join(corrections.read(now_ns := now_ns + SECOND // 10))
        time.sleep(0.001)
    return data, now_ns


def test_a_file_is_followed_as_it_grows(tmp_path):
    file = tmp_path / "base.rtcm"
    corrections = Corrections(str(file))
    assert corrections.read(0) == []
    assert "No such file" in corrections.properties(0)["state"]
    file.write_bytes(STATION + STATION[:5])
    data, now_ns = received(corrections, STATION)
    with file.open("ab") as growing:
        growing.write(STATION[5:])
    assert [data, *corrections.read(now_ns)] == [STATION] * 2
    corrections.close()
    corrections.close()


def test_a_fifo_may_get_a_new_writer(tmp_path):
    os.mkfifo(tmp_path / "base")
    corrections = Corrections(str(tmp_path / "base"))
    assert corrections.read(0) == []
    for _ in range(2):
        with (tmp_path / "base").open("wb") as writer:
            writer.write(STATION)
        assert received(corrections, STATION)[0] == STATION
    corrections.close()


def test_a_server_that_ends_is_connected_again():
    with socket.create_server(("127.0.0.1", 0)) as server:
        corrections = Corrections(f"127.0.0.1:{server.getsockname()[1]}")
        now_ns = 0
        for _ in range(2):
            corrections.read(now_ns := now_ns + 60 * SECOND)
            client, _ = server.accept()
            with client:
                client.sendall(STATION)
                frames, end = [], time.monotonic() + 30.0
                while not frames and time.monotonic() < end:
                    frames = corrections.read(now_ns)
                assert frames == [STATION]
            while corrections.properties(now_ns)["state"].startswith("data") and time.monotonic() < end:
                corrections.read(now_ns)
            assert "ended the connection" in corrections.properties(now_ns)["state"]
        assert corrections.properties(now_ns)["frames"] == 2
        corrections.close()


def test_a_caster_of_ntrip_is_said_to_send_no_frames():
    with socket.create_server(("127.0.0.1", 0)) as server:
        corrections = Corrections(f"127.0.0.1:{server.getsockname()[1]}")
        corrections.read(SECOND)
        client, _ = server.accept()
        with client:
            client.sendall(b"HTTP/1.1 401 Unauthorized\r\nWWW-Authenticate: Basic\r\n\r\n")
        end = time.monotonic() + 30.0
        while "NTRIP" not in corrections.properties(SECOND)["state"] and time.monotonic() < end:
            corrections.read(SECOND)
        assert "NTRIP" in corrections.properties(SECOND)["state"]
        corrections.close()


def test_a_silent_source_is_opened_anew(tmp_path):
    os.mkfifo(tmp_path / "base")
    corrections = Corrections(str(tmp_path / "base"))
    corrections.read(SECOND)
    corrections.read(2 * SECOND + STALE_NS)
    assert "nothing comes; trying again" in corrections.properties(0)["state"]
    corrections.close()


def test_a_file_that_pauses_is_read_on_and_another_one_in_its_place_from_its_beginning(tmp_path):
    """Opened anew, it would send its old corrections again."""
    path, other = tmp_path / "base.rtcm", tmp_path / "other.rtcm"
    path.write_bytes(3 * STATION)
    corrections, now_ns = Corrections(str(path)), SECOND
    assert corrections.read(now_ns) == 3 * [STATION]

    def pause():
        nonlocal now_ns
        for _ in range(3):
            now_ns += SECOND + STALE_NS
            yield from corrections.read(now_ns)

    assert list(pause()) == []
    assert corrections.properties(now_ns)["state"] == "no data of the base: nothing comes"
    with path.open("ab") as file:
        file.write(STATION)
    assert list(pause()) == [STATION]
    path.write_bytes(2 * STATION)  # begun anew
    assert list(pause()) == 2 * [STATION]
    other.write_bytes(5 * STATION)
    other.rename(path)
    assert list(pause()) == 5 * [STATION]
    path.unlink()
    assert list(pause()) == []
    assert "No such file" in corrections.properties(now_ns)["state"]
    corrections.close()


def test_a_file_waits_for_the_receiver_and_what_may_not_be_written_is_not_counted_as_forwarded(tmp_path):
    path = tmp_path / "base.rtcm"
    path.write_bytes(3 * STATION)
    corrections, sent = Corrections(str(path)), []
    corrections.forward(SECOND, None)
    assert "frames" not in corrections.properties(SECOND)
    corrections.forward(2 * SECOND, lambda data: sent.append(data) or len(data))
    assert sent == 3 * [STATION] and corrections.properties(SECOND)["forwarded"] == 3
    with path.open("ab") as file:
        file.write(2 * STATION)
    corrections.forward(3 * SECOND, None)
    with path.open("ab") as file:
        file.write(STATION)
    corrections.forward(4 * SECOND, lambda _: 0)
    found = corrections.properties(4 * SECOND)
    assert (found["frames"], found["forwarded"]) == (6, 3)
    corrections.close()


def test_a_line_without_room_cuts_no_frame_short_and_what_it_did_not_take_is_not_counted_as_forwarded(tmp_path):
    """It takes 50 bytes in each turn, and 60 or 90 come."""
    path, line, room = tmp_path / "base.rtcm", bytearray(), 0
    path.write_bytes(b"")
    corrections = Corrections(str(path))

    def write(data):
        nonlocal room
        taken = data[:room]
        line.extend(taken)
        room -= len(taken)
        return len(taken)

    for k in range(1, 22):
        with path.open("ab") as file:
            file.write((k % 2 + 2) * frame(bytes(24)) if k < 21 else frame(b""))
        room = 50
        corrections.forward(k * SECOND, write)
    found = corrections.properties(21 * SECOND)
    assert found["frames"] == 51 and 20 <= found["forwarded"] < 51
    assert line == (found["forwarded"] - 1) * frame(bytes(24)) + frame(b"")
    corrections.close()


def test_the_age_is_that_of_the_last_frame(tmp_path):
    path = tmp_path / "base.rtcm"
    path.write_bytes(b"")
    corrections = Corrections(str(path))
    corrections.read(SECOND)
    assert corrections.properties(2 * SECOND)["age_s"] is None
    path.write_bytes(STATION)
    corrections.read(3 * SECOND)
    assert corrections.properties(5 * SECOND)["age_s"] == 2.0
    corrections.close()


@pytest.mark.parametrize(
    ("path", "readonly", "written"), [("/dev/a", False, 1), ("/dev/a", True, 0), ("gpsd://a", False, 0)]
)
def test_only_receivers_that_may_be_written_to_get_them(path, readonly, written):
    sent = []
    port = SimpleNamespace(
        options=Options(readonly=readonly), spec=PortSpec.parse(path), _line=SimpleNamespace(write=sent.append)
    )
    Port.forward(port, STATION)
    assert sent == [STATION] * written


def test_a_line_that_is_lost_between_two_frames_is_opened_anew_and_takes_none_of_the_others(tmp_path):
    """As of a receiver that is unplugged."""
    (tmp_path / "base.rtcm").write_bytes(3 * STATION)
    corrections, tried = Corrections(str(tmp_path / "base.rtcm")), []

    def fail(data):
        tried.append(data)
        raise PortLostError("/dev/a", "it went away")

    owner = SimpleNamespace(unwatch=lambda fd: None, disconnected=lambda port: None)
    port = Port(PortSpec.parse("/dev/a"), Options(), owner, wait=True)
    port.state, port.configured = PortState.STREAMING, object()
    port._line = SimpleNamespace(fd=-1, write=fail, close=lambda: None)
    corrections.forward(SECOND, port.forward)
    assert (tried, port.fd) == ([STATION], -1)
    assert "it went away; trying again" in port.description
    assert corrections.properties(SECOND)["forwarded"] == 0
    corrections.close()
