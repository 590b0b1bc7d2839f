"""Every tunable of the attitude filter: name, default, unit, meaning, source of the default.

"BROAD" are hand-held recordings with optical truth: Laidig, Caruso, Cereatti and Seel, BROAD: A benchmark for robust
inertial orientation estimation (2021).
"""

from ..tuning import Tunable

TUNABLES = (
    Tunable(
        "gyro_noise_per_rate",
        6e-4,
        "sqrt(s)",
        "Gyro noise density in proportion to the angular rate.",
        "Found on BROAD.",
    ),
    Tunable(
        "gyro_bias_walk_per_acceleration",
        4.5e-5,
        "(rad/s)/(m/s^2)/sqrt(s)",
        "Random walk of the gyro bias in proportion to the acceleration (g-sensitivity).",
        "Found on BROAD.",
    ),
    Tunable(
        "accel_noise_per_acceleration",
        0.02,
        "sqrt(s)",
        "Accelerometer noise density in proportion to the acceleration.",
        "Found on BROAD.",
    ),
    Tunable(
        "shock_rotation",
        0.01,
        "rad/(m/s)",
        "Rotation, not resolved by the gyro, that comes with a velocity change too short to be sampled.",
        "Found on BROAD (tapping).",
    ),
)
