"""The pseudo-terminal of an emulated device: bytes are lost if the host is late, not if the kernel is."""

import os
import time

import pytest

from imud.firmware_sim import pty

DATA = bytes(range(256)) * 4
ENOUGH_S = 60.0  # for the kernel's worker


@pytest.fixture
def port():
    with pty.Pty(None, 460800) as opened:
        yield opened


def test_of_what_the_host_does_not_read_an_adapter_keeps_little(port):
    end_s = time.monotonic() + ENOUGH_S
    while not port.lost and time.monotonic() < end_s:
        port.write(DATA)
    assert port.lost and not port.waits_for_kernel
    waiting = len(port.waiting)
    port.write(DATA)
    assert len(port.waiting) <= waiting + 512 and port.lost >= 1024 - 512


@pytest.mark.parametrize("lost_by", ["nobody", "the host"])
def test_bytes_wait_while_the_kernel_has_not_passed_on_those_before_them(port, monkeypatch, lost_by):
    def write_without_room(*_):
        raise BlockingIOError

    with monkeypatch.context() as kernel:
        kernel.setattr(pty.os, "write", write_without_room)
        kernel.setattr(port, "_unread", lambda: 0)
        for _ in range(64):
            port.write(DATA)
        assert port.waiting == 64 * DATA and port.lost == 0 and port.waits_for_kernel
        if lost_by == "the host":
            kernel.setattr(port, "_unread", lambda: 4095)
            port.write(DATA)
            assert port.waiting == 64 * DATA + DATA[:512] and port.lost == 512


def test_what_waited_arrives_whole_and_in_order(port, monkeypatch):
    port.waiting = DATA
    port.write(DATA[::-1])
    host = os.open(port.path, os.O_RDONLY | os.O_NOCTTY)
    received = b""
    while len(received) < 2 * len(DATA):
        received += os.read(host, 4096)
    os.close(host)
    assert received == DATA + DATA[::-1] and not port.waiting and port.lost == 0
