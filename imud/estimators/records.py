"""The records that estimators read and write: a GNSS fix, a solution, an innovation. SI units, radians, NED, FRD."""

import numpy as np

FIX = np.dtype(
    [
        ("t_ns", "<i8"),  # epoch of the fix on the estimator's time axis
        ("arrival_ns", "<i8"),  # when it became known
        ("lat", "<f8"),  # rad, WGS-84
        ("lon", "<f8"),  # rad
        ("height", "<f8"),  # m above the ellipsoid; NaN: unknown
        ("sigma", "<f8", (3,)),  # m, 1 sigma north, east, down; NaN: unknown
        ("hdop", "<f8"),  # NaN: unknown
        ("v", "<f8", (3,)),  # m/s, NED; NaN where unknown (NMEA gives none)
        ("speed", "<f8"),  # m/s over ground; NaN: unknown
        ("course", "<f8"),  # rad from true north; NaN: unknown
        ("quality", "<i8"),  # as NMEA GGA: 1 GPS, 2 differential, 4 RTK fixed, 5 RTK float, 6 dead reckoning
        ("satellites", "<i8"),  # in use; -1: unknown
        ("sigma_v", "<f8", (3,)),  # m/s, 1 sigma of v; NaN or 0: unknown
        ("flags", "<i8"),  # NEW_RECEIVER or 0
    ],
    align=True,
)
NEW_RECEIVER = 1  # the first fix of a connection: of another receiver, or of one that was away

MEASUREMENT = np.dtype(  # of an aiding source other than GNSS
    [
        ("t_ns", "<i8"),  # epoch on the estimator's time axis
        ("arrival_ns", "<i8"),  # when it became known: fed then, fused at t_ns
        ("kind", "<i8"),  # code of the source, see below
        ("value", "<f8", (6,)),  # SI units; the source's file says which
        ("sigma", "<f8", (4,)),  # 1 sigma of each; NaN: unknown
    ],
    align=True,
)

SOURCE_KINDS = 8  # number of the codes below; arrays by source have this length
(
    GNSS_FIX,
    HEADING_SOURCE,
    ODOMETER_SOURCE,
    BAROMETER_SOURCE,
    POSE_SOURCE,
    VELOCITY_SOURCE,
    BODY_VELOCITY_SOURCE,
    MAGNETOMETER_SOURCE,
) = range(SOURCE_KINDS)
# places in `value`: of a pose, of the odometer, of the earth's field behind that of the magnetometer
LAT_VALUE, LON_VALUE, HEIGHT_VALUE, YAW_VALUE = range(4)
SPEED_VALUE, DIFFERENCE_VALUE = range(2)
EARTH_NORTH_VALUE, EARTH_EAST_VALUE, EARTH_DOWN_VALUE = 3, 4, 5

SOLUTION = np.dtype(
    [
        ("t_ns", "<i8"),
        ("status", "<i8"),  # bits below
        ("lat", "<f8"),  # rad; NaN without POSITION_VALID, like height and v
        ("lon", "<f8"),  # rad
        ("height", "<f8"),  # m above the ellipsoid; arbitrary without HEIGHT_VALID
        ("v", "<f8", (3,)),  # m/s, NED
        ("q_nb", "<f8", (4,)),  # Hamilton, scalar first, rotates body vectors into NED
        ("w", "<f8", (3,)),  # rad/s, body, bias removed
        ("f", "<f8", (3,)),  # m/s^2, body specific force, bias removed
        ("bg", "<f8", (3,)),  # rad/s gyro bias
        ("ba", "<f8", (3,)),  # m/s^2 accelerometer bias
        ("sigma_p", "<f8", (3,)),  # m, 1 sigma NED
        ("sigma_v", "<f8", (3,)),  # m/s
        ("sigma_rpy", "<f8", (3,)),  # rad, of roll, pitch, yaw
        ("sigma_bg", "<f8", (3,)),
        ("sigma_ba", "<f8", (3,)),
    ],
    align=True,
)

ATTITUDE_VALID = 1  # roll and pitch may be trusted to their sigmas
HEADING_VALID = 2  # so may yaw, against true north; otherwise its origin is arbitrary
POSITION_VALID = 4  # so may latitude, longitude and velocity
AT_REST = 8
COASTING = 16  # position without a recent fix
REJECTING = 32  # fixes come, and contradict the estimate
SATURATED = 64  # the inertial sensor is at the end of its range
HEIGHT_VALID = 128  # the height may be trusted to its sigma; never set without POSITION_VALID

INNOVATION = np.dtype(
    [
        ("t_ns", "<i8"),
        ("kind", "<i8"),  # one of the codes below
        ("value", "<f8"),  # measured minus predicted
        ("variance", "<f8"),  # predicted variance of `value`
        ("used", "<i8"),  # 1 fused, 0 rejected by its gate
    ],
    align=True,
)

PENDING_MAX = 1024  # innovations of steps that an estimator keeps until they are asked for, at most
PENDING_INNOVATIONS = np.dtype([("rows", INNOVATION, (PENDING_MAX,)), ("count", "<i8")], align=True)

POSITION_N, POSITION_E, POSITION_D, VELOCITY_N, VELOCITY_E, VELOCITY_D, HEADING = range(7)
# pseudo-measurements, of rest and of the non-holonomic constraint; a new kind goes behind the last one below
REST_N, REST_E, REST_D, REST_X, REST_Y, REST_Z, NHC_LATERAL, NHC_VERTICAL = range(7, 15)
ASSUMED = range(REST_N, NHC_VERTICAL + 1)
ODOMETER, BAROMETER = 15, 16
REST_POSITION_X, REST_POSITION_Y, REST_POSITION_Z = 17, 18, 19  # of `stationary`, to which they are measurements
POSE_N, POSE_E, POSE_D, POSE_YAW = range(20, 24)
EXTERNAL_VN, EXTERNAL_VE, EXTERNAL_VD, EXTERNAL_VX, EXTERNAL_VY, EXTERNAL_VZ = range(24, 30)
MAGNETOMETER, WHEEL_YAW_RATE = 30, 31
