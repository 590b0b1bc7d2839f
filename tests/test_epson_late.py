"""Sensors that answer late, as stand-ins and lines through a network do: found, for what they are, and set up."""

import pytest
from scripted import G350, Windowed, run

from imud.drivers.detect import detect
from imud.drivers.driver import Identity, Options
from imud.drivers.epson.driver import DRIVER

ANSWER_BYTES = 4


class Late:
    """Each answer comes `late_s` after its question; frames come in time."""

    def __init__(self, late_s):
        super().__init__()
        self.late_s, self.answers = late_s, []

    def say(self, data):
        if len(data) == ANSWER_BYTES:
            self.answers.append((self.now_s + self.late_s, data))
        else:
            super().say(data)

    def pass_time(self, seconds):
        super().pass_time(seconds)
        while self.answers and self.answers[0][0] <= self.now_s:
            super().say(self.answers.pop(0)[1])


class Slow:
    """Takes `late_s` for each command, in sequence."""

    def __init__(self, late_s):
        super().__init__()
        self.late_s, self.free_s, self.commands = late_s, 0.0, []

    def obey(self, address, value):
        self.free_s = max(self.free_s, self.now_s) + self.late_s
        self.commands.append((self.free_s, address, value))

    def pass_time(self, seconds):
        super().pass_time(seconds)
        while self.commands and self.commands[0][0] <= self.now_s:
            super().obey(*self.commands.pop(0)[1:])


class LateFlat(Late, G350):
    model = "M-G350"


class LateWindowed(Late, Windowed):
    model = "M-G364PDCA"


class SlowWindowed(Slow, Windowed):
    model = "M-G364PDCA"


KINDS = (LateFlat, LateWindowed, SlowWindowed)


@pytest.mark.parametrize("streaming", [False, True])
@pytest.mark.parametrize("late_s", [0.03, 0.07, 0.09, 0.12, 0.2, 0.3, 0.5])
@pytest.mark.parametrize("kind", KINDS)
def test_a_late_sensor_is_found_and_never_taken_for_another(kind, late_s, streaming):
    device = kind(late_s if kind is not SlowWindowed else late_s / 3)
    if streaming:
        device.start()
    device.host_baud = device.baud
    found, _ = run(DRIVER.identify(), device)
    assert found is not None
    assert (found.model, len(found.serial)) == (device.model, 8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_late_sensor_is_set_up(kind):
    device = kind(0.15)
    device.host_baud = device.baud
    identity = Identity("epson", "", baud=device.baud)
    configured, _ = run(DRIVER.configure(identity, Options(rate_hz=500.0)), device)
    assert (configured.identity.model, configured.rate_hz, configured.warnings) == (device.model, 500.0, ())
    assert device.sampling


@pytest.mark.parametrize("base", [LateFlat, LateWindowed])
def test_a_serial_number_whose_answers_alone_are_late_is_read(base):
    class LateSerial(base):
        def say(self, data):
            self.late_s = 0.15 if data[0] >= 0x74 else 0.0
            super().say(data)

    device = LateSerial(0.0)
    device.host_baud = device.baud
    found, _ = run(DRIVER.identify(), device)
    assert (found.model, len(found.serial)) == (device.model, 8)


@pytest.mark.thorough
@pytest.mark.parametrize("baud", [230400, 115200, 19200])
@pytest.mark.parametrize("late_s", [0.12, 0.3])
@pytest.mark.parametrize("kind", [LateFlat, LateWindowed])
def test_a_late_sensor_is_found_at_any_speed(kind, late_s, baud):
    device = kind(late_s)
    device.baud = baud
    found, seconds = run(detect(), device)
    assert (found.model, found.baud) == (device.model, baud)
    assert seconds < 25.0
