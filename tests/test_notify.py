"""sd_notify: what a service manager would receive."""

import os
import socket

import pytest

from imud.process.notify import Notifier


@pytest.fixture
def manager(tmp_path, monkeypatch):
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(path)
        listener.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", path)
        yield listener


def received(manager):
    said = []
    try:
        while True:
            said.append(manager.recv(4096).decode())
    except BlockingIOError:
        return said


def test_several_assignments_are_one_datagram(manager):
    Notifier().send("READY=1", "STATUS=waiting")
    assert received(manager) == ["READY=1\nSTATUS=waiting"]


def test_the_watchdog_is_fed_three_times_per_period_and_only_when_asked_for(manager, monkeypatch):
    Notifier().alive(10**9)
    monkeypatch.setenv("WATCHDOG_USEC", "3000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    notifier = Notifier()
    for ms in range(0, 6000, 20):
        notifier.alive(10**12 + ms * 1_000_000)
    assert received(manager) == ["WATCHDOG=1"] * 6
    monkeypatch.setenv("WATCHDOG_PID", "1")
    Notifier().alive(10**9)
    assert received(manager) == []


def test_it_is_known_when_the_watchdog_is_due(manager, monkeypatch):
    assert Notifier().due_ns > 10**18  # there is none
    monkeypatch.setenv("WATCHDOG_USEC", "3000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    notifier = Notifier()
    assert notifier.due_ns <= 10**12
    notifier.alive(10**12)
    assert notifier.due_ns == 10**12 + 1_000_000_000


def test_a_manager_that_has_begun_anew_is_found(tmp_path, monkeypatch):
    """Or its watchdog would end the service."""
    path = tmp_path / "notify"
    monkeypatch.setenv("NOTIFY_SOCKET", str(path))
    notifier = Notifier()
    for _ in range(2):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
            listener.bind(str(path))
            listener.setblocking(False)
            notifier.send("WATCHDOG=1")
            assert received(listener) == ["WATCHDOG=1"]
        path.unlink()
        notifier.send("WATCHDOG=1")  # to nobody


def test_status_is_sent_when_it_changes(manager):
    notifier = Notifier()
    for text in ("waiting", "waiting", "streaming"):
        notifier.status(text)
    assert received(manager) == ["STATUS=waiting", "STATUS=streaming"]


def test_without_a_manager_nothing_happens(monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    Notifier().send("READY=1")
    monkeypatch.setenv("NOTIFY_SOCKET", "/nonexistent/socket")
    Notifier().send("READY=1")
