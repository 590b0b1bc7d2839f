"""The example programs of `docs/wheels`: ticks of a GPIO line and frames of a CAN bus become speeds for the daemon."""

import contextlib
import importlib.util
import itertools
import json
import os
import socket
import struct
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from imud.client import AidingSender
from imud.estimators.odometer_source import SOURCE

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "wheels"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look it up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("speed", [0.3, 2.0, 30.0])
def test_ticks_at_a_constant_speed_give_it_in_the_middle_of_their_time(speed):
    metres = 0.02
    ticks = 1700000000.0 + np.arange(2000) * metres / speed
    found = list(example("gpio_ticks").speeds(ticks, metres))
    assert len(found) >= 5
    assert [v for _, v in found] == pytest.approx([speed] * len(found), rel=1e-3)
    assert np.all(np.diff([t for t, _ in found]) >= 0.09)


def test_ticks_of_an_acceleration_have_the_speed_of_their_epoch():
    t = np.arange(0.0, 10.0, 1e-4)
    way = 0.5 * t**2  # 1 m/s^2
    ticks = np.interp(np.arange(0.0, way[-1], 0.02), way, t)
    found = np.array(list(example("gpio_ticks").speeds(ticks, 0.02)))
    assert np.abs(found[:, 1] - found[:, 0]).max() < 0.02


def test_without_ticks_it_stands_and_then_the_first_tick_has_no_speed():
    ticks = [100.0, 100.125, 100.25, *[None] * 7, 101.0, 101.125]
    found = list(example("gpio_ticks").speeds(ticks, 0.125))
    assert found[:2] == [(100.0625, 1.0), (100.1875, 1.0)]
    assert [v for _, v in found[2:5]] == [0.0] * 3 and found[2][0] == pytest.approx(100.75)
    assert found[5:] == [(101.0625, 1.0)]


def frame(identifier, data):
    return struct.pack("=IB3x8s", identifier, len(data), data)


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        (frame(0x4B0, struct.pack(">HH", 3600, 7200)), (10.0, 20.0)),
        (frame(0x4B0, struct.pack(">HHHH", 36, 0, 5, 5)), (0.1, 0.0)),
        (frame(0x4B1, struct.pack(">HH", 3600, 7200)), None),
        (frame(0x4B0 | 0x40000000, b""), None),
        (frame(0x4B0 | 0x20000000, bytes(8)), None),
        (frame(0x4B0, b"\1\2\3"), None),
        (frame(0x4B0, struct.pack(">HH", 0xFFFF, 7200)), None),
        (b"short", None),
    ],
)
def test_frames_are_speeds_or_nothing(sent, expected):
    found = example("can_speeds").SIGNAL.decode(sent)
    assert found == (expected and pytest.approx(expected))


def can_bus():
    """(sending end, receiving end): of a virtual bus where the kernel has one and lets us, else of a socket pair."""
    name = f"imud{os.getpid() % 10000}"
    with contextlib.suppress(OSError, AttributeError):
        made = subprocess.run(["ip", "link", "add", name, "type", "vcan"], capture_output=True, check=False)
        if made.returncode == 0:
            subprocess.run(["ip", "link", "set", name, "up"], check=True)
            ends = [socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) for _ in range(2)]
            for end in ends:
                end.bind((name,))
            return *ends, lambda: subprocess.run(["ip", "link", "del", name], check=True)
    return *socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET), lambda: None


def test_frames_of_a_bus_become_datagrams_that_the_daemon_takes(tmp_path):
    module, address = example("can_speeds"), tmp_path / "aiding"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as daemon:
        daemon.bind(str(address))
        daemon.settimeout(10.0)
        sending, receiving, remove = can_bus()

        def run():
            with contextlib.suppress(OSError), AidingSender(address) as sender:
                module.forward(receiving, sender, module.SIGNAL)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            for left, right in itertools.pairwise((3600, 3700, 3800)):
                sending.send(frame(0x123, b"\0\0\0\0"))
                sending.send(frame(0x4B0, struct.pack(">HH", left, right)))
                message = json.loads(daemon.recv(4096))
                assert message["class"] == SOURCE.message and set(message) == {"class", "left", "right", "t"}
                assert (message["left"], message["right"]) == pytest.approx((left / 360.0, right / 360.0))
        finally:
            remove()
            sending.close()
            thread.join(2.0)
            receiving.close()
