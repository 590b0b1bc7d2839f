"""The error states of the navigation filter, its modes, and the sizes of its records.

Error states are "true minus estimate", 40 of them, in the order of the table below. The attitude error is a small
rotation phi in navigation axes, C_true = exp(phi) C.

| error state            | unit    | what it is |
|------------------------|---------|------------|
| POSITION (3)           | m       | north, east, down |
| VELOCITY (3)           | m/s     | north, east, down |
| ATTITUDE (3)           | rad     | small rotation about north, east, down |
| GYRO_BIAS (3)          | rad/s   | body axes |
| ACCEL_BIAS (3)         | m/s^2   | body axes |
| GNSS_BIAS (3)          | m       | correlated error of the receiver's position, first-order Gauss-Markov, NED |
| MOUNT_PITCH, MOUNT_YAW | rad     | of the vehicle's forward axis in the body |
| TIME_OFFSET            | s       | by which a fix is older than its epoch says |
| GYRO_SCALE (9)         | rad/rad | scale factors and misalignments of the gyros: error about each body axis per rate about x, then y, then z |
| NHC_LEVER_ARM          | m       | of the sensor ahead of the point about which the vehicle turns |
| VELOCITY_TIME_OFFSET   | s       | by which the receiver's velocity is older than its position |
| ODOMETER_SCALE         |         | by which the odometer's reading is too large, as a share of the speed |
| BARO_OFFSET            | m       | by which the barometer's height is too large |
| GNSS_VELOCITY_BIAS (3) | m/s     | correlated error of the receiver's velocity, first-order Gauss-Markov, NED |
| GNSS_LEVER_ARM (3)     | m       | of the antenna from the IMU, body axes |
"""  # noqa: E501 a table's row is one line

STATES = 40
POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCEL_BIAS, GNSS_BIAS = 0, 3, 6, 9, 12, 15
MOUNT_PITCH, MOUNT_YAW, TIME_OFFSET, GYRO_SCALE, NHC_LEVER_ARM, VELOCITY_TIME_OFFSET = 18, 19, 20, 21, 30, 31
ODOMETER_SCALE, BARO_OFFSET, GNSS_VELOCITY_BIAS, GNSS_LEVER_ARM = 32, 33, 34, 37

COARSE_ALIGNMENT, NAVIGATING = 0, 1  # modes: roll and pitch only, position from GNSS; everything
FREE, AUTO, LAND = 0, 1, 2  # vehicle
# epochs of fixes: of a receiver at work; of a survey: at first; once they are confirmed
REPORTED_EPOCHS, UNCONFIRMED_EPOCHS, EXACT_EPOCHS = 0, 1, 2

# axis of an update, for the GLR tests
POSITION_AXIS, VELOCITY_AXIS = 0, 2  # of a GNSS position and velocity north; + 1: east
OTHER_AXIS, HEADING_AXIS, COMPASS_AXIS = -1, -2, -3  # none of these, a heading, one of the heading source
CONSTRAINT_AXIS = -4  # of the non-holonomic constraint
BODY_VELOCITY_AXIS = -5  # of another system, in its own axes
DOWN_VELOCITY_AXIS = -6  # of a GNSS velocity
HEADING_BORESIGHT, VELOCITY_BORESIGHT, BORESIGHTS = 0, 1, 4  # error states beside P: see `boresights`
# places in small arrays
HORIZONTAL, VERTICAL = 0, 1  # of what a receiver's position has
VELOCITY_NOISE, ATTITUDE_NOISE = 0, 1  # of the learned process noise
RATES, FORCES = 0, 1  # of what a sample has
NN, NE, EE, NH, EH, HH = range(6)  # of information about north, east and, where it is sought, the heading
HYPOTHESES = 33  # of the rate at which the level frame rotates during alignment
VECTORS = 12  # pairs of vectors kept, from which roll and pitch are found in motion
NEVER_NS = -(1 << 62)  # a time before all others
IMU_RING = 4096  # samples kept: 2 s at the highest rate
SNAPSHOTS = 64
SNAPSHOT_NS = 50_000_000
GYRO_BIAS_ONSETS = 4  # times at which the gyro bias may have stepped
IMU_BIAS_ONSETS, IMU_BIAS_HYPOTHESES = 3, 6  # the same of all biases; these times the two sensors
CHORD_POINTS = 33  # of the comparison of a receiver's velocity with its positions
ONSETS = 3  # times at which the receiver may have begun to drift
# columns of the sensitivities to faults: see `glr_tests.fault_sensitivity`; the last ones are empty, as rows of whole
# vectors of four are faster
DRIFT_FAULT, TIME_STEP_FAULT, GYRO_STEP_FAULT, COMPASS_FAULT, IMU_STEP_FAULT = 0, 6, 7, 11, 12
CURRENT_FAULT, VELOCITY_DRIFT_FAULT, FAULTS = 30, 32, 44
LEVER_ARM_FAULT = VELOCITY_DRIFT_FAULT  # where there are no wheels
AIDING_RING = 256  # measurements kept: 2 s of sources of 100 Hz
AGES, NO_AGE, AGE_STEP_NS = 21, 5, 100_000_000  # ages of a source: -0.5 to 1.5 s; which of them is none
BANKS = 32  # fixes of which the hypothesis bank is kept: 2 s of 16 Hz; each takes 29 kB
STATED = 15  # error states whose sigmas every solution has: position, velocity, attitude and the IMU's biases
LEARNING_STATES = 9  # of the filter that learns process noise: position, velocity, attitude
EXPONENTIALS = 4  # remembered: decays of the receiver's two biases, process noise of velocity and attitude
JACOBIAN_LENGTH = 13  # most nonzero elements of a row of H
STEP_INNOVATIONS = 8  # of one sample: a window of rest and a constraint
