"""Serial lines on real pseudo-terminals: opening, refusing, losing them; dialogues; how ports are written."""

import contextlib
import errno
import os
import select
import subprocess
import sys
import termios
import threading
import time
import tty
from pathlib import Path

import pytest

from imud.drivers.dialogue import Exchange
from imud.drivers.errors import (
    NotSerialError,
    PortAbsentError,
    PortBusyError,
    PortDeniedError,
    PortLostError,
    SpecError,
)
from imud.drivers.transport.dialogue_runner import LONGEST, DialogueRunner, run_dialogue
from imud.drivers.transport.portspec import PortSpec
from imud.drivers.transport.serial import SerialPort


class Pty:
    """A pseudo-terminal: `master` is the device's end, `path` the host's."""

    def __init__(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)

    def open(self, **spec):
        return SerialPort(PortSpec(self.path, **spec))

    def unplug(self):
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1


@pytest.fixture
def pty():
    line = Pty()
    yield line
    line.unplug()


def wait_readable(fd):
    assert select.select([fd], [], [], 10.0)[0]


def holding(path, how):
    """Another process that holds `path` open until it is killed."""
    code = f"import fcntl, os, sys, termios; fd = os.open(sys.argv[1], os.O_RDWR); {how}; print(1, flush=True); input()"
    other = subprocess.Popen(
        [sys.executable, "-c", code, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout.readline() == "1\n"
    return other


def end(process):
    process.kill()
    process.communicate()


def test_bytes_are_never_stamped_earlier_than_they_were_sent(pty):
    """Though the host woke up, was kept from running, and reads what came meanwhile, too."""
    port, room = pty.open(), memoryview(bytearray(100))
    woke_ns = time.monotonic_ns()
    os.write(pty.master, b"later")
    sent_ns = time.monotonic_ns()
    wait_readable(port.fd)
    received, arrival_ns = port.receive(room, woke_ns)
    assert received == 5 and sent_ns <= arrival_ns <= time.monotonic_ns()
    port.close()


def test_bytes_pass_unchanged_both_ways(pty):
    port, every = pty.open(), bytes(range(256))
    os.write(pty.master, every)
    wait_readable(port.fd)
    assert port.read() == every
    port.write(every)
    assert os.read(pty.master, 1000) == every
    assert port.read() == b""
    port.close()
    port.close()


def test_what_was_waiting_before_the_opening_is_thrown_away(pty):
    os.write(pty.master, b"stale")
    wait_readable(pty.slave)
    port = pty.open()
    os.write(pty.master, b"fresh")
    wait_readable(port.fd)
    assert port.read() == b"fresh"
    port.close()


def test_the_speed_is_set_and_seen_from_the_other_side(pty):
    port = pty.open(baud=9600)
    for baud, code in ((9600, termios.B9600), (460800, termios.B460800), (4800, termios.B4800)):
        port.set_baud(baud)
        assert port.baud == baud
        assert termios.tcgetattr(pty.master)[4:6] == [code, code]
        assert port.read() == b"", "no data must not look like an end of file"
    port.close()


@pytest.mark.parametrize("how", ["pass", "fcntl.flock(fd, fcntl.LOCK_EX)", "fcntl.ioctl(fd, termios.TIOCEXCL)"])
def test_a_busy_port_names_the_process_that_has_it(pty, how):
    other = holding(pty.path, how)
    with pytest.raises(PortBusyError) as refusal:
        pty.open()
    assert f"process {other.pid}" in str(refusal.value)
    assert "termios" in str(refusal.value), "the command line helps to find it"
    end(other)
    if "TIOCEXCL" not in how:  # which stays on a pseudo-terminal as long as its emulator lives
        pty.open().close()


def test_a_port_of_this_process_is_busy_too(pty):
    port = pty.open()
    with pytest.raises(PortBusyError):
        pty.open()
    port.close()
    pty.open().close()


def test_the_emulator_behind_a_pseudo_terminal_does_not_count_as_a_holder():
    code = "import os; m, s = os.openpty(); print(os.ttyname(s), flush=True); input()"
    emulator = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    port = SerialPort(PortSpec(emulator.stdout.readline().strip()))
    end(emulator)
    wait_readable(port.fd)
    with pytest.raises(PortLostError):
        port.read()
    port.close()


def test_a_port_that_is_not_there_is_absent(tmp_path):
    for path in (tmp_path / "ttyUSB7", tmp_path / "none" / "x"):
        with pytest.raises(PortAbsentError, match="there is no"):
            SerialPort(PortSpec(str(path)))
    dangling = tmp_path / "link"
    dangling.symlink_to(tmp_path / "gone")
    with pytest.raises(PortAbsentError):
        SerialPort(PortSpec(str(dangling)))


def test_not_a_serial_line(tmp_path):
    file = tmp_path / "file"
    file.write_text("x")
    os.mkfifo(tmp_path / "pipe")
    for path in (file, tmp_path, tmp_path / "pipe", Path("/dev/null")):
        with pytest.raises(NotSerialError, match="not a serial device"):
            SerialPort(PortSpec(str(path)))


@contextlib.contextmanager
def without_privileges():
    """Nobody's rights, if the tests run as root."""
    groups = os.getgroups()
    if os.geteuid() != 0:
        yield
        return
    os.setgroups([])
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setgroups(groups)


def test_without_permission_the_group_to_join_is_named(pty):
    if os.geteuid() == 0:
        os.chown(pty.path, 0, 20)  # dialout on Debian
    Path(pty.path).chmod(0o060)
    with without_privileges(), pytest.raises(PortDeniedError) as refusal:
        pty.open()
    assert pty.path in str(refusal.value)
    assert "join group" in str(refusal.value)
    assert "usermod -aG" in str(refusal.value)


def test_every_use_of_an_unplugged_port_says_that_it_went_away(pty):
    port = pty.open()
    pty.unplug()
    wait_readable(port.fd)
    for use in (port.read, port.discard, lambda: port.set_baud(9600), lambda: port.write(b"x")):
        with pytest.raises(PortLostError, match="went away"):
            use()
    port.close()


def test_a_closed_descriptor_is_unplugged_too(pty):
    port = pty.open()
    os.close(port.fd)
    with pytest.raises(PortLostError, match=os.strerror(errno.EBADF)):
        port.read()


def asks(question, seconds=5.0):
    return (yield Exchange(question, seconds, enough=lambda heard: len(heard) >= 4))


def test_a_dialogue_runs_blocking(pty):
    port = pty.open()

    def device():
        question = os.read(pty.master, 100)
        os.write(pty.master, question[:2])
        os.write(pty.master, question[2:] + b"!")

    thread = threading.Thread(target=device)
    thread.start()
    assert run_dialogue(port, asks(b"abc")) == b"abc!"
    thread.join()
    assert run_dialogue(port, asks(b"abc", 0.05)) == b""
    pty.unplug()
    with pytest.raises(PortLostError):
        run_dialogue(port, asks(b"abc"))
    port.close()


class Line:
    """A port in memory that notes what is done to it."""

    fd = 7

    def __init__(self, *replies):
        self.replies, self.done = list(replies), []

    def set_baud(self, baud):
        self.done.append(baud)

    def discard(self):
        self.done.append("discard")

    def write(self, data):
        self.done.append(data)

    def read(self):
        return self.replies.pop(0)


def test_a_conversation_steps_through_its_exchanges():
    heard = []

    def dialogue():
        heard.append((yield Exchange(b"one", baud=9600, discard=True)))
        heard.append((yield Exchange(b"two", 2.0, enough=lambda data: data.endswith(b"."))))
        heard.append((yield Exchange(listen_s=3.0)))
        return "found"

    time_s = [10.0]
    line = Line(b"a", b"b.", b"late")
    conversation = DialogueRunner(line, dialogue(), lambda: time_s[0])
    conversation.start()
    assert line.done == [9600, "discard", b"one", b"two"]
    assert (heard, conversation.deadline_s, conversation.finished) == ([b""], 12.0, False)
    conversation.on_readable()
    time_s[0] = 11.0
    conversation.on_readable()
    assert (heard, conversation.deadline_s) == ([b"", b"ab."], 14.0)
    conversation.on_readable()
    conversation.on_deadline()
    assert heard == [b"", b"ab.", b"late"]
    assert conversation.finished
    assert conversation.result == "found"


def test_a_flood_is_judged_seldom_and_kept_in_part():
    judged = []

    def dialogue():
        return (yield Exchange(listen_s=2.0, enough=lambda data: judged.append(len(data))))

    conversation = DialogueRunner(Line(*[bytes(1000)] * 300), dialogue(), lambda: 0.0)
    conversation.start()
    for _ in range(300):
        conversation.on_readable()
    conversation.on_deadline()
    assert judged[:4] == [1000, 2000, 3000, 4000]
    assert len(judged) < 50
    assert len(conversation.result) == LONGEST


BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1.0-port0"


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("/dev/ttyUSB0", PortSpec("/dev/ttyUSB0")),
        ("/dev/ttyUSB0:epson", PortSpec("/dev/ttyUSB0", "epson")),
        ("/dev/ttyUSB0:epson@230400", PortSpec("/dev/ttyUSB0", "epson", 230400)),
        ("/dev/ttyUSB0:@9600", PortSpec("/dev/ttyUSB0", None, 9600)),
        (BY_PATH, PortSpec(BY_PATH)),
        (BY_PATH + ":nmea@4800", PortSpec(BY_PATH, "nmea", 4800)),
        ("/dev/serial/by-id/usb-FTDI_UART@home-if00", PortSpec("/dev/serial/by-id/usb-FTDI_UART@home-if00")),
        ("spi:0.0:epson", PortSpec("spi:0.0", "epson")),
        ("replay:run", PortSpec("replay:run")),
        ("sim:car:nmea", PortSpec("sim:car", "nmea")),
    ],
)
def test_port_specifications(text, spec):
    assert PortSpec.parse(text) == spec
    assert PortSpec.parse(str(spec)) == spec


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no device"),
        (":epson", "no device"),
        ("spi:", "no device"),
        ("/dev/ttyUSB0:epsn", "no driver 'epsn'; there are: epson, nmea"),
        ("/dev/ttyUSB0:epsn@9600", "no driver"),
        ("/dev/ttyUSB0:epson@fast", "'fast' is no baud rate"),
        ("/dev/ttyUSB0:epson@", "'' is no baud rate"),
        ("/dev/ttyUSB0:nmea@0", "'0' is no baud rate"),
        ("/dev/ttyUSB0@9600", "write /dev/ttyUSB0:@9600"),
        ("/dev/ttyUSB0:9600", "write /dev/ttyUSB0:@9600"),
        ("/dev/ttyUSB0:epson:460800", "write /dev/ttyUSB0:epson@460800"),
        (BY_PATH + "@9600", f"write {BY_PATH}:@9600"),
        ("ttyUSB0", "write /dev/ttyUSB0"),
        ("tcp://localhost:2000", "write gpsd://HOST"),
    ],
)
def test_bad_port_specifications(text, complaint):
    with pytest.raises(SpecError, match=complaint):
        PortSpec.parse(text, ("epson", "nmea"))


def test_a_path_that_exists_is_a_path_whatever_it_looks_like(tmp_path):
    odd = tmp_path / "usb-foo:bar"
    odd.touch()
    assert PortSpec.parse(str(odd)) == PortSpec(str(odd))
