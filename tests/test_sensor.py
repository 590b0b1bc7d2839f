"""`imud sensor` against emulated devices: what it asks, what it refuses, and that what it did is so."""

import io
import math
import sys

import pytest
from processes import emulator

from imud.commands import main
from imud.drivers.crossbow.services import gyro_at_rest
from imud.drivers.transport.line import open_line
from imud.drivers.transport.portspec import PortSpec
from imud.firmware_sim.rga300 import Reading


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """The port of a DMU whose gyro is off by 0.8 deg/s; tests run in the order of the file."""
    link = tmp_path_factory.mktemp("dmu") / "port"
    with emulator("rga300", "--scenario", "rest", "--gyro-bias-dps", "0,0,0.8", links=[link]):
        yield str(link)


def sensor(capsys, *arguments):
    code = main(["sensor", *arguments])
    return code, *capsys.readouterr()


def test_nothing_is_done_unasked(unit, capsys, monkeypatch):
    code, out, err = sensor(capsys, unit, "zero")
    assert (code, out) == (64, "")
    assert "averages its gyro for 60 s" in err
    assert "--yes" in err
    terminal = io.StringIO("no\n")
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stdin", terminal)
    code, out, err = sensor(capsys, unit, "zero", "2")
    assert (code, out) == (1, "")
    assert "go on?" in err
    assert "nothing was done" in err


def test_the_gyro_reads_zero_afterwards(unit, capsys):
    code, out, _ = sensor(capsys, unit, "zero", "3", "--yes")
    assert code == 0
    before, after = float(out.split()[-1]), float(out.split("reads ")[1].split()[0])
    assert before == pytest.approx(0.8, abs=0.3)
    assert abs(after) < 0.3


def test_the_new_speed_is_the_one_that_answers(unit, capsys):
    code, out, _ = sensor(capsys, unit, "baud", "57600", "--yes")
    assert (code, "serial 30042" in out, "crossbow@57600" in out) == (0, True, True)
    code, _, err = sensor(capsys, f"{unit}:crossbow@38400", "baud", "9600", "--yes")
    assert (code, "silent at 38400 baud" in err) == (69, True)
    assert sensor(capsys, f"{unit}:crossbow@57600", "baud", "38400", "--yes")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("zero", "-1"), "1 to 89 s"),
        (("baud", "115200"), "9600, 19200, 38400, 57600 baud"),
    ],
)
def test_values_that_it_cannot_have(unit, capsys, arguments, says):
    code, out, err = sensor(capsys, unit, *arguments, "--yes")
    assert (code, out, says in err) == (64, "", True)


def test_a_port_that_a_daemon_holds(unit, capsys):
    line = open_line(PortSpec.parse(unit))
    try:
        code, _, err = sensor(capsys, unit, "zero", "--yes")
    finally:
        line.close()
    assert (code, "in use" in err) == (74, True)


def test_a_sensor_that_does_no_such_thing(tmp_path, capsys):
    with emulator("g350", "--scenario", "rest", links=[tmp_path / "imu"]):
        code, _, err = sensor(capsys, f"{tmp_path / 'imu'}", "zero", "--yes")
    assert code == 64
    assert "M-G350" in err
    assert "offers no 'zero'; there is zero (crossbow" in err


def looked(rates_dps):
    """What `look` makes of a unit that turns so fast in packet after packet; of silence behind them."""
    talk = gyro_at_rest()
    next(talk)
    try:
        for rate in rates_dps:
            talk.send(Reading(0.0, 0.0, math.radians(rate), (0.0, 0.0, 9.80665), 0, 25.0).packet())
        talk.send(b"")
    except StopIteration as end:
        return end.value
    raise AssertionError("it looks on")


def test_only_a_unit_at_rest_has_a_zero():
    assert looked([2.0] * 50) == pytest.approx(2.0, abs=0.01)
    assert looked([-2.0] * 30) == pytest.approx(-2.0, abs=0.01)
    assert looked([]) == "it does not answer requests for packets"
    for moving in ([4.0, -4.0] * 25, [20.0] * 50):
        assert "not at rest" in looked(moving)
