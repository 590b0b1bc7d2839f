"""Devices of the kernel (IIO): how a port is set up, stamped, refused and lost; sysfs is a tree of files."""

import errno
import itertools
import os
import time
from pathlib import Path

import numpy as np
import pytest
from framer_properties import Decoder
from processes import process

from imud.commands.doctor import examine
from imud.drivers.detect import search
from imud.drivers.driver import Options, Unsupported
from imud.drivers.errors import NotSerialError, PortAbsentError, PortBusyError, PortLostError, SpecError
from imud.drivers.iio.setup import nearest_rate, rate_hz, trigger_of
from imud.drivers.registry import by_name
from imud.drivers.transport import iio, iio_sysfs
from imud.drivers.transport.dialogue_runner import run_dialogue
from imud.drivers.transport.line import open_line
from imud.drivers.transport.portspec import PortSpec

DRIVER = by_name("iio")


@pytest.mark.parametrize(
    ("available", "wanted", "expected"),
    [
        ("25.000000 50.000000 100.000000 800 1600", 1000.0, 800.0),
        ("12.5 26 52 104 208", 100.0, 104.0),
        ("12.5 26", 5.0, 12.5),
        ("[4 1 2000]", 1000.0, 1000.0),
        ("[4 1 500]", 1000.0, 500.0),
        ("0.000000 100.000000", 50.0, 100.0),
        ("", 100.0, None),
    ],
)
def test_the_rate_is_the_highest_that_is_not_above_the_wanted_one(available, wanted, expected):
    assert nearest_rate(available, wanted) == expected


def test_a_device_gets_its_own_trigger_or_that_of_imud():
    device = {"name": "bmi160", "trigger/current_trigger": ""}
    timer, own = {"name": "imud", "sampling_frequency": "100.000000"}, {"name": "bmi160-dev0"}
    assert trigger_of({"name": "x"}, {}) == ""
    assert trigger_of(device, {"trigger0": {"name": "other-dev1"}, "trigger1": timer, "trigger2": own}) == "trigger2"
    assert trigger_of(device, {"trigger1": timer}) == "trigger1"
    assert trigger_of({**device, "trigger/current_trigger": "imud"}, {"trigger1": timer, "trigger2": own}) == "trigger1"
    assert rate_hz({"sampling_frequency": "800"}, timer) == 100.0
    with pytest.raises(ValueError, match="hrtimer"):
        trigger_of(device, {"trigger0": {"name": "other-dev1"}})


@pytest.mark.parametrize("text", ["iio:", "iio:../x", "/dev/ttyUSB0:iio"])
def test_wrong_ports_are_refused(text):
    with pytest.raises(SpecError):
        PortSpec.parse(text)


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """Starts the emulator of the kernel, with its folder; IMUD_IIO_ROOT is set."""
    monkeypatch.setenv("IMUD_IIO_ROOT", str(tmp_path))
    running = []

    def start(*words):
        context = process("imud.firmware_sim", *words, "--iio-root", str(tmp_path), stdout=-1)
        running.append(context)
        emulator = context.__enter__()
        for _ in itertools.takewhile(lambda word: not word.startswith("-"), words):
            assert emulator.stdout.readline()
        return tmp_path / "sys/bus/iio/devices"

    yield start
    for context in running:
        context.__exit__(None, None, None)


def connect(name, **options):
    """The open port, its device as it was configured, and what was said of it."""
    spec = PortSpec.parse(f"iio:{name}")
    line = open_line(spec)
    found = run_dialogue(line, search(spec))
    return line, run_dialogue(line, DRIVER.configure(found, Options(**options)))


def test_a_device_is_found_by_name_label_or_number(kernel):
    devices = kernel("lsm6dso", "bmi160", "bmi160")
    (devices / "iio:device3/label").write_text("left\n")
    assert iio_sysfs.ports() == ["iio:lsm6dso", "iio:device2", "iio:device3"]
    for name, folders in {
        "lsm6dso": ["iio:device1", "iio:device0"],
        "lsm6dso_accel": ["iio:device1", "iio:device0"],
        "iio:device1": ["iio:device1", "iio:device0"],
        "device2": ["iio:device2"],
        "left": ["iio:device3"],
        "lsm6dso_accel+lsm6dso_gyro": ["iio:device1", "iio:device0"],
    }.items():
        assert iio_sysfs.find("", name) == folders, name
    with pytest.raises(NotSerialError, match="iio:iio:device2"):
        iio_sysfs.find("", "bmi160")
    with pytest.raises(PortAbsentError, match="lsm6dso_gyro"):
        iio_sysfs.find("", "icm42688")


def test_a_device_is_set_up_and_its_times_are_the_kernels(kernel):
    devices = kernel("bmi160", "--ideal", "--roll-deg", "30")
    line, found = connect("bmi160", rate_hz=420.0)
    assert (found.identity.model, found.rate_hz, found.period_ns, found.warnings) == ("bmi160", 400.0, 1, ())
    assert (found.gyro_range, found.accel_range) == pytest.approx((32767 * 0.001065, 32767 * 0.001197))
    device = devices / "iio:device0"
    assert (device / "current_timestamp_clock").read_text() == "monotonic"
    assert (device / "in_anglvel_sampling_frequency").read_text() == "400"
    assert (device / "trigger/current_trigger").read_text() == "bmi160-dev0"
    decoder, buffer = Decoder(DRIVER, found), memoryview(bytearray(8192))
    stamps = []
    while len(stamps) < 5:
        size, taken_ns = line.receive(buffer, time.monotonic_ns())
        if size:
            stamps.append((taken_ns, int.from_bytes(buffer[size - 8 : size], "little")))
            decoder.feed(bytes(buffer[:size]))
        time.sleep(0.01)
    assert all(taken == stamp for taken, stamp in stamps)
    assert set(np.diff(decoder.ticks)) <= {2_499_999, 2_500_000, 2_500_001} and decoder["lost"] == 0
    force = np.array([0.0, -np.sin(np.radians(30.0)), -np.cos(np.radians(30.0))]) * 9.7976
    assert decoder.samples[-1]["f"] == pytest.approx(force, abs=0.005)
    line.close()
    assert (device / "buffer/enable").read_text() == "0"
    line.close()


def test_a_kernel_that_stamps_with_the_time_of_day(kernel):
    devices = kernel("adis16505-2", "--ideal")
    (devices / "iio:device0/current_timestamp_clock").unlink()
    line, found = connect("adis16505-2")
    assert any("a step of that clock disturbs them" in text for text in found.warnings)
    before = time.monotonic_ns()
    time.sleep(0.05)
    size, taken_ns = line.receive(memoryview(bytearray(8192)), before)
    assert size and taken_ns > before
    line.close()


def test_a_readonly_device_is_used_as_it_is(kernel):
    devices = kernel("bmi160")
    line, found = connect("bmi160", readonly=True)
    assert isinstance(found, Unsupported) and "buffer/enable is 0" in found.why
    line.close()
    line, _ = connect("bmi160", rate_hz=200.0)
    line._buffers[0].enabled = False  # leave it streaming
    line.close()
    line, found = connect("bmi160", readonly=True)
    assert found.rate_hz == 200.0
    line.close()
    assert (devices / "iio:device0/buffer/enable").read_text() == "1"


def test_without_a_trigger_nothing_is_begun(kernel):
    devices = kernel("bmi160")
    (devices / "trigger0/name").unlink()
    (devices / "trigger0").rmdir()
    line, found = connect("bmi160")
    assert isinstance(found, Unsupported) and "iio-trig-hrtimer" in found.why
    line.close()


def test_a_device_that_does_not_deliver_says_why(kernel):
    devices = kernel("bmi160", "--faults", "trigger@0-100")
    while list(devices.glob("trigger*")):  # the fault begins once the emulator runs
        time.sleep(0.01)
    (devices / "trigger7").mkdir()
    (devices / "trigger7/name").write_text("bmi160-dev9\n")
    line, found = connect("bmi160")
    assert isinstance(found, Unsupported) and "trigger bmi160-dev9 does not fire" in found.why
    line.close()


@pytest.mark.parametrize(
    ("error", "remedy"), [("Permission denied", "udev rule"), ("Read-only file system", "ProtectKernelTunables=no")]
)
def test_refused_attributes_are_reported_with_the_remedy(kernel, monkeypatch, error, remedy):
    """The latter as in a service of systemd."""
    kernel("bmi160")
    monkeypatch.setattr(iio_sysfs, "write", lambda name, value: error)
    line, found = connect("bmi160")
    assert isinstance(found, Unsupported) and error in found.why and remedy in found.why
    line.close()


@pytest.mark.parametrize(
    ("number", "kind", "says"), [(errno.EBUSY, PortBusyError, "iiod"), (errno.EACCES, Exception, "imud doctor")]
)
def test_devices_that_cannot_be_opened(kernel, monkeypatch, number, kind, says):
    kernel("bmi160")

    def refuse(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(iio.os, "open", refuse)
    with pytest.raises(kind, match=says):
        open_line(PortSpec.parse("iio:bmi160"))


def test_too_many_open_descriptors_leave_nothing_open(kernel, monkeypatch):
    kernel("bmi160")

    def refuse():
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr("select.epoll", refuse)
    before = sum(1 for _ in Path("/proc/self/fd").iterdir())
    with pytest.raises(NotSerialError, match="iio:bmi160 cannot be used: Too many open files"):
        open_line(PortSpec.parse("iio:bmi160"))
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == before


def test_a_device_that_is_removed_while_it_streams(kernel, monkeypatch):
    kernel("bmi160")
    line, _ = connect("bmi160")

    read, fd = os.read, line._buffers[0].fd

    def gone(which, size):
        if which == fd:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        return read(which, size)

    monkeypatch.setattr(iio.os, "read", gone)
    with pytest.raises(PortLostError, match="No such device"):
        line.receive(memoryview(bytearray(8192)), 0)
    monkeypatch.undo()
    line.close()


def test_the_doctor_looks_at_iio_devices(tmp_path, kernel):
    devices = kernel("bmi160")
    assert any(one.what == "IIO device bmi160 (iio:device0) may be opened" for one in examine(tmp_path))
    (devices / "trigger0/name").unlink()
    (devices / "trigger0").rmdir()
    (devices / "iio:device0/buffer/enable").write_text("1")
    (tmp_path / "dev/iio:device0").unlink()
    found = [f"{one.grade}: {one.what}; {one.remedy}" for one in examine(tmp_path) if "IIO" in one.what]
    assert len(found) == 3 and "udev" in found[0] and "is streaming" in found[1] and "hrtimer" in found[2]
