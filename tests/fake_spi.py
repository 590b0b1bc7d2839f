"""Scripted stand-ins for spidev and gpiod: a device that answers, a line whose edges the test makes."""

import os
import sys
import types
from collections import deque
from contextlib import contextmanager


class SpiDev:
    """A device that answers from a script, and remembers how it was asked."""

    script: deque[bytes]
    trouble: Exception | None = None

    def __init__(self):
        self.asked, self.closed = [], 0

    def open(self, bus, device):
        if self.trouble:
            raise self.trouble
        SpiDev.last = self
        self.opened = bus, device

    def xfer2(self, values, speed_hz=0, delay_usecs=0, bits_per_word=0):
        if SpiDev.trouble:
            raise SpiDev.trouble
        self.asked.append((bytes(values), speed_hz, delay_usecs))
        answer = SpiDev.script.popleft()
        if callable(answer):
            answer = answer()
        values[:] = answer
        return values

    def close(self):
        self.closed += 1


class Gpio:
    """The module gpiod, with one line whose edges the test makes."""

    def __init__(self):
        self.fd, self.edges, self.number, self.trouble = os.eventfd(0, os.EFD_NONBLOCK), [], 0, None
        self.requested = self.released = None

    def edge(self, at_ns):
        self.number += 1
        self.edges.append(types.SimpleNamespace(timestamp_ns=at_ns, line_seqno=self.number))
        os.eventfd_write(self.fd, 1)
        return b"\0\0"

    def request_lines(self, path, config, consumer=None, event_buffer_size=None):
        if self.trouble:
            raise self.trouble
        self.requested = path, config
        return self

    def read_edge_events(self):
        os.eventfd_read(self.fd)
        edges, self.edges = self.edges, []
        return edges

    def release(self):
        self.released = True


@contextmanager
def stand_ins(monkeypatch):
    """Put them in the place of the packages; gives the Gpio."""
    SpiDev.script, SpiDev.trouble = deque(), None
    gpio = Gpio()
    gpiod = types.ModuleType("gpiod")
    gpiod.LineSettings = lambda **settings: settings
    gpiod.request_lines = gpio.request_lines
    line = types.ModuleType("gpiod.line")
    for name, value in (("Clock", "MONOTONIC"), ("Direction", "INPUT"), ("Edge", "RISING")):
        setattr(line, name, types.SimpleNamespace(**{value: value.lower()}))
    monkeypatch.setitem(sys.modules, "spidev", types.SimpleNamespace(SpiDev=SpiDev))
    monkeypatch.setitem(sys.modules, "gpiod", gpiod)
    monkeypatch.setitem(sys.modules, "gpiod.line", line)
    yield gpio
    os.close(gpio.fd)
