"""The records of the navigation filter: its parameters, its core (what a snapshot holds), its bank of hypotheses of the
heading's drift, and its whole state.

Errors are "true minus estimate", 26 of them: position NED m, velocity m/s, attitude (small rotation in NED,
C_true = exp(phi) C), gyro bias, accelerometer bias, slowly wandering GNSS position error (Gauss-Markov), mounting
pitch and yaw of the vehicle's forward axis, latency of the fixes, what the gyro shows too much per rate of turn about
the vertical (the column of scale factors and misalignments that a vehicle's drive shows), how far the sensor is ahead
of the point about which the vehicle turns, and by how much longer than the position the receiver's velocity is behind.
"""

import numpy as np

from ..records import INNOVATION

STATES = 26
POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCEL_BIAS, WANDER = 0, 3, 6, 9, 12, 15
MOUNT_PITCH, MOUNT_YAW, LATENCY, TURN_SCALE, ARM, LAG = 18, 19, 20, 21, 24, 25

LEVELLING, NAVIGATING = 0, 1  # phases: roll and pitch only, position from GNSS; everything
FREE, AUTO, LAND = 0, 1, 2  # vehicle

RATES = 33  # hypotheses of the heading's drift while aligning
ASTRAY = 3  # pairs of fixes in a row that contradict the heading: it is wrong
NEVER_NS = -(1 << 62)  # a time before all others
RING = 4096  # samples kept: 2 s at the highest rate
SNAPSHOTS = 64
SNAPSHOT_NS = 50_000_000
MOMENTS = 3  # at which the receiver may have begun to creep
SPREAD = 10  # most nonzero elements of a measurement row
TOLD, UNREAD = 8, 1024  # innovations of one sample: a window of rest and a constraint; and those kept until asked for

PARAMETERS = np.dtype(
    [
        ("period", "<f8"),  # s, nominal time between samples
        ("lever", "<f8", (3,)),  # m, antenna from IMU, body
        ("vehicle", "<i8"),
        ("latency", "<f8"),  # s, from epoch to arrival where the epoch is only assumed
        ("gyro_psd", "<f8"),  # rad^2/s
        ("gyro_walk", "<f8"),  # rad^2/s^3
        ("gyro_initial", "<f8"),  # rad/s
        ("gyro_scale", "<f8"),
        ("gyro_range", "<f8"),  # rad/s
        ("accel_psd", "<f8"),  # m^2/s^3
        ("accel_walk", "<f8"),  # m^2/s^5
        ("accel_initial", "<f8"),  # m/s^2
        ("accel_scale", "<f8"),
        ("accel_range", "<f8"),  # m/s^2
    ],
    align=True,
)

CORE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("taken", "<i8"),  # samples integrated since the start
        ("phase", "<i8"),
        ("flags", "<i8"),  # AT_REST, REJECTING, SATURATED of records
        # nominal state
        ("lat", "<f8"),
        ("lon", "<f8"),
        ("height", "<f8"),
        # what depends on the place, as `locate` finds it: where that was, its latitude's sine, cosine and tangent, rad
        # that a metre is along the meridian, in the prime vertical and in longitude, and gravity
        ("located", "<f8", (2,)),
        ("sine", "<f8"),
        ("cosine", "<f8"),
        ("tangent", "<f8"),
        ("meridional", "<f8"),
        ("vertical", "<f8"),
        ("longitudinal", "<f8"),
        ("gravity", "<f8"),
        ("v", "<f8", (3,)),  # m/s, NED
        ("q", "<f8", (4,)),  # q_nb; while levelling the heading's origin is arbitrary
        ("bg", "<f8", (3,)),
        ("ba", "<f8", (3,)),
        ("wander", "<f8", (3,)),  # m, NED, fix minus truth
        ("forward", "<f8", (3,)),  # unit vector of the vehicle's motion in the body
        ("lateral", "<f8", (3,)),  # unit vector across it, level
        ("arm", "<f8"),  # m, of the sensor ahead of the axle that does not slip sideways
        ("turn_scale", "<f8", (3,)),  # body, gyro error per rate of turn about the vertical
        ("latency", "<f8"),  # s, the fix is older than its stamp by this
        ("lag", "<f8"),  # s, and its velocity is older still
        ("P", "<f8", (STATES * (STATES + 1) // 2,)),
        # last sample, body axes, and what has gathered since the last covariance step
        ("w", "<f8", (3,)),
        ("f", "<f8", (3,)),
        ("blind_s", "<f8", (2,)),  # s for which rates, and forces, have told nothing, or not enough
        ("gathered", "<f8"),  # s
        ("dv", "<f8", (3,)),  # m/s, integral of specific force in NED
        ("turned", "<f8", (3,)),  # rad, integral of the body's rate
        ("owed", "<f8"),  # rad, turned about the vertical without turn_scale, until it is notable
        ("accel", "<f8", (3,)),  # m/s^2, smoothed acceleration in NED
        ("rate", "<f8", (3,)),  # rad/s, smoothed rate of the body
        ("excess", "<f8", (3,)),  # rad/s, turn_scale times the smoothed rate of turn: for the solution
        # motion window
        ("n", "<i8"),
        ("elapsed", "<f8"),  # s
        ("sum_w", "<f8", (3,)),
        ("sum_f", "<f8", (3,)),
        ("sum_n", "<f8", (3,)),  # m/s, integral of specific force in NED
        ("sum_w2", "<f8"),
        ("sum_f2", "<f8"),
        ("sum_jump2", "<f8", (2,)),  # of differences between successive rates, and specific forces
        ("mean_w", "<f8", (3,)),  # of the last complete window
        ("mean_f", "<f8", (3,)),
        ("fitful", "<f8", (2,)),  # rad^2/s^3, m^2/s^5: most that these have changed of late, squared, per s
        ("quiet", "<i8"),  # complete quiet windows in a row
        ("still", "<i8"),  # and still ones
        ("manner", "<f8", (2, 3)),  # at rest and in slow motion: count, mean and variance of the log gyro deviation
        ("evidence", "<f8"),  # of rest, by these: log likelihood ratio
        ("floor", "<f8"),  # rad/s, quietest gyro deviation seen
        ("shaking", "<f8"),  # 0 to 1, how much of a vehicle's vibration there is
        ("vibration_accel", "<f8"),  # m^2/s^3, noise density added by vibration
        ("vibration_gyro", "<f8"),  # rad^2/s
        # non-holonomic constraint
        ("since_constraint", "<f8"),  # s
        ("constrained", "<i8"),
        ("spread", "<f8", (6,)),  # sum of squares and products of the normalised velocity in the body, upper triangle
        ("axis", "<f8", (3,)),  # unit vector of its main direction
        ("ground", "<f8", (3,)),  # the same over ground
        ("down", "<f8", (3,)),  # sum of the vertical in the body
        ("axis_n", "<f8"),
        ("contradiction", "<f8"),  # smoothed normalised innovation squared
        ("loose", "<f8", (2,)),  # variance of the velocity sideways and off the floor, over that assumed
        ("strain", "<f8", (2, 2)),  # sums of their innovations and of the variances of those
        ("strained", "<i8"),  # innovations in these
        ("strains", "<i8"),  # sums that were learned from
        ("before", "<f8", (STATES,)),  # variances as the constraint began
        ("stops", "<i8"),  # times that the motion has contradicted
        ("stopped_ns", "<i8"),  # and the last of them
        # fixes
        ("fix_ns", "<i8"),  # epoch of the last one used
        ("fixes", "<i8"),
        ("fix_speed", "<f8"),  # m/s, NaN unknown
        ("rejected", "<i8", (2,)),  # positions in a row, and heights
        ("refused_ns", "<i8", (2,)),  # the first of them, or of those that keep to the velocity
        ("refused_after_s", "<f8"),  # since the last fix used, when the first was refused
        ("refused", "<f8", (2,)),  # m, how far north and east of the estimate that was
        ("creeping", "<i8"),  # the receiver has been found to
        ("restless", "<f8"),  # square of its wander as it has seemed, over that reported
        ("supposed", "<i8"),  # times that was learned
        ("seemed", "<f8"),  # the same of the last moment that passed, to be learned with the next
        ("since_ns", "<i8", (MOMENTS,)),  # from when it may have crept
        ("supposed_n", "<i8", (MOMENTS,)),  # innovations since
        ("evidence_creep", "<f8", (MOMENTS, 2)),  # s/m, of a velocity north and east
        ("information", "<f8", (MOMENTS, 3)),  # s^2/m^2, upper triangle
        ("pull", "<f8", (STATES, 2 * MOMENTS)),  # of the estimate, per m/s, north and east for each moment
        ("held", "<f8", (2,)),  # latitude and longitude that the receiver told last
        ("held_ns", "<i8"),  # and since when
        ("surveyed", "<i8"),  # their epochs are a survey's, not confirmed yet
        ("contrary", "<i8"),  # fixes in a row whose velocity was rejected
        ("doubt", "<f8", (3,)),  # m^2, beyond P: how far the fixes were that the filter gave in to, fading
        ("lost", "<f8"),  # times that the filter gave in to contradicting fixes, fading
        ("white", "<f8", (2,)),  # m^2, learned white variance, horizontal and vertical
        ("white_speed", "<f8"),  # m^2/s^2, learned variance of a component of its velocity
        ("wandering", "<f8", (2,)),  # m, sigma of the wander
        ("reported", "<f8", (2,)),  # m, the sigma the wander was last scaled to
        ("z", "<f8", (3,)),  # scratch: position residuals
        ("trend", "<f8", (3,)),  # scratch: m/s^2, acceleration over the uncertain part of the latency
        ("bend", "<f8", (3,)),  # scratch: m/s, how far the velocity was from that line
        # alignment, in a level frame of arbitrary heading
        ("heading_sigma", "<f8"),  # rad, of a heading given by the user; 0: none
        ("heading_age", "<f8"),  # s, what an error of the vertical gyro bias has been multiplied with in that found
        ("running", "<f8", (4, 2)),  # integrals since the origin, complex: of level specific force, of 1, GG, G
        ("twice", "<f8", (4, 2)),  # and theirs
        ("swing", "<f8", (2,)),  # exp(i y), y rad the heading of the body in the frame of those
        ("frame", "<f8"),  # rad, from the level frame of q to that one
        ("drifted", "<f8"),  # rad, by which that one would have turned without the vertical gyro bias found
        ("frame_rate", "<f8"),  # rad/s, vertical gyro bias found since the origin
        ("shifted", "<f8", (3, 2)),  # m/s^2, m/s^3, m/s^2: tilt, level gyro bias and accelerometer bias, likewise
        ("mark_ns", "<i8"),  # last fix used for alignment
        ("mark", "<f8", (6,)),  # its velocity, latitude and longitude, and the acceleration
        ("marked", "<f8", (4, 2)),  # running and twice then
        ("marked_twice", "<f8", (4, 2)),
        ("slope", "<f8", (3,)),  # mean velocity over the last pair of positions, and its s; 0: there is none
        ("means", "<f8", (4, 2)),  # and of running
        ("pair", "<f8", (4, 2)),  # scratch: changes of running
        ("calm", "<f8", (2,)),  # latitude and longitude of the first fix since the sensor has been quiet
        ("calm_ns", "<i8"),
        ("origin_ns", "<i8"),
        ("base", "<f8", (2,)),  # latitude and longitude from which the places of fixes are counted
        ("matched_ns", "<i8"),  # last fix matched
        ("refusals", "<i8"),  # fixes in a row that were not felt
        ("astray", "<i8"),  # pairs in a row that contradict the heading
        ("told", INNOVATION, (TOLD,)),  # what the last sample brought that was not a fix
        ("telling", "<i8"),  # rows of it
        # scratch
        ("x", "<f8", (STATES,)),
        ("d", "<f8", (STATES,)),
        ("columns", "<i8", (SPREAD,)),
        ("values", "<f8", (SPREAD,)),
    ],
    align=True,
)

BANK = np.dtype(
    [
        (
            "running",
            "<f8",
            (RATES, 4, 2),
        ),  # as the core's, up to the last fix matched, turned back
        ("twice", "<f8", (RATES, 4, 2)),
        ("followed", "<f8", (RATES, 3, 5, 2)),  # place, velocity, wander: what `whitening` makes of fixes and these
        ("whitener", "<f8", (3, 3)),  # and their covariance, m, s
        ("products", "<f8", (RATES, 5, 5, 2)),  # sums of those of dV, dz and the three regressors
        ("weight", "<f8"),  # innovations matched
        ("squares", "<f8"),  # sum of squares of the single energies of dV
        ("aged", "<f8"),  # s, the energy of dV times its age
        ("before", "<f8", (4, 2)),  # the core's integrals then
        ("before_twice", "<f8", (4, 2)),
        # scratch
        ("left", "<f8", (5, 2)),  # innovations
        ("prior", "<f8", (3, 3, 2)),
        ("inverse", "<f8", (3, 3, 2)),
        ("gain", "<f8", (3, 3, 2)),
        ("headings", "<f8", (RATES, 3)),
    ],
    align=True,
)

SAMPLE_KEPT = np.dtype(
    [("t_ns", "<i8"), ("w", "<f8", (3,)), ("f", "<f8", (3,)), ("flags", "<i8"), ("unseen_s", "<f8")], align=True
)

STATE = np.dtype(
    [
        ("core", CORE, (1,)),
        ("bank", BANK, (1,)),  # changes with fixes only, so that no snapshot needs it
        ("snapshots", CORE, (SNAPSHOTS,)),
        ("ring", SAMPLE_KEPT, (RING,)),
        ("snapped", "<i8"),  # snapshots ever taken, less those withdrawn
        ("received", "<i8"),  # samples ever put into the ring
        ("stamp_ns", "<i8"),  # stamp of the last fix fused
        ("latency", "<f8"),  # s, as found at that fix
        ("fused_ns", "<i8"),  # and the time of the core at which it was fused
        ("initial_rpy", "<f8", (3,)),  # rad, NaN where the first sample or motion must tell
        ("w", "<f8", (3,)),  # last good sample, body axes
        ("f", "<f8", (3,)),
        ("unread", INNOVATION, (UNREAD,)),
        ("waiting", "<i8"),  # rows of it
        ("between_w", "<f8", (3,)),  # scratch: the sample interpolated at a fix
        ("between_f", "<f8", (3,)),
    ],
    align=True,
)
