"""A port's way from absent to streaming: what ends the program, and what is waited for."""

import pytest

from drivers.driver import Options
from drivers.errors import PortAbsentError, PortBusyError, PortDeniedError
from drivers.transport.portspec import PortSpec
from imud.daemon import ports
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
        port = ports.Port(PortSpec.parse(PATH), Options(), None, patient=True)
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
    assert port.story == "in use; trying again"
