"""`imud ros2`: the node beside a real daemon, with a stand-in for rclpy (`fake_ros2`) and rosbags' message types.

Oracle: the daemon's own states, read from its stream, and `imud status`. Contents in all poses: test_ros2.py.
"""

import base64
import contextlib
import json
import os
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from poses import FRD_IN_FLU, NED_IN_ENU
from processes import TIMEOUT_S, daemon, process
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from imud import client
from imud.ros2.definitions import TOPICS
from imud.sensor_errors.profiles import PROFILES, sample_sigmas

FAKE = Path(__file__).parent / "fake_ros2"
STORE = get_typestore(Stores.ROS2_HUMBLE)
PORTS = ("--port", "sim:car", "--port", "sim:car:nmea")
ARM = (0.5, -0.25, -1.5)


@contextlib.contextmanager
def node(folder, *arguments, **environment):
    """The process, with its output in folder/ros.jsonl."""
    known = {**os.environ, "PYTHONPATH": str(FAKE), "FAKE_ROS2_OUT": str(folder / "ros.jsonl"), **environment}
    with process("imud", "ros2", *map(str, arguments), env=known, stderr=subprocess.PIPE) as running:
        yield running


def published(folder):
    """By topic the messages so far; of each how it is offered."""
    path = folder / "ros.jsonl"
    messages, durability = {}, {}
    for line in path.read_text().splitlines(keepends=True) if path.exists() else []:
        if line.endswith("\n"):
            said = json.loads(line)
            if "data" in said:
                data = STORE.deserialize_cdr(base64.b64decode(said["data"]), said["type"])
                assert said["type"] == TOPICS[said["topic"]]
                messages.setdefault(said["topic"], []).append(data)
                durability[said["topic"]] = said["durability"]
    return messages, durability


def until(accept):
    """The first true answer."""
    deadline = time.monotonic() + TIMEOUT_S
    while not (answer := accept()):
        assert time.monotonic() < deadline
        time.sleep(0.2)
    return answer


def ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


@pytest.mark.thorough
def test_the_node_publishes_the_daemons_states(tmp_path):
    stream = tmp_path / "imud.stream"
    settings = ("--set", f"stream.listen={stream}", "--set", f"navigation.lever_arm_m={list(ARM)}")
    with daemon(tmp_path, *PORTS, *settings) as imud:
        imud.until(lambda message: message["class"] == "EST" and "position" in message["state"])
        states = {}
        with (
            client.connect(stream, timeout_s=TIMEOUT_S) as own,
            node(tmp_path, stream, "--gpsd", tmp_path / "gpsd.sock", "--ros-args", "-p", "rate:=50.0") as running,
        ):

            def enough():
                for state in own:
                    states[state.t_ns] = state
                    if state.seq % 500 == 0:
                        break
                messages, _ = published(tmp_path)
                return set(messages) == set(TOPICS) and len(messages["fix"]) > 2 and len(messages["/diagnostics"]) > 2

            until(enough)
            running.terminate()
            assert running.wait(TIMEOUT_S) == 0
    messages, durability = published(tmp_path)
    assert durability == {topic: "TRANSIENT_LOCAL" if topic == "/tf_static" else "VOLATILE" for topic in TOPICS}
    assert '"destroyed"' in (tmp_path / "ros.jsonl").read_text().splitlines()[-1]
    by_stamp = {state.t_ns + state.utc_offset_ns: state for state in states.values()}
    gyro, _ = sample_sigmas(PROFILES["m-g350"], 1000.0)
    compared = 0
    for imu, raw in zip(messages["imu/data"], messages["imu/data_raw"], strict=True):
        assert imu.header == raw.header
        if (state := by_stamp.get(ns(imu.header.stamp))) is None:
            continue
        compared += 1
        q, (w, x, y, z) = imu.orientation, state.q_nb
        wanted = NED_IN_ENU @ Rotation.from_quat([x, y, z, w]).as_matrix() @ FRD_IN_FLU
        assert Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix() == pytest.approx(wanted, abs=1e-9)
        rates = np.array([[v.x, v.y, v.z] for v in (imu.angular_velocity, raw.angular_velocity)])
        assert rates == pytest.approx(np.array([state.w, np.add(state.w, state.bg)]) @ FRD_IN_FLU, abs=1e-12)
        least = gyro.white**2 + gyro.bias**2 + (gyro.scale * np.linalg.norm(rates[1])) ** 2
        assert raw.angular_velocity_covariance[0] >= 0.999999 * least  # more until the status has come
    assert compared > 20
    assert raw.angular_velocity_covariance[0] == pytest.approx(least, rel=0.1)
    gaps_s = np.diff([ns(imu.header.stamp) for imu in messages["imu/data"][60:]]) * 1e-9
    assert np.median(gaps_s) == pytest.approx(0.02, rel=0.1)
    antenna = messages["/tf_static"][-1].transforms[1]
    place = antenna.transform.translation
    assert (antenna.child_frame_id, [place.x, place.y, place.z]) == ("gnss_link", [0.5, 0.25, 1.5])
    assert [t.child_frame_id for t in messages["/tf_static"][0].transforms] == ["imu_link"]  # not known yet
    assert {t.child_frame_id for t in messages["/tf"][-1].transforms} == {"odom", "base_link"}
    for fix, reference in zip(messages["fix"], messages["time_reference"], strict=True):
        assert fix.header.stamp == reference.header.stamp
        assert ns(reference.time_ref) == pytest.approx(ns(fix.header.stamp), abs=0.5e9)  # the emulator has our time
    parts = [status.name for status in messages["/diagnostics"][-1].status]
    assert parts == ["imud: filter", "imud: inertial sensor", "imud: receiver"]


@pytest.mark.thorough
def test_wheel_odometry_reaches_the_filter(tmp_path):
    stream, aiding, pipe = tmp_path / "imud.stream", tmp_path / "aiding", tmp_path / "in"
    os.mkfifo(pipe)
    parameters = ("-p", "wheel_odometry:=wheels", "-p", f"aiding:={aiding}", "-p", "publish_tf:=false")
    gpsd = ("--gpsd", tmp_path / "gpsd.sock")
    with (
        daemon(tmp_path, *PORTS, "--set", f"stream.listen={stream}", "--set", f"aiding.listen={aiding}") as imud,
        node(tmp_path, stream, *gpsd, "--ros-args", *parameters, FAKE_ROS2_IN=str(pipe)),
        pipe.open("w") as wheels,
    ):
        imud.until(lambda message: message["class"] == "EST")

        def sent():
            said = {"topic": "wheels", "speed": 3.0, "variance": 0.04, "t_s": time.time()}
            wheels.write(json.dumps(said) + "\n")
            wheels.flush()
            imud.client.sendall(b"?STATUS;\n")
            status = imud.until(lambda message: message["class"] == "STATUS")
            return status.get("aiding.sources.odometer.received", 0) > 3 and status

        assert not [name for name in until(sent) if name.startswith("aiding.refused")]
        messages = until(lambda: published(tmp_path)[0].get("imu/data") and published(tmp_path)[0])
    assert not {"/tf", "/tf_static"} & set(messages)


class Sent:
    """In place of an AidingSender."""

    def __init__(self):
        self.values = []

    def send(self, kind, **values):
        self.values.append((kind, values))


def test_what_becomes_of_a_wheel_message(monkeypatch):
    monkeypatch.syspath_prepend(str(FAKE))
    import rclpy

    from imud.commands.ros2.node import WheelOdometry

    assert rclpy.__file__.startswith(str(FAKE))
    sent = Sent()
    WheelOdometry(sent, 0.0).take(rclpy.odometry("", 2.0, 0.25, 100.5))
    WheelOdometry(sent, 0.0).take(rclpy.odometry("", -2.0, 0.0, 0.0))
    WheelOdometry(sent, 0.3).take(rclpy.odometry("", 2.0, 0.25, 0.0))
    WheelOdometry(sent, 0.0).take(rclpy.odometry("", float("nan"), 0.25, 0.0))
    assert sent.values == [
        ("ODO", {"speed": 2.0, "sigma": 0.5, "t": 100.5}),
        ("ODO", {"speed": -2.0}),
        ("ODO", {"speed": 2.0, "sigma": 0.3}),
    ]


@pytest.mark.parametrize(
    ("arguments", "environment", "text"),
    [
        ((), {"PYTHONPATH": ""}, "needs ROS 2's Python package rclpy, which is not on PyPI"),
        ((), {"FAKE_ROS2_PACKAGES": "sensor_msgs"}, "needs ROS 2's Python package nav_msgs"),
        (("-p", "rate:=50"), {}, "write 50.0, not 50"),
        (("-p", "rate:=-1.0"), {}, "a number above 0 is needed"),
        (("-p", "wheel_odometry:=odom"), {}, "wheel_odometry needs aiding:=PATH"),
        (("-p", "wheel_odometry:=odom", "-p", "aiding:=nowhere"), {}, "aiding:='nowhere' is no address"),
    ],
)
def test_mistakes_are_named(tmp_path, arguments, environment, text):
    with node(tmp_path, "x", "--ros-args", *arguments, **environment) as running:
        assert running.wait(TIMEOUT_S) == 64
        assert text in running.stderr.read()
