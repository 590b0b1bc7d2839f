"""The node: what `imud export --ros2` writes, published live, and wheel odometry passed on to the daemon's filter.

Messages are published as they are in CDR, so that their contents are the export's to the byte.
"""

import argparse
import importlib
import math
import threading
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from typing import Any

import numpy as np
import rclpy
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

from imud.drivers.sample import SAMPLE

from ...client import AidingSender
from ...errors import UsageError
from ...process.signals import caught, endings
from ...recording.enu import Vector
from ...ros2.converter import Converter, Message
from ...ros2.definitions import STATIC, TOPICS
from ...ros2.messages import Diagnosis, Sigmas, filter_diagnosis
from ...sensor_errors.profiles import DEFAULT, PROFILES, SampleSigma, sample_sigmas
from ..live import follow
from ..status import nested

_DEPTH = 10  # messages that wait for a slow subscriber
_PARAMETERS: dict[str, float | bool | str] = {  # and their defaults; `imud ros2 --help` explains them
    "rate": 100.0,
    "publish_tf": True,
    "wheel_odometry": "",
    "aiding": "",
    "wheel_sigma": 0.0,
}
_FASTEST_HZ = 2000.0  # of sensors
_TF = ("/tf", STATIC)


def _class_of(kind: str) -> Any:
    """The class of a message type, `package/msg/Name`. Raises ModuleNotFoundError."""
    package, _, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def sample_of(solution: np.void) -> np.void:
    """A row of SAMPLE, as it was measured: the solution with its biases put back."""
    row = np.zeros(1, SAMPLE)[0]
    row["t_ns"] = solution["t_ns"]
    row["w"], row["f"] = solution["w"] + solution["bg"], solution["f"] + solution["ba"]
    sample: np.void = row
    return sample


def sigmas_of(status: Mapping[str, Any]) -> Sigmas | None:
    """What samples are worth, of the daemon's flat status; None: it does not say, as before the first sample."""
    known = nested(status)["filter"].get("sample")
    if known is None:
        return None
    rate, force = (known.get(name) for name in ("rate_radps", "force_mps2"))
    return Sigmas(SampleSigma(**rate) if rate else None, SampleSigma(**force) if force else None)


def antenna_of(status: Mapping[str, Any]) -> Vector | None:
    """From the inertial sensor, FRD, m; None: not known."""
    known = [status.get(f"filter.antenna_{axis}_m") for axis in "xyz"]
    return None if None in known else [float(value) for value in known if value is not None]


def diagnoses_of(status: Mapping[str, Any]) -> list[Diagnosis]:
    """Of the filter and of each port."""
    table = nested(status)
    known = table["filter"]
    parts = [filter_diagnosis(known["estimator"], known.get("state", "aligning"))]
    for port in table["ports"]:
        values = {name: value for name, value in port.items() if not isinstance(value, Mapping)}
        if not port["streaming"]:
            parts.append(Diagnosis(port["path"], [port["description"]], "", values))
            continue
        kind = "inertial sensor" if "rate_asked_hz" in port else "receiver"
        hardware = " ".join(filter(None, (port["model"] or port["driver"], port["serial"])))
        parts.append(Diagnosis(kind, [] if port["health"] == "ok" else [port["health"]], hardware, values))
    return parts


class Publisher:
    """Publishes the daemon's data on topics of the node; with_tf: also transforms."""

    def __init__(self, node: Any, with_tf: bool) -> None:
        self._converter = Converter()
        self._converter.sigmas = Sigmas(*sample_sigmas(PROFILES[DEFAULT], _FASTEST_HZ))  # until the daemon reports them
        self._antenna_m: Vector | None = None
        self._publishers: dict[str, Any] = {}
        for topic, kind in TOPICS.items():
            if with_tf or topic not in _TF:
                latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
                quality = latched if topic == STATIC else QoSProfile(depth=_DEPTH)
                self._publishers[topic] = node.create_publisher(_class_of(kind), topic, quality)
        self._now = node.get_clock().now
        self._publish([self._converter.static(None, self._now().nanoseconds)])

    def _publish(self, messages: Iterable[Message]) -> None:
        for topic, _, data in messages:
            if topic in self._publishers:
                self._publishers[topic].publish(data)

    def on_solution(self, solution: np.void, unix_ns: int) -> None:
        """A row of SOLUTION."""
        self._publish(self._converter.of_sample(sample_of(solution), unix_ns))
        self._publish(self._converter.of_solution(solution, unix_ns))

    def on_fix(self, fix: np.void, unix_ns: int, utc_ns: int | None) -> None:
        """A row of FIX."""
        self._publish(self._converter.of_fix(fix, unix_ns, utc_ns))

    def on_status(self, status: Mapping[str, Any], unix_ns: int) -> None:
        """The daemon's flat status."""
        self._converter.sigmas = sigmas_of(status) or self._converter.sigmas
        if (antenna_m := antenna_of(status)) != self._antenna_m and antenna_m is not None:
            self._antenna_m = antenna_m
            self._publish([self._converter.static(antenna_m, unix_ns)])
        self._publish(self._converter.of_diagnoses(diagnoses_of(status), unix_ns))


class WheelOdometry:
    """Passes the forward speed of nav_msgs/Odometry on to the daemon."""

    def __init__(self, sender: AidingSender, sigma_mps: float) -> None:
        """sigma_mps: 0: that of the message."""
        self._sender, self._sigma_mps = sender, sigma_mps

    def take(self, message: Any) -> None:
        """A message. One without a covariance has no sigma, one without a stamp is of now."""
        speed, variance = float(message.twist.twist.linear.x), float(message.twist.covariance[0])
        stamp = message.header.stamp
        values = {"speed": speed}
        if sigma := self._sigma_mps or (math.sqrt(variance) if 0.0 < variance < math.inf else 0.0):
            values["sigma"] = sigma
        if t := stamp.sec + 1e-9 * stamp.nanosec:
            values["t"] = t
        if math.isfinite(speed):
            self._sender.send("ODO", **values)


def _parameters(node: Any) -> dict[str, Any]:
    """Raises UsageError."""
    try:
        values = {name: node.declare_parameter(name, value).value for name, value in _PARAMETERS.items()}
    except InvalidParameterTypeException as error:
        raise UsageError(f"{error} (write 50.0, not 50)") from error
    if not 0.0 < values["rate"] < math.inf:
        raise UsageError(f"rate:={values['rate']}: a number above 0 is needed")
    if values["wheel_odometry"] and not values["aiding"]:
        raise UsageError("wheel_odometry needs aiding:=PATH, the daemon's aiding.listen")
    return values


def _spin(executor: Any) -> None:
    with suppress(ExternalShutdownException):
        executor.spin()


def publish(args: argparse.Namespace) -> int:
    """Publish until SIGTERM or SIGINT. Raises UsageError, ModuleNotFoundError."""
    given = ["--ros-args", *args.ros_args] if args.ros_args else []
    rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    with ExitStack() as stack:
        stack.callback(rclpy.try_shutdown)
        node = rclpy.create_node("imud")
        stack.callback(node.destroy_node)
        known = _parameters(node)
        if known["wheel_odometry"]:
            try:
                sender = stack.enter_context(AidingSender(known["aiding"]))
            except ValueError as error:
                raise UsageError(f"aiding:={error}") from error
            wheels = WheelOdometry(sender, known["wheel_sigma"])
            kind = _class_of("nav_msgs/msg/Odometry")
            node.create_subscription(kind, known["wheel_odometry"], wheels.take, QoSProfile(depth=_DEPTH))
        publisher = Publisher(node, known["publish_tf"])
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        spinning = threading.Thread(target=_spin, args=(executor,), daemon=True)
        with caught(dict.fromkeys(endings(), lambda: None)) as wake:
            spinning.start()
            try:
                follow("ros2", args, known["rate"], publisher, wake)
            finally:
                executor.shutdown()
                spinning.join(1.0)
    return 0
