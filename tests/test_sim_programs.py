"""Emulated programs of other systems: what their datagrams say, against the true motion, and who receives them."""

import json
import socket

import numpy as np
import pytest
from simulated import Remembering

from imud.commands.demo.aids import Aids
from imud.configuration.settings import Settings
from imud.daemon import simulated
from imud.daemon.simulated import Emulated, settings_of
from imud.errors import UsageError
from imud.estimators import registry
from imud.firmware_sim.device import PROGRAMS
from imud.firmware_sim.faults import spec
from imud.firmware_sim.faults.wire import Wire
from imud.firmware_sim.motion import Trajectory, rotation
from imud.firmware_sim.programs import KINDS, TRACK_M, Program
from imud.firmware_sim.scenarios import SCENARIOS
from imud.sensors.aiding import DatagramDecoder

CAR = Trajectory(SCENARIOS["car"](0.0, 0.0, 0.0), 35.6, 139.7, 60.0)
REMEMBERED = Remembering(CAR)
UTC = 1.7e9


def said(name, seconds, faults="", ideal=True):
    """(times, what a program says at them)."""
    [own] = spec.parse(faults, [name])
    with Program(name, REMEMBERED, np.random.default_rng(1), "127.0.0.1:9", UTC, own, ideal=ideal) as program:
        t = np.arange(1, round(10.0 * seconds) + 1) / 10.0
        return t, [json.loads(program.message(each)) for each in t]


def column(messages, key):
    return np.array([message[key] for message in messages])


def test_ideal_ones_say_the_true_motion():
    t, poses = said("pose", 40.0)
    truth = CAR.at(t)
    np.testing.assert_allclose(column(poses, "lat"), np.degrees(truth.lat), atol=2e-9)
    np.testing.assert_allclose(column(poses, "height"), truth.height, atol=1e-8)
    np.testing.assert_allclose(np.cos(np.radians(column(poses, "yaw")) - truth.rpy[:, 2]), 1.0, atol=1e-9)
    np.testing.assert_allclose(column(poses, "t"), UTC + t)
    _, velocities = said("velocity", 40.0)
    np.testing.assert_allclose(column(velocities, "ve"), truth.v_n[:, 1], atol=1e-8)
    _, relative = said("body_velocity", 40.0)
    forward = np.einsum("ni,ni->n", truth.v_n, rotation(truth.rpy)[:, :, 0])
    np.testing.assert_allclose(column(relative, "vx"), forward, atol=1e-8)
    assert forward.max() > 5.0
    _, wheels = said("wheels", 40.0)
    left, right = column(wheels, "left"), column(wheels, "right")
    np.testing.assert_allclose(0.5 * (left + right), forward, atol=1e-8)
    turned = np.sum((left - right) / TRACK_M) / 10.0
    assert abs(turned) > 1.0  # rad
    np.testing.assert_allclose(turned, np.unwrap(truth.rpy[:, 2])[-1] - truth.rpy[0, 2], atol=0.03)


@pytest.mark.parametrize("name", PROGRAMS)
def test_each_sends_what_the_daemon_decodes(name):
    known = registry.by_name("navigation").sources
    for message in said(name, 5.0, ideal=False)[1]:
        now_ns = round(1e9 * (message["t"] + 0.02))
        [(source, rows)] = DatagramDecoder().decode(json.dumps(message).encode(), known, 10**12, now_ns)
        assert source.name == ("odometer" if name == "wheels" else name)
        assert rows["sigma"][0, 0] > 0.0 and np.isfinite(rows["value"][0, 0])


@pytest.mark.thorough
@pytest.mark.parametrize("name", PROGRAMS)
def test_real_ones_are_wrong_by_a_little(name):
    kind = KINDS[name]
    ideal, real = said(name, 60.0)[1], said(name, 60.0, ideal=False)[1]
    for key, sigma, unit in zip(kind.fields, kind.sigma, kind.unit, strict=True):
        apart = column(real, key) - kind.scale * column(ideal, key)
        assert 0.3 < np.std(apart) / (sigma * unit) < 2.0


@pytest.mark.thorough
def test_faults_of_the_reading_in_their_time():
    t, right = said("velocity", 30.0)
    within = (t >= 10.0) & (t < 20.0)
    north, later = column(right, "vn"), slice(99, None)
    assert np.all(column(said("velocity", 30.0, "held@10-20")[1], "vn")[within] == north[98])
    shifted = said("velocity", 30.0, "other:offset=3@10-20")[1]
    np.testing.assert_allclose(column(shifted, "vn"), north + 3.0 * within, atol=1e-8)
    np.testing.assert_allclose(
        column(said("velocity", 30.0, "scale=3.6@10")[1], "vn")[later], 3.6 * north[later], atol=1e-8
    )
    np.testing.assert_allclose(column(said("velocity", 30.0, "clock=0.3@10")[1], "t")[later], UTC + t[later] - 0.3)
    assert ["t" in message for message in said("velocity", 30.0, "untimed@10-20")[1]] == (~within).tolist()
    metres = 111_320.0 * (
        column(said("pose", 30.0, "offset=20@10-20")[1], "lat") - column(said("pose", 30.0)[1], "lat")
    )
    np.testing.assert_allclose(metres, 20.0 * within, atol=1e-3)


def test_messages_are_sent_late_or_lost_as_faults_say(tmp_path):
    path = str(tmp_path / "aiding")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(path)
        receiver.setblocking(False)
        [own] = spec.parse("lose@1-2,delay=1x0.5@3-4", ["pose"])
        wire = Wire("pose", spec.of_layer("wire", own), np.random.default_rng(1))
        with Program("pose", CAR, np.random.default_rng(1), path, UTC, own, wire=wire) as program:
            found = []
            for t in np.arange(0.05, 5.0, 0.1):
                program.step(t)
                while True:
                    try:
                        found.append((t, json.loads(receiver.recv(4096))["t"] - UTC))
                    except BlockingIOError:
                        break
    sent, epochs = np.array(found).T
    assert not np.any((epochs > 0.99) & (epochs < 1.95)) and len(found) == 39
    late = sent - epochs
    assert np.all(late[(epochs > 2.95) & (epochs < 3.45)] > 0.4) and np.all(late[epochs < 2.9] < 0.1)


def test_without_a_daemon_nothing_stops():
    with Program("pose", CAR, np.random.default_rng(1), "/nowhere/aiding", UTC) as program:
        program.step(3.0)
        assert program.deadline() == pytest.approx(3.1)


def test_ports_of_programs_are_a_socket_that_the_daemon_reads(tmp_path):
    texts = ("sim:rest", "sim:rest:pose", "sim:rest:velocity")
    with simulated.emulated(texts, 1) as emulated:
        assert len(emulated.ports) == 1 and emulated.listen.endswith("/aiding")
        assert settings_of(Settings(ports=texts), emulated).aiding.listen == emulated.listen
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
            receiver.bind(emulated.listen)
            receiver.settimeout(20.0)
            assert {json.loads(receiver.recv(4096))["class"] for _ in range(10)} == {"POSE", "VEL"}
    with pytest.raises(UsageError, match="name that, too"), simulated.emulated(("sim:rest:pose",), 1):
        pass
    assert settings_of(Settings(), Emulated(("a",))).aiding.listen == ""


def test_the_demo_gives_each_device_its_options(tmp_path):
    aids = Aids(["wheel", "ak8975", "pose", "pose"])
    assignments, emulation = aids.options(tmp_path, "")
    assert aids.devices == ("wheel", "ak8975", "pose") and aids.driver("wheel") == ":nmea" and aids.driver("nmea") == ""
    assert assignments == ['aiding.iio=["ak8975"]', "aiding.magnetometer=true", f'aiding.listen="{tmp_path}/aiding"']
    assert emulation == [f"--iio-root={tmp_path}", f"--send={tmp_path}/aiding"]
    assert Aids(["pose"]).options(tmp_path, "127.0.0.1:2950")[1] == ["--send=127.0.0.1:2950"]
    with pytest.raises(UsageError, match="there are wheel"):
        Aids(["lidar"])
