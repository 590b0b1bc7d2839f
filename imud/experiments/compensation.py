"""Prasanna's compensation of gravity, as printed beside the mended one.

He prints accl_x = maccl_x + 9.8 sin(pitch), accl_y = maccl_y + 9.8 sin(roll), and integrates what is left twice. The
DMU shows gravity's direction: maccl = -f, so at rest maccl_x = -g sin(pitch), which the first removes, and maccl_y =
+g sin(roll) cos(pitch), which the second doubles. Mended: f and gravity are rotated by roll and pitch.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..math.arrays import Floats
from ..math.earth import STANDARD_GRAVITY
from .report import Row, at_most

PRINTED_G = 9.8  # m/s^2
REST_S = 10.0
ATTITUDES_DEG = ((0.0, 0.0), (0.0, 10.0), (10.0, 0.0), (10.0, 20.0), (30.0, 45.0))  # roll, pitch


def as_printed(f: Floats, roll: Floats, pitch: Floats) -> Floats:
    """accl_x, accl_y in m/s^2, (n, 2), of specific forces (n, 3) and angles in rad: along the unit's own axes."""
    maccl = -f
    return np.column_stack([maccl[:, 0] + PRINTED_G * np.sin(pitch), maccl[:, 1] + PRINTED_G * np.sin(roll)])


def mended(f: Floats, roll: Floats, pitch: Floats) -> Floats:
    """Level accelerations forward and to the right, (n, 2): the rotation, and none of gravity is level."""
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    forward = cp * f[:, 0] + sp * (sr * f[:, 1] + cr * f[:, 2])
    return np.column_stack([forward, cr * f[:, 1] - sr * f[:, 2]])


def reckoned(a: Floats, T: float) -> Floats:
    """His sums: velocity, then distance."""
    p: Floats = np.cumsum(np.cumsum(a, axis=0) * T, axis=0) * T
    return p


@dataclass(frozen=True)
class Compensated:
    """A unit at rest: what each method leaves of gravity, m/s^2, and how far it seems to move in REST_S, m."""

    left: tuple[float, float]
    moved: tuple[float, float]


def at_rest(roll_deg: float, pitch_deg: float) -> Compensated:
    """An ideal unit in that attitude, whose own angles are right."""
    roll, pitch = math.radians(roll_deg), math.radians(pitch_deg)
    down = np.array([-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)])
    n, T = 1000, REST_S / 1000
    f, r, p = np.tile(-STANDARD_GRAVITY * down, (n, 1)), np.full(n, roll), np.full(n, pitch)
    a = [method(f, r, p) for method in (as_printed, mended)]
    left, moved = ([float(np.linalg.norm(x[-1])) for x in xs] for xs in (a, [reckoned(x, T) for x in a]))
    return Compensated((left[0], left[1]), (moved[0], moved[1]))


def compensation_rows() -> list[Row]:
    """At rest nothing may be left."""
    rows = []
    for roll, pitch in ATTITUDES_DEG:
        unit = at_rest(roll, pitch)
        where = f"9.8 sin(angle) at rest, roll {roll:.0f}, pitch {pitch:.0f} deg"
        result = f"{unit.left[0]:.3f} m/s², {unit.moved[0]:.1f} m in {REST_S:.0f} s"
        rows.append(Row(f"{where}: left as printed", "0", result))
        rows.append(at_most(f"{where}: left by the rotation", "0", unit.left[1], 1e-9, "m/s²"))
    return rows
