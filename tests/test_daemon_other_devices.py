"""Other devices behind the same names: what a port was for a device before is not what it is for the next one."""

import contextlib
import math
import os
import time

import pytest

from imud.configuration.settings import Settings
from imud.daemon import ports
from imud.daemon.devices import Devices
from imud.daemon.fast_loop import FastLoop
from imud.daemon.port_states import PortState
from imud.drivers.dialogue import Exchange
from imud.drivers.driver import GnssConfigured, Identity, ImuConfigured
from imud.drivers.errors import PortAbsentError
from imud.drivers.registry import by_name
from imud.errors import UsageError
from imud.process.contained import ContainedErrors
from imud.recording.control import Recordings

RECEIVER = GnssConfigured(Identity("nmea", "NMEA receiver"))
SENSOR = ImuConfigured(Identity("epson", "M-G350", "S1"), 1000.0, 1_000_000, 0, 0)
UNSUITABLE = ImuConfigured(Identity("epson", "gyroless"), 1000.0, 1_000_000, 0, 0, gyro_axes=(False, False, False))
DEVICES = {device.identity: device for device in (RECEIVER, SENSOR, UNSUITABLE)}
ONE, OTHER = "/dev/ttyUSB0", "/dev/ttyUSB1"


class Line:
    """An open line that never has bytes."""

    plain, warning, counters = False, "", {}

    def __init__(self):
        self.fd = os.eventfd(0)

    def close(self):
        os.close(self.fd)


class Driver:
    """A driver whose devices are set up as they are."""

    def __init__(self, name):
        self._driver = by_name(name)

    def __getattr__(self, name):
        return getattr(self._driver, name)

    def configure(self, identity, options):
        return found(DEVICES[identity])


def found(what):
    """A dialogue that listens, and has then found it."""
    yield Exchange(listen_s=60.0)
    return what


class Machine:
    """A daemon's devices, and what is behind each name: `plugged`, by path."""

    def __init__(self, devices, plugged):
        self.devices, self.plugged = devices, plugged
        self.ports = {port.spec.path: port for port in devices.ports}

    def pass_time(self):
        """Have all happen that happens by itself."""
        for _ in range(12):
            due_s = [port.deadline_s for port in self.devices.ports if port.deadline_s < math.inf]
            self.devices.on_time(max(due_s, default=0.0))
            self.devices.tick(0, time.monotonic_ns())

    def unplug(self, path):
        """What streams there goes away."""
        del self.plugged[path]
        self.ports[path].lost("unplugged")


@pytest.fixture
def machine(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    plugged = {}

    def open_line(spec):
        if spec.path not in plugged:
            raise PortAbsentError(spec.path, "absent")
        return Line()

    monkeypatch.setattr(ports, "open_line", open_line)
    monkeypatch.setattr(ports, "check_port", lambda spec: open_line(spec).close())
    monkeypatch.setattr(ports, "search", lambda spec, *_: found(plugged[spec.path].identity))
    monkeypatch.setattr(ports, "by_name", Driver)
    settings = Settings(ports=(ONE, OTHER), estimator="navigation")
    with contextlib.closing(FastLoop()) as fast_loop, Recordings(settings) as recordings:
        devices = Devices(settings, True, fast_loop, recordings, ContainedErrors())
        yield Machine(devices, plugged)
        devices.close()


def test_a_port_of_a_spare_receiver_that_has_got_a_sensor_is_tried_again_when_that_went_away(machine):
    """A receiver that streams keeps spare receivers closed; this one is none any more."""
    machine.plugged |= {ONE: RECEIVER, OTHER: RECEIVER}
    machine.pass_time()
    assert machine.ports[ONE].state is PortState.STREAMING and machine.ports[OTHER].state is PortState.RELEASED
    machine.unplug(ONE)
    machine.plugged[OTHER] = SENSOR
    machine.pass_time()
    assert machine.devices.in_use.imu and machine.devices.in_use.imu.port is machine.ports[OTHER]
    machine.unplug(OTHER)
    machine.plugged[ONE] = RECEIVER
    machine.pass_time()
    assert machine.devices.in_use.gnss and machine.devices.in_use.gnss.port is machine.ports[ONE]
    machine.plugged[OTHER] = SENSOR
    machine.pass_time()
    assert machine.devices.in_use.imu and machine.devices.in_use.imu.port is machine.ports[OTHER]


def test_a_port_from_which_a_spare_receiver_has_gone_is_tried_on(machine):
    """Nobody knows what is plugged in there next."""
    machine.plugged |= {ONE: RECEIVER, OTHER: RECEIVER}
    machine.pass_time()
    machine.unplug(ONE)
    del machine.plugged[OTHER]
    machine.pass_time()
    assert machine.ports[OTHER].state is PortState.WAITING
    machine.plugged[ONE] = RECEIVER
    machine.pass_time()
    machine.plugged[OTHER] = SENSOR
    machine.pass_time()
    assert machine.devices.in_use.imu and machine.devices.in_use.imu.port is machine.ports[OTHER]


def test_a_sensor_plugged_in_where_a_spare_receiver_was_is_found(machine):
    """Also while the first receiver streams: the spare may have been plugged in there by mistake."""
    machine.plugged |= {ONE: RECEIVER, OTHER: RECEIVER}
    machine.pass_time()
    assert machine.ports[OTHER].state is PortState.RELEASED
    del machine.plugged[OTHER]
    machine.pass_time()
    machine.plugged[OTHER] = SENSOR
    machine.pass_time()
    assert machine.devices.in_use.imu and machine.devices.in_use.imu.port is machine.ports[OTHER]
    assert machine.devices.in_use.gnss and machine.devices.in_use.gnss.port is machine.ports[ONE]


def test_a_sensor_that_will_not_do_ends_the_start(machine):
    machine.plugged[ONE] = UNSUITABLE
    with pytest.raises(UsageError, match="needs all gyros"):
        machine.pass_time()


def test_one_that_is_plugged_in_later_ends_nothing_also_if_it_is_the_first_sensor(machine):
    """A receiver's positions are passed on meanwhile."""
    machine.plugged[OTHER] = RECEIVER
    machine.pass_time()
    machine.plugged[ONE] = UNSUITABLE
    machine.pass_time()
    assert machine.devices.in_use.gnss and "needs all gyros" in machine.ports[ONE].description
    machine.plugged[ONE] = SENSOR
    machine.pass_time()
    assert machine.devices.in_use.imu


def test_a_sensor_whose_time_has_run_ahead_of_the_clock_is_set_up_anew(machine):
    """As after a flood of frames that was too short for another rate to be noticed."""
    machine.plugged[ONE] = SENSOR
    machine.pass_time()
    port, sensor = machine.devices.in_use.imu
    pipeline = sensor.pipeline
    for ahead_ns, is_anew in ((0, False), (900_000_000, False), (2_000_000_000, True)):
        pipeline.record["newest"] = 0
        pipeline.solutions["t_ns"][0] = time.monotonic_ns() + ahead_ns
        machine.devices.tick(0, time.monotonic_ns())
        assert ("ahead of the clock" in port.description) == is_anew
    machine.pass_time()
    assert machine.devices.in_use.imu and machine.devices.in_use.imu.sensor.pipeline is not pipeline
