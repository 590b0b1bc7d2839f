"""The inertial sample: the output of every driver of an inertial sensor, in SI units and the sensor's FRD axes.

A level sensor at rest shows f = (0, 0, -g): specific force, not gravity. Drivers write rows of a preallocated
array of `SAMPLE`. `t_ns` is written later by the clock, which fits `tick` (counter wraps removed, lost samples counted)
to the host's time; `outage_s` and the flags of invalid and saturated axes are written by
`imud/sensor_monitor/health.py`, RECONNECTED and, but for what a driver sees in the stream, POWER_ON by the pipeline,
MOUNTING_UNKNOWN by the calibration.
"""

import numpy as np

STANDARD_GRAVITY = 9.80665  # m/s^2, the unit "g"

SAMPLE = np.dtype(
    [
        ("t_ns", "<i8"),  # time of the sample on the estimator's axis; written by the clock
        ("tick", "<i8"),  # device counter since the first sample, in `ImuConfigured.period_ns`
        ("w", "<f8", (3,)),  # angular rate of the body against inertial space, rad/s
        ("f", "<f8", (3,)),  # specific force, m/s^2
        ("down", "<f8", (3,)),  # unit vector down as the device itself computed it; zeros where it does not
        ("temperature", "<f8"),  # degC, NaN where the sensor has none
        ("flags", "<i8"),  # bits below
        ("outage_s", "<f8"),  # s since rates, or forces, were last credible; written by the sensor monitor
    ],
    align=True,
)

SUSPECT = 1  # an outlier among its neighbours, probably damaged on the wire; use the last good sample instead
SATURATED = 2  # an axis is at the end of its range
DEVICE_ERROR = 4  # the sensor reports a fault
NO_RATE = 8  # the rates are invalid: an axis is frozen or has impossible values
NO_FORCE = 16  # the forces are invalid
LIMITED_RATE = 32  # a gyro is saturated
LIMITED_FORCE = 64  # an accelerometer is saturated
POWER_ON = 128  # the sensor may have been switched on since the sample before: its biases may have changed
LIMITED_AXES = 512  # the x axis of the gyro is saturated; y and z: shifted left by 1 and 2
NO_RATE_AXES = 4096  # with NO_RATE: the x axis is invalid; y and z: shifted left by 1 and 2; none: all
RECONNECTED = 256  # the first sample of a later connection: the sensor may have been moved since the one before
MOUNTING_UNKNOWN = 32768  # the sensor's axes against the body's are not known
UNCONFIRMED_RATE = 65536  # gravity does not turn as the rates say, and it is not yet known that they are in rad/s
UNUSABLE = SUSPECT | NO_RATE | NO_FORCE  # a part of the sample is invalid
