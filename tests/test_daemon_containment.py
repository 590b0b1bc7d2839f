"""The daemon's devices: a defect in a driver ends the connection on that port only, which is tried again."""

import contextlib

from imud.configuration.settings import Settings
from imud.daemon.devices import Devices
from imud.daemon.fast_loop import FastLoop
from imud.process.contained import ContainedErrors
from imud.recording.control import Recordings


def broken(*_):
    raise IndexError("list index out of range")


def test_a_defect_on_one_port_does_not_affect_the_other(tmp_path):
    settings = Settings(ports=(str(tmp_path / "a"), str(tmp_path / "b")))
    errors = ContainedErrors()
    with contextlib.closing(FastLoop()) as fast_loop, Recordings(settings) as recordings:
        devices = Devices(settings, True, fast_loop, recordings, errors)
        bad, good = devices.ports
        bad.on_time = broken
        devices.on_time(1e9)
        assert errors.count == 1 and bad.spec.path in errors.last
        assert bad.description == "internal error; trying again" and bad.deadline_s < float("inf")
        assert good.description.endswith("trying again") and good.description != bad.description
        devices._descriptors._ports[77] = bad
        bad.on_event = broken
        assert devices.on_event(77, 0) == (0, [])
        assert errors.count == 2
