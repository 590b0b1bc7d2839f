"""Which SPI ports there are, what keeps one from being opened and what to do about it, and what closing gives back."""

import errno
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from fake_spi import SpiDev, stand_ins

from imud.drivers.errors import (
    NotSerialError,
    PortAbsentError,
    PortBusyError,
    PortDeniedError,
    PortSupportError,
    SpecError,
)
from imud.drivers.transport.line import open_line
from imud.drivers.transport.portspec import PortSpec


@pytest.fixture(autouse=True)
def modules(monkeypatch):
    with stand_ins(monkeypatch) as gpio:
        yield gpio


@pytest.mark.parametrize(
    ("trouble", "error", "says"),
    [
        (FileNotFoundError(errno.ENOENT, "x"), PortAbsentError, "raspi-config"),
        (PermissionError(errno.EACCES, "x"), PortDeniedError, "group spi"),
        (OSError(errno.EINVAL, "x"), NotSerialError, "Invalid argument"),
    ],
)
def test_a_device_that_cannot_be_opened(trouble, error, says):
    SpiDev.trouble = trouble
    with pytest.raises(error, match=says) as caught:
        open_line(PortSpec.parse("spi:0.0"))
    assert "/dev/spidev0.0" in str(caught.value)


@pytest.mark.parametrize(
    ("trouble", "error", "says"),
    [
        (FileNotFoundError(errno.ENOENT, "x"), PortAbsentError, "gpioinfo"),
        (PermissionError(errno.EACCES, "x"), PortDeniedError, "group gpio"),
        (OSError(errno.EBUSY, "x"), PortBusyError, "in use"),
        (ValueError("no such line"), NotSerialError, "no such line"),
    ],
)
def test_a_data_ready_line_that_cannot_be_had(modules, trouble, error, says):
    modules.trouble = trouble
    with pytest.raises(error, match=says):
        open_line(replace(PortSpec.parse("spi:0.0"), data_ready="gpiochip9:24"))
    assert SpiDev.last.closed == 1


@pytest.mark.parametrize("missing", ["spidev", "gpiod"])
def test_a_missing_package_is_named_with_the_remedy(monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(PortSupportError, match=f"{missing}.*pip install 'imud\\[spi\\]'"):
        open_line(replace(PortSpec.parse("spi:0.0"), data_ready="gpiochip0:24"))


def test_gpiod_of_the_first_generation_is_missing_too(monkeypatch):
    monkeypatch.delattr(sys.modules["gpiod"], "LineSettings")
    with pytest.raises(PortSupportError, match="gpiod 2"):
        open_line(replace(PortSpec.parse("spi:0.0"), data_ready="gpiochip0:24"))


def test_too_many_open_descriptors_leave_nothing_open(modules, monkeypatch):
    def fail():
        raise OSError(errno.EMFILE, "x")

    monkeypatch.setattr("select.epoll", fail)
    before = sum(1 for _ in Path("/proc/self/fd").iterdir())
    with pytest.raises(NotSerialError, match=r"spi:0\.0 cannot be used: Too many open files"):
        open_line(replace(PortSpec.parse("spi:0.0"), data_ready="gpiochip0:24"))
    assert (SpiDev.last.closed, modules.released) == (1, True)
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == before


def test_closing_gives_everything_back_once(modules):
    port = open_line(replace(PortSpec.parse("spi:0.0"), data_ready="gpiochip0:24"))
    port.close()
    port.close()
    assert (SpiDev.last.closed, modules.released) == (1, True)


@pytest.mark.parametrize("text", ["spi:0", "spi:a.b", "spi:0.0@9600", "spi:0.0:epson@9600", "spi:"])
def test_what_is_no_spi_port(text):
    with pytest.raises(SpecError, match="spi:"):
        PortSpec.parse(text)


def test_a_driver_may_be_named():
    assert PortSpec.parse("spi:1.2:epson") == PortSpec("spi:1.2", "epson")
    assert PortSpec.parse("spi:1.2").spi == (1, 2)
