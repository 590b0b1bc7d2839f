"""Chips whose drivers the kernel has, as their IIO devices look in sysfs: one row each.

Sources: drivers/iio/imu of the kernel: bmi160/bmi160_core.c (channels 4 to 9 behind those of an external
magnetometer), st_lsm6dsx (two devices, hardware FIFO, no trigger), adis16475.c and Documentation/iio/adis16475.rst
(big-endian, 32 bits). Noise: data sheets of BMI160, LSM6DSO and ADIS16505-2, as far as `Grade` has it.
"""

import math
from dataclasses import dataclass

GYRO, ACCEL, TEMPERATURE, STAMP = "anglvel", "accel", "temp0", "timestamp"
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Part:
    """One IIO device. channels: each with its index (that of x; y and z follow) and its type."""

    name: str
    channels: tuple[tuple[str, int, str], ...]


@dataclass(frozen=True)
class Chip:
    """One row. scales: SI per count; rates: samples per second that can be set."""

    parts: tuple[Part, ...]
    rates: tuple[float, ...]
    gyro_scale: float
    accel_scale: float
    trigger: bool
    noise: tuple[float, float]  # deg/s and mg, per sqrt(Hz)
    turn_on: tuple[float, float]  # deg/s and mg
    mount: tuple[tuple[float, float, float], ...] = IDENTITY
    limit: tuple[float, float] = (2000.0 * math.pi / 180.0, 8.0 * 9.80665)  # rad/s and m/s^2
    per_quantity: bool = False  # rates are set for gyros and accelerometers apart


S16, S64 = "le:s16/16>>0", "le:s64/64>>0"
CHIPS = {
    "bmi160": Chip(
        parts=(Part("bmi160", ((GYRO, 4, S16), (ACCEL, 7, S16), (STAMP, 10, S64))),),
        rates=(25.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0),
        gyro_scale=0.001065,
        accel_scale=0.001197,
        trigger=True,
        noise=(0.007, 0.18),
        turn_on=(1.0, 20.0),
        per_quantity=True,
    ),
    "lsm6dso": Chip(
        parts=(
            Part("lsm6dso_accel", ((ACCEL, 0, S16), (STAMP, 3, S64))),
            Part("lsm6dso_gyro", ((GYRO, 0, S16), (STAMP, 3, S64))),
        ),
        rates=(12.5, 26.0, 52.0, 104.0, 208.0, 416.0, 833.0),
        gyro_scale=0.001221730,
        accel_scale=0.000598205,
        limit=(2000.0 * math.pi / 180.0, 2.0 * 9.80665 * 0.999),
        trigger=False,
        noise=(0.0038, 0.08),
        turn_on=(0.5, 10.0),
        mount=((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ),
    "adis16505-2": Chip(
        parts=(
            Part(
                "adis16505-2",
                (
                    (GYRO, 0, "be:s32/32>>0"),
                    (ACCEL, 3, "be:s32/32>>0"),
                    (TEMPERATURE, 6, "be:s16/16>>0"),
                    (STAMP, 13, S64),
                ),
            ),
        ),
        rates=(),
        gyro_scale=0.000000006,
        limit=(500.0 * math.pi / 180.0, 8.0 * 9.80665),
        accel_scale=0.000000037,
        trigger=True,
        noise=(0.004, 0.04),
        turn_on=(0.2, 2.0),
    ),
    # of no maker: accelerometers first, other byte orders and shifts, an unsigned temperature
    "swapped": Chip(
        parts=(
            Part(
                "swapped",
                (
                    (STAMP, 0, S64),
                    (ACCEL, 1, "be:s20/32>>12"),
                    (TEMPERATURE, 9, "le:u12/16>>4"),
                    (GYRO, 12, "le:s24/32>>4"),
                ),
            ),
        ),
        rates=(50.0, 100.0, 250.0, 500.0),
        gyro_scale=0.000008,
        accel_scale=0.0003,
        trigger=True,
        noise=(0.007, 0.18),
        turn_on=(1.0, 20.0),
    ),
}
