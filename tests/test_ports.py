"""A port's way from absent to streaming: its table of states and events, what ends the program, what is waited for."""

import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from imud.daemon import ports
from imud.daemon.port_states import TRANSITIONS, PortEvent, PortState, next_state, table
from imud.drivers.dialogue import Exchange
from imud.drivers.driver import Identity, ImuConfigured, Options
from imud.drivers.errors import PortAbsentError, PortBusyError, PortDeniedError
from imud.drivers.findings import Silence, UnrecognisedData
from imud.drivers.transport.portspec import PortSpec
from imud.errors import InputOutputError

PATH = "/dev/ttyUSB0"


@pytest.fixture
def tried(monkeypatch):
    """A function that has a port tried once for each error, with which its opening fails."""

    def try_it(*errors):
        failures = iter(errors)

        def open_line(spec):
            raise next(failures)

        monkeypatch.setattr(ports, "open_line", open_line)
        port = ports.Port(PortSpec.parse(PATH), Options(), Owner(), wait=True)
        for _ in errors:
            port.on_time(port.deadline_s)
        return port

    return try_it


def test_a_device_that_is_in_use_or_forbidden_from_the_start_ends_the_program(tried):
    with pytest.raises(InputOutputError, match="in use"):
        tried(PortBusyError(PATH, "in use"))


def test_one_that_is_so_when_it_appears_is_waited_for(tried):
    """udev sets permissions a moment after the device is there, and ModemManager may look at it first."""
    port = tried(PortAbsentError(PATH, "absent"), PortDeniedError(PATH, "denied"), PortBusyError(PATH, "in use"))
    assert port.description == "in use; trying again"


class Line:
    fd, complaint = 5, ""

    def close(self):
        pass


class Owner:
    """Notes what it is notified of."""

    def __init__(self):
        self.calls = []

    def __getattr__(self, name):
        return lambda *_: self.calls.append(name)


def answer(result):
    """A dialogue that listens once, and then finds what `result` returns."""
    yield Exchange(listen_s=60.0)
    return result()


@pytest.fixture
def device(monkeypatch):
    """A device of which a test says whether it can be opened, what is found, and whether it can be set up."""
    identity = Identity("fake", "F1")
    configured = ImuConfigured(identity, 100.0, 10_000_000, 0, 0)
    device = SimpleNamespace(absent=False, identity=identity, configured=configured)

    def open_line(spec):
        if device.absent:
            raise PortAbsentError(PATH, "absent")
        return Line()

    driver = SimpleNamespace(name="fake", kind="imu", configure=lambda *_: answer(lambda: device.configured))
    monkeypatch.setattr(ports, "open_line", open_line)
    monkeypatch.setattr(ports, "search", lambda *_: answer(lambda: device.identity))
    monkeypatch.setattr(ports, "by_name", lambda name: driver)
    return device


def proceed(port):
    port.on_time(port.deadline_s)


def test_a_little_garbage_is_listened_to_longer_once_each_time_the_line_is_plugged_in(device, monkeypatch):
    patience = []

    def search(spec, readonly, last_baud, patient):
        patience.append(patient)
        return answer(lambda: device.identity)

    monkeypatch.setattr(ports, "search", search)
    port = ports.Port(PortSpec.parse(PATH), Options(), Owner(), wait=True)
    garbage = UnrecognisedData(bytes(range(128, 158)), 4800, (4800,))
    for device.identity in (Silence((4800,), True), garbage, garbage):
        proceed(port)
        proceed(port)
    device.absent = True
    proceed(port)
    device.absent = False
    proceed(port)
    assert patience == [True, True, False, True]


PATHS = {  # how a port comes to a state
    PortState.WAITING: (),
    PortState.PROBING: (proceed,),
    PortState.CONFIGURING: (proceed, proceed),
    PortState.STREAMING: (proceed, proceed, proceed),
    PortState.RELEASED: (proceed, proceed, proceed, lambda port: port.release("a spare")),
}


def cause(event, port, device):
    """Have an event happen to the port."""
    if event in (PortEvent.OPENED, PortEvent.IDENTIFIED, PortEvent.CONFIGURED):
        port.schedule_retry(0.0)
        proceed(port)
    elif event is PortEvent.LOST:
        port.lost("unplugged")
    elif event is PortEvent.RELEASED:
        port.release("a spare")
    elif port.state is PortState.STREAMING:
        port.reject("unsuitable")
    else:
        device.absent, device.identity, device.configured = True, "silent", None
        port.schedule_retry(0.0)
        proceed(port)


@pytest.mark.parametrize(("state", "event"), [(state, event) for state in TRANSITIONS for event in TRANSITIONS[state]])
def test_a_port_follows_the_table(state, event, device):
    owner = Owner()
    port = ports.Port(PortSpec.parse(PATH), Options(), owner, wait=True)
    for step in PATHS[state]:
        step(port)
    assert port.state is state
    cause(event, port, device)
    assert port.state is TRANSITIONS[state][event]
    is_open = port.state in (PortState.PROBING, PortState.CONFIGURING, PortState.STREAMING)
    assert (port.fd >= 0) == is_open == (owner.calls.count("watch") == owner.calls.count("unwatch") + 1)
    streams = owner.calls.count("connected") - owner.calls.count("disconnected")
    assert bool(port.configured) == (port.state is PortState.STREAMING) == (streams == 1)
    assert (port.deadline_s < float("inf")) == (port.state not in (PortState.RELEASED, PortState.STREAMING))


def test_an_event_that_the_table_does_not_have_is_an_error():
    with pytest.raises(ValueError, match="WAITING cannot have the event CONFIGURED"):
        next_state(PortState.WAITING, PortEvent.CONFIGURED)


def test_every_state_is_reached_and_left():
    assert {after for following in TRANSITIONS.values() for after in following.values()} == set(PortState)
    assert set(TRANSITIONS) == set(PortState)


def test_the_text_for_developers_shows_the_table():
    assert table() in (Path(__file__).parents[1] / "imud" / "README.md").read_text()


def intervals(port, attempts):
    """From each attempt to the next one, in s."""
    found = []
    for _ in range(attempts):
        proceed(port)
        found.append(port.deadline_s - time.monotonic())
    return found


def test_an_absent_port_is_looked_for_at_an_interval_that_does_not_grow(device):
    device.absent = True
    port = ports.Port(PortSpec.parse(PATH), Options(), Owner(), wait=True)
    assert max(intervals(port, 10)) <= 0.5
    server = ports.Port(PortSpec.parse("gpsd://127.0.0.1:4001"), Options(), Owner(), wait=True)
    assert intervals(server, 10)[-1] > 2.0  # resolving its name may take long
