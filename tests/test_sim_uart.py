"""The emulated serial line: bytes take their time, and the wrong speed is heard as a UART hears it."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imud.firmware_sim.uart import Uart, garble

FOREVER = 1e6


@given(st.binary(min_size=1, max_size=300), st.sampled_from([4800, 9600, 115200, 460800]))
def test_bytes_arrive_whole_in_order_and_in_time(data, baud):
    line = Uart(baud)
    line.send(data, 5.0)
    assert line.backlog(5.0) == pytest.approx(len(data))
    got, last = b"", 5.0
    while line.due() < math.inf:
        t = line.due()
        chunk = line.take(t, baud)
        got += chunk
        assert t - last == pytest.approx(len(chunk) * 10 / baud) and 0 < len(chunk) <= 32
        last = t
    assert got == data and last == pytest.approx(5.0 + len(data) * 10 / baud)


def test_a_new_speed_applies_to_what_is_sent_after_it():
    line = Uart(4800)
    line.send(b"ack", 0.0)
    line.baud = 9600
    line.send(b"more", 0.0)
    assert line.take(1.0, 9600)[-4:] == b"more"
    line.send(b"ack", 2.0)
    assert line.take(3.0, 9600) == b"ack" and line.take(FOREVER, 9600) == b""


# drawn by hand: start bit, eight data bits with the lowest first, stop bit, on the listener's own grid
@pytest.mark.parametrize(
    "data, talker, listener, heard",
    [
        (b"\x00", 4800, 9600, b"\x00"),  # 18 low bits: one zero byte with a bad stop bit, then no edge
        (b"\xff", 9600, 19200, b"\xfe"),  # two low bits
        (b"\xff", 9600, 4800, b"\xff"),  # half a low bit: the edge counts, the rest is high
        (b"\xff\xff", 9600, 38400, b"\xf8\xf8"),  # four low bits each, two bytes
        (b"\x0f", 9600, 19200, b"\xfe\x80"),  # 2 low, 8 high; then start bit and 7 of the 8 low bits, high
    ],
)
def test_a_wrong_baud_rate_gives_the_garbage_of_a_uart(data, talker, listener, heard):
    assert garble(data, talker, listener)[: len(heard)] == heard


@given(st.binary(max_size=60), st.sampled_from([4800, 9600, 38400, 230400]))
def test_the_right_speed_is_understood_and_no_speed_is_silence(data, baud):
    assert garble(data, baud, baud) == data
    assert garble(data, baud, 0) == b"" == garble(data, 0, baud)
