"""The daemon's devices: a defect in a driver ends the connection on that port only, which is tried again."""

import contextlib
from types import SimpleNamespace

from imud.configuration.settings import Settings
from imud.daemon.devices import Devices
from imud.daemon.fast_loop import FastLoop
from imud.daemon.loop import Daemon
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


class BrokenAiding(dict):
    """Holds its descriptors."""

    measurements = broken


def test_a_defect_at_one_fix_or_measurement_ends_that_one():
    """Also of a fix whose epoch silence has ended."""
    daemon = Daemon(Settings(ports=("/dev/imu",)))
    with contextlib.closing(daemon._fast_loop):
        daemon._publisher = SimpleNamespace(**dict.fromkeys(("on_fixes", "known_sources", "tick"), broken))
        daemon._devices._descriptors._ports[77] = daemon._devices.ports[0]
        daemon._wakeup, daemon._aiding = -1, BrokenAiding({78: None})
        daemon._dispatch(77, 0, 0)
        daemon._dispatch(78, 0, 0)
        daemon._use_ended_epoch(0)
        assert daemon._errors.count == 3, daemon._errors.last
        assert daemon._errors.last.startswith("the use of a fix")
