"""The pseudo-terminal of an emulated device: bytes are lost if the host is late, not if the kernel is."""

import os

import pytest

from imud.firmware_sim import pty

DATA = bytes(range(256)) * 4


@pytest.fixture
def port():
    with pty.Pty(None, 460800) as opened:
        yield opened


def test_bytes_are_lost_when_the_host_does_not_read(port):
    for _ in range(64):
        port.write(DATA)
    assert port.lost > 0 and not port.waiting


def test_bytes_wait_while_the_kernel_has_not_passed_on_those_before_them(port, monkeypatch):
    def write_without_room(*_):
        raise BlockingIOError

    with monkeypatch.context() as kernel:
        kernel.setattr(pty.os, "write", write_without_room)
        port.write(DATA)
        port.flush()
    assert port.waiting == DATA and port.lost == 0
    port.flush()
    host = os.open(port.path, os.O_RDONLY | os.O_NOCTTY)
    received = b""
    while len(received) < len(DATA):
        received += os.read(host, 4096)
    os.close(host)
    assert received == DATA and not port.waiting and port.lost == 0
