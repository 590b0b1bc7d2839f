"""The rotation between the axes of two inertial sensors on one body, stored over a restart: a file per serial number.

It is of the sensors' own axes, so it holds whatever mountings the settings have. Who moved a sensor while the daemon
did not run left no trace. So a rotation is trusted at once only if the sensors have stayed switched on, the computer
has not been booted, and the file is seconds old; any other one only once what both sensors sense has confirmed it.
"""

import contextlib
import math
import time

import msgspec
import numpy as np

from ..folders import boot_id, folders_for, read_file, save_in
from ..math.arrays import Floats
from .calibration import MAX_MOUNTING_SIGMA_DEG, StoredTime, Triple
from .stored_biases import MAX_AGE_S

GROWTH_DEG_PER_DAY = 1.0  # of the standard deviation: screws loosen, and somebody may have been at them
_DAY_S = 86400.0

Nine = tuple[float, float, float, float, float, float, float, float, float]


class StoredRotation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Of the sensor `serial` against the sensor `other`, which was in use. Matrices are row-major."""

    serial: str
    other: str
    turn: Nine  # from the axes of `serial` to those of `other`
    body: Nine  # from the axes of `other` to the vehicle's
    sigma_deg: float  # when it was found, of the axis about which it was known worst
    found_s: float  # UNIX time
    mountings: dict[str, Triple]  # by the settings of that run: `imu.mounts`, and "" for `imu.mount_rpy_deg`
    boot_id: str = ""
    monotonic_ns: StoredTime = 0  # when it was used last

    @property
    def matrix(self) -> Floats:
        """`turn` [3, 3]."""
        return np.array(self.turn).reshape(3, 3)

    @property
    def inverse(self) -> "StoredRotation":
        """Of `other` against `serial`."""
        body = np.array(self.body).reshape(3, 3) @ self.matrix
        back = nine(self.matrix.T), nine(body)
        return msgspec.structs.replace(self, serial=self.other, other=self.serial, turn=back[0], body=back[1])

    def sigma_deg_at(self, now_s: float) -> float:
        """Its standard deviation at that UNIX time, deg; infinite before it was found."""
        age_s = now_s - self.found_s
        return math.hypot(self.sigma_deg, GROWTH_DEG_PER_DAY * age_s / _DAY_S) if age_s >= 0.0 else math.inf

    def is_recent(self, now_ns: int) -> bool:
        """Whether it was in use seconds ago, at the same boot of the computer."""
        return self.boot_id == boot_id() and 0.0 <= (now_ns - self.monotonic_ns) * 1e-9 <= MAX_AGE_S

    @property
    def is_plausible(self) -> bool:
        """Whether both matrices are rotations, and the times and sigma numbers."""
        numbers = np.array([*self.turn, *self.body, self.sigma_deg, self.found_s])
        if not np.isfinite(numbers).all() or self.sigma_deg <= 0.0:
            return False
        turns = numbers[:18].reshape(2, 3, 3)
        unit = np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)).max() < 1e-6
        return bool(unit and (np.linalg.det(turns) > 0.0).all())


def nine(matrix: Floats) -> Nine:
    """The numbers of a matrix [3, 3], row-major."""
    a, b, c, d, e, f, g, h, i = matrix.ravel().tolist()
    return a, b, c, d, e, f, g, h, i


def load(serial: str) -> StoredRotation | None:
    """The stored rotation of the sensor `serial`; None: none, or one that is too old to be known well enough."""
    for folder in folders_for("state") if serial else ():
        with contextlib.suppress(OSError, msgspec.DecodeError, UnicodeDecodeError):
            found = msgspec.json.decode(read_file(folder / _name(serial)), type=StoredRotation)
            known = found.is_plausible and found.sigma_deg_at(time.time()) <= MAX_MOUNTING_SIGMA_DEG
            if found.serial == serial and known:
                return found
    return None


def between(serial: str, other: str) -> StoredRotation | None:
    """The stored rotation of the sensor `serial` against `other`, whichever of them was in use; None as `load`."""
    if serial == other:
        return None
    found = [each for each in (load(serial), load(other)) if each and {each.serial, each.other} == {serial, other}]
    if not found:
        return None
    newest = max(found, key=lambda each: each.found_s)
    return newest if newest.serial == serial else newest.inverse


def save(rotation: StoredRotation, now_ns: int) -> None:
    """Replace the file as a whole, in the first folder that may be written. Raises OSError if there is none."""
    content = msgspec.json.encode(msgspec.structs.replace(rotation, boot_id=boot_id(), monotonic_ns=now_ns))
    save_in([folder / _name(rotation.serial) for folder in folders_for("state")], content)


def remove(rotation: StoredRotation) -> None:
    """Remove what was stored of these two sensors, as far as the folders may be written."""
    pair = {rotation.serial, rotation.other}
    for found in [each for each in map(load, pair) if each and {each.serial, each.other} == pair]:
        for folder in folders_for("state"):
            with contextlib.suppress(OSError):
                (folder / _name(found.serial)).unlink()


def _name(serial: str) -> str:
    return f"rotation-{serial.encode().hex()}.json"
