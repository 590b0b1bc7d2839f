"""The names of what a filter estimates beside its solution, as one table, from which every output is made.

Delays of the receiver's positions and velocities, its correlated errors and its noise, the lever arm of its antenna,
the mounting of the sensor, scale factors, the errors of other sources, the process noise that was learned; and the
covariance of position, velocity and attitude. A command that shows them needs no numpy: the records are elsewhere
(`imud.estimators.filter_states`).
"""

import math
from typing import NamedTuple

DEGREE = math.pi / 180.0  # rad


class FilterState(NamedTuple):
    """One number. group: of what it is; kind and part: its name; `part` is empty if there is only one of the kind.

    unit: SI, as names have it.
    """

    group: str
    kind: str
    part: str
    unit: str
    about: str

    @property
    def name(self) -> str:
        """Without the unit."""
        return f"{self.kind}_{self.part}" if self.part else self.kind

    @property
    def column(self) -> str:
        """In tables, which have angles in degrees."""
        return "_".join(filter(None, (self.name, self.shown_unit)))

    @property
    def shown_unit(self) -> str:
        """Of `column`."""
        return "deg" if self.unit == "rad" else self.unit

    @property
    def factor(self) -> float:
        """From SI to the unit of `column`."""
        return 1.0 / DEGREE if self.unit == "rad" else 1.0


_DELAYED = "heading", "odometer", "pose", "velocity", "body_velocity"  # sources whose age is estimated
_KINDS: tuple[tuple[str, str, tuple[str, ...], str, str], ...] = (  # the place is its number in recordings: append only
    ("receiver", "time_offset", ("",), "s", "by which a fix is older than its epoch says"),
    ("receiver", "velocity_time_offset", ("",), "s", "by which the receiver's velocity is older than its position"),
    ("receiver", "gnss_bias", ("n", "e", "d"), "m", "correlated error of the receiver's position"),
    ("receiver", "gnss_velocity_bias", ("n", "e", "d"), "mps", "correlated error of the receiver's velocity"),
    ("receiver", "gnss_noise", ("horizontal", "vertical"), "m", "white noise of the receiver's position, learned"),
    ("receiver", "gnss_velocity_noise", ("",), "mps", "white noise of the receiver's velocity, learned"),
    ("receiver", "gnss_lever_arm", ("x", "y", "z"), "m", "antenna from the IMU, body axes"),
    ("vehicle", "mount", ("pitch", "yaw"), "rad", "of the vehicle's forward axis in the body"),
    ("vehicle", "nhc_lever_arm", ("",), "m", "of the IMU ahead of the point about which the vehicle turns"),
    (
        "sensor",
        "gyro_scale",
        ("xx", "yx", "zx", "xy", "yy", "zy", "xz", "yz", "zz"),
        "",
        "scale factors and misalignments of the gyros: error about the first axis per rate about the second",
    ),
    ("aiding", "odometer_scale", ("",), "", "by which the odometer's reading is too large, as a share of the speed"),
    ("aiding", "baro_offset", ("",), "m", "by which the barometer's height is too large"),
    ("aiding", "age", _DELAYED, "s", "by which measurements are older than their epochs say"),
    (
        "vehicle",
        "velocity_noise",
        ("",),
        "mps",
        "process noise, learned: what a second's vibration adds to the velocity",
    ),
    ("vehicle", "attitude_noise", ("",), "rad", "process noise, learned: what a second's vibration adds to the angles"),
    (
        "sensor",
        "accel_scale",
        ("x", "y", "z"),
        "",
        "by which the accelerometer's reading is too large, as a share of it",
    ),
    ("sensor", "accel_delay", ("",), "s", "of the accelerometer behind the gyro"),
    (
        "aiding",
        "heading_boresight",
        ("",),
        "rad",
        "by which headings are too large, beyond the settings",
    ),
    ("aiding", "velocity_mount", ("roll", "pitch", "yaw"), "rad", "of a sensor of the velocity in the body"),
)
STATES = tuple(
    FilterState(group, kind, part, unit, about) for group, kind, parts, unit, about in _KINDS for part in parts
)
PLACES = {state.name: i for i, state in enumerate(STATES)}  # in `value` and `sigma`

_ERRORS = (*(f"p{axis}" for axis in "ned"), *(f"v{axis}" for axis in "ned"), *(f"a{axis}" for axis in "ned"))
COVARIANCES = tuple(f"cov_{a}_{b}" for i, a in enumerate(_ERRORS) for b in _ERRORS[i:])
