"""The biases that the filter estimated for one sensor, stored over a restart of the daemon: a file per serial number.

They are used only if the sensor was certainly not switched off since: the computer has not been booted, the file is
seconds old, samples have the same calibration, and the sensor itself shows that it has stayed on. Any other file is
ignored: then the filter begins with the profile's biases.
"""

import contextlib
import math

import msgspec
import numpy as np

from ..folders import boot_id, folders_for, read_file, save_in
from ..math.arrays import Records
from .calibration import StoredTime, Triple
from .profiles import Profile

MAX_AGE_S = 60.0  # a restart takes seconds
MAX_GYRO_RADPS, MAX_ACCEL_MPS2 = 10.0, 100.0  # no sensor has biases, or standard deviations of them, that large
INFLATION = 2.0  # factor of the standard deviations: the temperature may have changed, the filter be wrong
ACCEL_BIAS_WALK_S = 100.0  # in which the accelerometer's bias may change by its instability; the gyro's: in 1 s


class Biases(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Of gyro and accelerometer, in body axes, with their standard deviations."""

    gyro_radps: Triple
    gyro_sigma_radps: Triple
    accel_mps2: Triple
    accel_sigma_mps2: Triple

    @property
    def is_plausible(self) -> bool:
        """Whether a sensor may have them, and all standard deviations are positive."""
        gyro, accel = self.gyro_radps + self.gyro_sigma_radps, self.accel_mps2 + self.accel_sigma_mps2
        small = all(abs(x) < MAX_GYRO_RADPS for x in gyro) and all(abs(x) < MAX_ACCEL_MPS2 for x in accel)
        return small and all(s > 0.0 for s in self.gyro_sigma_radps + self.accel_sigma_mps2)


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    serial: str
    boot_id: str
    monotonic_ns: StoredTime
    correction: list[float]  # of samples, by calibration and mounting
    biases: Biases


def biases_of(solution: np.void) -> Biases:
    """The biases in a row of SOLUTION."""
    values = (tuple(solution[name].tolist()) for name in ("bg", "sigma_bg", "ba", "sigma_ba"))
    return Biases(*values)


def aged(biases: Biases, age_s: float, profile: Profile) -> Biases | None:
    """The same `age_s` later, with larger standard deviations; None if they are as large as the profile's."""
    gyro_walk2 = profile.gyro_bias_instability**2 * age_s
    accel_walk2 = profile.accel_bias_instability**2 * age_s / ACCEL_BIAS_WALK_S
    older = Biases(
        biases.gyro_radps,
        _inflated(biases.gyro_sigma_radps, gyro_walk2, profile.gyro_bias_initial),
        biases.accel_mps2,
        _inflated(biases.accel_sigma_mps2, accel_walk2, profile.accel_bias_initial),
    )
    return older if max(older.gyro_sigma_radps) < profile.gyro_bias_initial else None


def _inflated(sigmas: Triple, variance: float, most: float) -> Triple:
    x, y, z = (min(math.sqrt((INFLATION * sigma) ** 2 + variance), most) for sigma in sigmas)
    return x, y, z


def load(serial: str, correction: Records, now_ns: int, profile: Profile) -> Biases | None:
    """The stored biases of the sensor `serial`, aged to `now_ns`; None: none that can be used."""
    for folder in folders_for("state"):
        with contextlib.suppress(OSError, msgspec.DecodeError, UnicodeDecodeError):
            stored = msgspec.json.decode(read_file(folder / _name(serial)), type=_File)
            age_s = (now_ns - stored.monotonic_ns) * 1e-9
            same = (stored.serial, stored.boot_id, stored.correction) == (serial, boot_id(), _numbers(correction))
            if same and 0.0 <= age_s <= MAX_AGE_S and stored.biases.is_plausible:
                return aged(stored.biases, age_s, profile)
    return None


def save(serial: str, correction: Records, now_ns: int, biases: Biases) -> None:
    """Replace the file as a whole, in the first folder that may be written. Raises OSError if there is none."""
    content = msgspec.json.encode(_File(serial, boot_id(), now_ns, _numbers(correction), biases))
    save_in([folder / _name(serial) for folder in folders_for("state")], content)


def _name(serial: str) -> str:
    return f"biases-{serial.encode().hex()}.json"


def _numbers(correction: Records) -> list[float]:
    """All fields but NaN, which is not equal to itself."""
    return [x for x in correction.view(np.float64).tolist() if not math.isnan(x)]
