"""Emulated devices on a wire in memory: `scripted.run` talks to them in simulated time, without waiting."""

import math

import numpy as np
from scripted import Line

from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.g350 import G350
from imud.firmware_sim.g370 import VARIANTS, Windowed
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.nmea import FvM11
from imud.firmware_sim.noise import IDEAL, ImuErrors
from imud.firmware_sim.rga300 import Rga300
from imud.firmware_sim.scenarios import SCENARIOS
from imud.firmware_sim.seraccel import SerAccel, Settings

ROLL, PITCH = math.radians(10.0), math.radians(-5.0)
REST = Trajectory(SCENARIOS["rest"](ROLL, PITCH, 0.0), 35.0, 139.0, 60.0)
UTC = 1.8e9


class Emulated(Line):
    """An emulated device and the wire to it. Its time is exact, its speed is what the device has at the moment."""

    def __init__(self, unit, now_s=0.0):
        super().__init__(unit.uart.baud)
        self.unit, self.now_s = unit, now_s

    def receive_from(self, data):
        self.written += data
        if data:
            self.unit.receive(self.unit.uart.receive_from(data, self.host_baud), self.now_s)

    def pass_time(self, seconds):
        super().pass_time(seconds)
        self.unit.advance(self.now_s)
        self.outgoing += self.unit.uart.take(self.now_s, self.host_baud)

    def stream(self, seconds, request=None, step_s=1e-4):
        """What comes in that time; with each `request` sent when it is due."""
        heard, begin, asked = bytearray(), self.now_s, 0
        while (passed := self.now_s - begin) < seconds:
            if request and passed >= asked * request.period_ns * 1e-9:
                self.receive_from(request.command)
                asked += 1
            self.pass_time(step_s)
            heard += self.outgoing
            self.outgoing.clear()
        return bytes(heard)


def device(name, baud, **options):
    """A faultless one at rest, switched on at time 0."""
    errors = ImuErrors(IDEAL, np.random.default_rng(1), 2000.0)
    if name == "g350":
        return Emulated(G350(REST, errors, baud, **options))
    if name == "rga300":
        return Emulated(Rga300(REST, errors, baud, **options))
    if name == "seraccel":
        return Emulated(SerAccel(REST, errors, baud, Settings(mode="gravity", rate_hz=20.0), **options))
    if name == "nmea":
        source = SimulatedFixes(REST, np.random.default_rng(1), UTC, True)
        return Emulated(FvM11(source, UTC, baud=baud, **{"no_fix_s": 0.0, **options}))
    return Emulated(Windowed(VARIANTS[name], REST, errors, baud, **options))


class TouchedError(AssertionError):
    """Something was written to a device that must be left alone."""


class Untouchable(Emulated):
    """Fails on any byte received."""

    def receive_from(self, data):
        if data:
            raise TouchedError(data)


def streaming(name, baud, **registers):
    """A device left streaming by another host, to which nothing may be written. registers: words for `Windowed`."""
    wire = device(name, baud)
    unit = wire.unit
    wire.host_baud = baud
    wire.pass_time(1.0)
    for command in COMMANDS[name](**registers):
        unit.receive(command, wire.now_s)
        wire.pass_time(0.01)
    wire.outgoing.clear()
    return Untouchable(unit, wire.now_s)


def _windowed(fields=0xF007, wide=0x00, rate=4):
    words = (0x8C, fields & 0xFF), (0x8D, fields >> 8), (0x8F, wide), (0x85, rate), (0x86, 4), (0x88, 1)
    settings = [bytes((address, value, 0x0D)) for address, value in words]
    return [b"\xfe\x01\r", *settings, b"\xfe\x00\r", b"\x83\x01\r"]


COMMANDS = {
    "g350": lambda: [b"\xb7\x04\r", b"\xb8\x04\r", b"\xba\x01\r", b"\xb9\x01\r"],
    "rga300": lambda: [b"C"],
    "seraccel": lambda: [b"x"],
    "nmea": lambda: [],
} | dict.fromkeys(("g364", "g365", "g370"), _windowed)
