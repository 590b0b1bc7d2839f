"""The SPI port on scripted stand-ins for spidev and gpiod: edges, stamps, what is missed."""

import errno
import select
import time
from dataclasses import replace

import pytest
from fake_spi import SpiDev, stand_ins

from imud.drivers.errors import PortLostError
from imud.drivers.spi import Bus, Cycle, Fetch
from imud.drivers.transport.line import open_line
from imud.drivers.transport.portspec import PortSpec

PERIOD_NS, SHORT_NS, MIDDLE_NS = 10_000_000_000, 10_000_000, 1_000_000_000  # no machine is late by the longest
NEW, OLD = b"\xfe\0", b"\0\0"


@pytest.fixture(autouse=True)
def modules(monkeypatch):
    with stand_ins(monkeypatch) as gpio:
        yield gpio


@pytest.fixture
def port(modules):
    with_edges = replace(PortSpec.parse("spi:0.0"), data_ready="gpiochip0:24")
    opened = open_line(with_edges)
    yield opened
    opened.close()


@pytest.fixture
def timed(modules):
    opened = open_line(PortSpec.parse("spi:1.2"))
    yield opened
    opened.close()


def readable(port, wait_ms=0):
    poll = select.poll()
    poll.register(port.fd, select.POLLIN)
    return bool(poll.poll(wait_ms))


def plan(frame=lambda answers: answers[2:], period_ns=PERIOD_NS):
    """Two words: the second's answer says whether there is news, and captures; the third's is the sample."""
    cycles = (Cycle(b"\x01\0", 7), Cycle(b"\x02\0", 8), Cycle(b"\x03\0", 9))
    return Fetch(1_000_000, cycles, 1, lambda answer: answer == NEW, 1, frame, period_ns)


def begin(port, fetch=None):
    port.set_spi(Bus(3, 500_000, 20))
    port.set_spi(fetch or plan())


def take(port):
    room = bytearray(64)
    n, ready_ns = port.receive(memoryview(room), 0)
    return bytes(room[:n]), ready_ns


def sample(port, value=b"\x12\x34", during=lambda: OLD):
    SpiDev.script += [during, NEW, value]
    return take(port)


def test_words_are_exchanged_one_by_one_with_their_pause(timed):
    timed.set_spi(Bus(3, 500_000, 20))
    device = SpiDev.last
    assert (device.opened, device.mode, device.bits_per_word, device.max_speed_hz) == ((1, 2), 3, 8, 500_000)
    SpiDev.script += [b"ab", b"cd"]
    assert not readable(timed)
    timed.write(b"\x4c\0\0\0")
    assert device.asked == [(b"\x4c\0", 500_000, 20), (b"\0\0", 500_000, 20)]
    assert readable(timed)
    assert timed.read() == b"abcd"
    assert not readable(timed)
    assert timed.read() == b""


def test_what_is_discarded_is_not_read(timed):
    timed.set_spi(Bus(3, 500_000, 20))
    SpiDev.script += [b"ab"]
    timed.write(b"\1\2")
    timed.discard()
    assert not readable(timed)
    assert timed.read() == b""


def test_a_sample_has_the_time_of_its_edge(port, modules):
    begin(port)
    edge_ns = time.monotonic_ns() - 2_000_000
    modules.edge(edge_ns)
    assert readable(port)
    frame, ready_ns = sample(port)
    assert (frame, ready_ns) == (NEW + b"\x12\x34", edge_ns)
    assert SpiDev.last.asked[-1] == (b"\x03\0", 1_000_000, 9)
    assert not readable(port)
    assert port.counters == {"overruns": 0, "torn": 0, "unannounced": 0}
    path, config = modules.requested
    assert path == "/dev/gpiochip0"
    assert config == {24: {"direction": "input", "edge_detection": "rising", "event_clock": "monotonic"}}


def test_edges_before_anything_is_fetched_do_not_wake_and_do_not_count(port, modules):
    port.set_spi(Bus(3, 500_000, 20))
    modules.edge(time.monotonic_ns())
    modules.number += 7
    modules.edge(time.monotonic_ns())
    assert not readable(port)
    begin(port)
    edge_ns = time.monotonic_ns()
    modules.edge(edge_ns)
    assert sample(port)[1] == edge_ns
    assert port.counters["overruns"] == 0
    port.set_spi(Bus(3, 500_000, 20))
    port.discard()
    modules.edge(time.monotonic_ns())
    assert not readable(port)


def test_edges_beyond_the_last_are_overruns(port, modules):
    begin(port)
    now_ns = time.monotonic_ns()
    for k in range(3):
        modules.edge(now_ns - 3_000_000 + k * 1_000_000)
    assert sample(port)[1] == now_ns - 1_000_000
    assert port.counters["overruns"] == 2


def test_edges_that_the_kernel_dropped_are_overruns(port, modules):
    begin(port)
    modules.edge(time.monotonic_ns())
    sample(port)
    modules.number += 5
    modules.edge(time.monotonic_ns())
    sample(port)
    assert port.counters["overruns"] == 5


def test_an_edge_after_the_sample_was_chosen_is_the_next_ones(port, modules):
    begin(port)
    first_ns = time.monotonic_ns() - 1_000_000
    modules.edge(first_ns)
    SpiDev.script += [OLD, NEW, lambda: modules.edge(time.monotonic_ns())]
    assert take(port)[1] == first_ns
    assert readable(port)  # it waits already
    assert sample(port)[1] > first_ns
    assert not readable(port)
    assert port.counters["overruns"] == 0


def test_an_edge_of_long_ago_is_not_this_samples(port, modules):
    begin(port)
    modules.edge(time.monotonic_ns() - 3 * PERIOD_NS)
    before_ns = time.monotonic_ns()
    assert sample(port)[1] >= before_ns - 10_000


def test_a_spurious_edge_makes_no_sample(port, modules):
    begin(port)
    modules.edge(time.monotonic_ns())
    SpiDev.script += [OLD, OLD]
    assert take(port)[0] == b""
    assert SpiDev.last.asked[-1][0] == b"\x02\0"  # the rest is left out
    assert port.counters == {"overruns": 0, "torn": 0, "unannounced": 0}


def test_a_torn_sample_is_none_and_the_next_is_looked_for_at_once(port, modules):
    begin(port, plan(lambda answers: b""))
    modules.edge(time.monotonic_ns())
    assert sample(port)[0] == b""
    assert port.counters == {"overruns": 1, "torn": 1, "unannounced": 0}
    assert readable(port)


def test_without_edges_samples_are_fetched_by_time_with_a_warning(port):
    begin(port, plan(period_ns=SHORT_NS))
    for k in range(60):
        assert not port.warning or k >= 50
        assert readable(port, 1000)
        assert sample(port)[0]
    assert port.counters["unannounced"] == 60
    assert "gpiochip0:24" in port.warning


def test_a_sample_fetched_by_time_has_the_time_at_which_it_was_chosen(timed):
    begin(timed)
    assert timed.warning == ""
    times = []

    def note():
        times.append(time.monotonic_ns())
        return OLD

    frame, ready_ns = sample(timed, during=note)
    assert frame
    assert times[0] - 8_000 <= ready_ns <= time.monotonic_ns()
    assert timed.counters == {"overruns": 0, "torn": 0}


def test_what_is_not_there_yet_is_asked_for_again(timed):
    begin(timed, plan(period_ns=MIDDLE_NS))
    for _ in range(3):
        assert readable(timed, 1000)
        SpiDev.script += [OLD, OLD]
        assert take(timed)[0] == b""
    assert readable(timed, 1000)
    assert sample(timed)[0]
    assert not readable(timed)


def test_a_device_that_has_nothing_for_long_is_asked_less_often(timed):
    begin(timed, plan(period_ns=MIDDLE_NS))
    SpiDev.script += [OLD, OLD] * 40
    for _ in range(40):
        assert take(timed)[0] == b""
    assert not readable(timed, 200)
    assert readable(timed, 5000)
    assert sample(timed)[0]
    SpiDev.script += [OLD, OLD]
    assert take(timed)[0] == b""
    assert readable(timed, 800)


def test_while_samples_are_fetched_answers_are_not_kept(timed):
    begin(timed)
    SpiDev.script += [b"ab"]
    timed.write(b"\x83\1")
    assert sample(timed)[0] == NEW + b"\x12\x34"


def test_a_data_ready_line_that_fails_is_lost(port, modules, monkeypatch):
    """As of a GPIO chip on USB that was unplugged."""
    begin(port)

    def fail():
        raise OSError(errno.ENODEV, "x")

    monkeypatch.setattr(modules, "read_edge_events", fail)
    modules.edge(1)
    SpiDev.script.extend([b"\0\0", NEW, b"\0\0"])
    with pytest.raises(PortLostError, match="gpiochip0:24 is gone: No such device"):
        take(port)


def test_a_bus_that_fails_is_lost(timed):
    begin(timed)
    SpiDev.trouble = OSError(errno.EIO, "x")
    with pytest.raises(PortLostError, match=r"spi:1\.2"):
        take(timed)
