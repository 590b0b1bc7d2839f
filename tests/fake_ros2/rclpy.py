"""A stand-in for rclpy and the packages of messages, for the tests of `imud ros2`: what the node uses, strictly.

Message classes are rosbags'. What is published goes to the file FAKE_ROS2_OUT as JSON lines; each line of the pipe
FAKE_ROS2_IN, `{"topic", "speed", "variance", "t_s"}`, comes to the subscriptions as nav_msgs/Odometry.
"""

import base64
import json
import os
import sys
import threading
import time
import types
from enum import Enum

from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)


class InvalidParameterTypeException(Exception):  # noqa: N818
    pass


class ExternalShutdownException(Exception):  # noqa: N818
    pass


class DurabilityPolicy(Enum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class SignalHandlerOptions(Enum):
    NO = 0


class QoSProfile:
    def __init__(self, *, depth, durability=DurabilityPolicy.VOLATILE):
        self.depth, self.durability = depth, durability


class Publisher:
    def __init__(self, kind, topic, quality, out):
        self._kind, self._out = kind, out
        self._head = {"topic": topic, "type": kind.__msgtype__, "durability": quality.durability.name}

    def publish(self, message):
        if not isinstance(message, bytes | self._kind):
            raise TypeError(f"Expected {self._kind}, got {type(message)}")
        self._out.write(json.dumps(self._head | {"data": base64.b64encode(message).decode()}) + "\n")
        self._out.flush()


class Node:
    def __init__(self, name, given):
        self.name, self._given = name, given
        self._out = open(os.environ["FAKE_ROS2_OUT"], "a")  # noqa: SIM115, PTH123
        self.subscriptions = {}

    def declare_parameter(self, name, value):
        text = self._given.get(name)
        if text is not None:
            given = {"true": True, "false": False}.get(text, text)
            if not isinstance(given, bool) and text.replace(".", "", 1).replace("-", "", 1).isdigit():
                given = float(text) if "." in text else int(text)
            if type(given) is not type(value):
                raise InvalidParameterTypeException(f"Trying to set parameter '{name}' to '{text}' of another type")
            value = given
        return types.SimpleNamespace(value=value)

    def create_publisher(self, kind, topic, quality):
        return Publisher(kind, topic, quality, self._out)

    def create_subscription(self, kind, topic, callback, quality):
        assert isinstance(quality, QoSProfile)
        self.subscriptions[topic] = callback

    def get_clock(self):
        return types.SimpleNamespace(now=lambda: types.SimpleNamespace(nanoseconds=time.time_ns()))

    def destroy_node(self):
        self._out.write(json.dumps({"topic": "destroyed"}) + "\n")
        self._out.close()


class SingleThreadedExecutor:
    def __init__(self):
        self._ended = threading.Event()

    def add_node(self, node):
        self._node = node

    def spin(self):
        if path := os.environ.get("FAKE_ROS2_IN"):
            with open(path) as lines:  # noqa: PTH123
                for line in lines:
                    said = json.loads(line)
                    self._node.subscriptions[said["topic"]](odometry(**said))
        self._ended.wait()
        raise ExternalShutdownException

    def shutdown(self):
        self._ended.set()


def odometry(topic, speed, variance, t_s):
    covariance = [variance, *[0.0] * 35]
    twist = types.SimpleNamespace(linear=types.SimpleNamespace(x=speed, y=0.0, z=0.0))
    stamp = types.SimpleNamespace(sec=int(t_s), nanosec=round(t_s % 1 * 1e9))
    return types.SimpleNamespace(
        header=types.SimpleNamespace(stamp=stamp), twist=types.SimpleNamespace(twist=twist, covariance=covariance)
    )


_given = {}


def init(*, args=None, signal_handler_options=None):
    assert signal_handler_options is SignalHandlerOptions.NO
    assert not args or args[0] == "--ros-args"
    for flag, text in zip(args or [], (args or [])[1:], strict=False):
        if flag == "-p":
            name, _, value = text.partition(":=")
            _given[name] = value


def create_node(name):
    return Node(name, _given)


def try_shutdown():
    pass


def _module(name, **members):
    sys.modules[name] = module = types.ModuleType(name)
    vars(module).update(members)


_module("rclpy.exceptions", InvalidParameterTypeException=InvalidParameterTypeException)
_module(
    "rclpy.executors",
    ExternalShutdownException=ExternalShutdownException,
    SingleThreadedExecutor=SingleThreadedExecutor,
)
_module("rclpy.qos", DurabilityPolicy=DurabilityPolicy, QoSProfile=QoSProfile)
_module("rclpy.signals", SignalHandlerOptions=SignalHandlerOptions)
for _package in set(os.environ.get("FAKE_ROS2_PACKAGES", "sensor_msgs nav_msgs tf2_msgs diagnostic_msgs").split()):
    _names = [name for name in STORE.types if name.startswith(f"{_package}/msg/")]
    _module(_package)
    _module(f"{_package}.msg", **{name.rpartition("/")[2]: STORE.types[name] for name in _names})
