"""`imud ros2`: a running daemon as a node of ROS 2. A process of its own, as `imud web`, and only a client."""

import argparse

from ...errors import UsageError
from ..arguments import add_live

_PACKAGES = {"rclpy", "sensor_msgs", "nav_msgs", "tf2_msgs", "diagnostic_msgs"}
_MISSING = (
    "the node needs ROS 2's Python package {}, which is not on PyPI: install ROS 2 for this Python (Jazzy or newer: "
    "`sudo apt install ros-jazzy-ros-base`, see docs.ros.org), and run `source /opt/ros/jazzy/setup.bash` before imud"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_live(parser)
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        metavar="ARGUMENT",
        help="for ROS 2, last: `-r __ns:=/car`, and parameters: `-p rate:=50.0` (of messages, Hz; default 100.0), "
        "`-p publish_tf:=false`, `-p wheel_odometry:=TOPIC` (nav_msgs/Odometry whose forward speed aids the filter) "
        "with `-p aiding:=PATH`, the daemon's `aiding.listen`, and `-p wheel_sigma:=0.1` (m/s; default 0.0: the "
        "message's own)",
    )


def run(args: argparse.Namespace) -> int:
    try:
        from .node import publish

        return publish(args)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _PACKAGES:
            raise
        raise UsageError(_MISSING.format(package)) from error
