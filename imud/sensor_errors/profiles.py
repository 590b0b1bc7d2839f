"""Noise profiles of inertial sensors by name: the error model that an estimator needs, each with its source."""

import math
from dataclasses import dataclass, replace

from ..configuration.settings import Settings
from ..math.earth import STANDARD_GRAVITY


@dataclass(frozen=True)
class Profile:
    """Noise of one sensor model, SI."""

    gyro_noise: float  # angular random walk, (rad/s)/sqrt(Hz)
    gyro_bias_instability: float  # rad/s
    gyro_bias_initial: float  # rad/s, 1 sigma at switch-on
    gyro_bias_wide: float  # rad/s, the same where the worst parts of the kind have to be covered
    gyro_scale: float  # 1 sigma
    gyro_misalignment: float  # rad, 1 sigma: cross-axis sensitivity
    gyro_range: float  # rad/s
    accel_noise: float  # velocity random walk, (m/s^2)/sqrt(Hz)
    accel_bias_instability: float  # m/s^2
    accel_bias_initial: float  # m/s^2, 1 sigma at switch-on
    accel_scale: float
    accel_range: float  # m/s^2


_DEG = math.radians(1.0)
_HOUR = 3600.0
_MG = 1e-3 * STANDARD_GRAVITY

PROFILES = {
    # Epson M-G350-PD11 data sheet, in its units: ARW 0.2 deg/sqrt(h), VRW 0.04 (m/s)/sqrt(h), scale factor +-0.5 %,
    # misalignment 0.1 deg
    "m-g350": Profile(
        gyro_noise=0.2 * _DEG / math.sqrt(_HOUR),
        gyro_bias_instability=6.0 * _DEG / _HOUR,
        gyro_bias_initial=0.5 * _DEG,
        gyro_bias_wide=0.5 * _DEG,
        gyro_scale=0.005,
        gyro_misalignment=0.1 * _DEG,
        gyro_range=300.0 * _DEG,
        accel_noise=0.04 / math.sqrt(_HOUR),
        accel_bias_instability=0.1 * _MG,
        accel_bias_initial=8.0 * _MG,
        accel_scale=0.005,
        accel_range=3.0 * STANDARD_GRAVITY,
    ),
    # a phone- or drone-class part of unknown make: ten times the noise, and biases that need a wide prior
    # (one real unit in our recordings had 4.5 deg/s); misalignment in proportion to the M-G350's. Data sheets allow 20
    # (MPU-6050), 10 (LSM6DS) or 5 deg/s (ICM-20948): three times the wide sigma, which counts once readings show such a
    # part; from the start on, steps of the gyro's bias would be found too late
    "consumer-mems": Profile(
        gyro_noise=0.01 * _DEG,
        gyro_bias_instability=20.0 * _DEG / _HOUR,
        gyro_bias_initial=2.0 * _DEG,
        gyro_bias_wide=7.0 * _DEG,
        gyro_scale=0.01,
        gyro_misalignment=0.0035,
        gyro_range=2000.0 * _DEG,
        accel_noise=2e-3,
        accel_bias_instability=0.5 * _MG,
        accel_bias_initial=30.0 * _MG,
        accel_scale=0.01,
        accel_range=16.0 * STANDARD_GRAVITY,
    ),
}
# Freescale MMA7260QT on SparkFun's serial accelerometers: 0.35 mg/sqrt(Hz) up to 350 Hz, which sampling at 50/s turns
# into 8 mg a sample; the zero-g offset that a hand calibration leaves. It has no gyro to describe
PROFILES["mma7260"] = replace(
    PROFILES["consumer-mems"],
    accel_noise=8.0 * _MG / math.sqrt(50.0),
    accel_bias_instability=2.0 * _MG,
    accel_bias_initial=30.0 * _MG,
    accel_scale=0.03,
    accel_range=6.0 * STANDARD_GRAVITY,
)
# Crossbow DMU RGA300CA: its own figures are not published; the data sheet of the maker's AHRS400 of the same years has
# ARW < 2.25 deg/sqrt(h), VRW < 0.1 (m/s)/sqrt(h), gyro bias < 1 deg/s, in-run 0.05 deg/s, accelerometers 8.5 mg,
# scale factors < 1 %; misalignment in proportion to the M-G350's
PROFILES["crossbow-dmu"] = Profile(
    gyro_noise=2.25 * _DEG / math.sqrt(_HOUR),
    gyro_bias_instability=0.05 * _DEG,
    gyro_bias_initial=1.0 * _DEG,
    gyro_bias_wide=1.0 * _DEG,
    gyro_scale=0.01,
    gyro_misalignment=0.2 * _DEG,
    gyro_range=100.0 * _DEG,
    accel_noise=0.1 / math.sqrt(_HOUR),
    accel_bias_instability=0.5 * _MG,
    accel_bias_initial=8.5 * _MG,
    accel_scale=0.01,
    accel_range=2.0 * STANDARD_GRAVITY,
)
# Epson M-G320, M-G354, M-G362 and later: no data sheet of their noise at hand, only that they succeeded the M-G350; so
# its noise, with the widest ranges among them
PROFILES["epson-windowed"] = replace(PROFILES["m-g350"], gyro_range=450.0 * _DEG, accel_range=10.0 * STANDARD_GRAVITY)

DEFAULT = "consumer-mems"


# settings.noise: key, what it replaces, its unit in SI
_OVERRIDES = (
    ("gyro_random_walk_deg_per_sqrt_h", "gyro_noise", _DEG / math.sqrt(_HOUR)),
    ("gyro_bias_instability_deg_per_h", "gyro_bias_instability", _DEG / _HOUR),
    ("gyro_bias_initial_dps", "gyro_bias_initial", _DEG),
    ("gyro_scale_percent", "gyro_scale", 0.01),
    ("gyro_misalignment_percent", "gyro_misalignment", 0.01),
    ("accel_random_walk_mps_per_sqrt_h", "accel_noise", 1.0 / math.sqrt(_HOUR)),
    ("accel_bias_instability_mg", "accel_bias_instability", _MG),
    ("accel_bias_initial_mg", "accel_bias_initial", _MG),
    ("accel_scale_percent", "accel_scale", 0.01),
)


def profile_of(settings: Settings) -> Profile:
    """The profile that the settings name, that of an unknown sensor for "auto", with the user's values."""
    name = settings.imu.profile
    profile = PROFILES[DEFAULT if name == "auto" else name]
    known = {field: value * unit for key, field, unit in _OVERRIDES if (value := getattr(settings.noise, key))}
    if "gyro_bias_initial" in known:
        known["gyro_bias_wide"] = known["gyro_bias_initial"]
    return replace(profile, **known, **ranges_of(settings))


def ranges_of(settings: Settings) -> dict[str, float]:
    """The ranges that the user gives, SI, by the names that profiles have for them."""
    given = {
        "gyro_range": settings.imu.gyro_range_dps * _DEG,
        "accel_range": settings.imu.accel_range_g * STANDARD_GRAVITY,
    }
    return {name: value for name, value in given.items() if value > 0.0}


@dataclass(frozen=True)
class SampleSigma:
    """What one sample of a sensor's three axes is worth, 1 sigma, SI."""

    white: float  # noise of a single sample
    bias: float  # at switch-on
    scale: float  # share of the value: scale factor and misalignment


def sample_sigmas(profile: Profile, rate_hz: float) -> tuple[SampleSigma, SampleSigma]:
    """Of the gyros and of the accelerometers; white noise fills half of `rate_hz`."""
    root = math.sqrt(rate_hz)
    return (
        SampleSigma(profile.gyro_noise * root, profile.gyro_bias_initial, profile.gyro_scale),
        SampleSigma(profile.accel_noise * root, profile.accel_bias_initial, profile.accel_scale),
    )
