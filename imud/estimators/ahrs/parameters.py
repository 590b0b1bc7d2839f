"""Every tunable of the attitude filter: name, default, unit, meaning, source of the default.

Sources that recur:
- BROAD: chosen for the smallest errors on hand-held recordings with optical truth: Laidig, Caruso, Cereatti and Seel,
  BROAD: A benchmark for robust inertial orientation estimation (2021).
- Vehicles: chosen on simulated drives, so that the errors stay within their sigmas (tests/test_attitude_motion.py).
- Hands: chosen on simulated hands, walks and drives (tests/test_attitude_step.py); hands that shake by 15 m/s^2
  gain 4 m/s at most, and 2 to 4 times as much as they usually do (BROAD, RepoIMU).
- Simulated: chosen on simulated walks and flights that begin in motion (tests/attitude_monte_carlo.py): the least that
  keeps their errors within their sigmas.
- Even starts: chosen on simulated trains, cars, ships, lifts and turntables that move evenly when the filter starts
  (tests/attitude_even_starts.py).
- Mixed: chosen on the same motions after a rest, and those that change from one to another.
- Flights: chosen on simulated multicopters, and other vehicles, with drag and wind (tests/test_attitude_drag.py).
- Not recorded: a round number whose origin nobody wrote down. docs/ahrs.md has how much each one matters.
"""

import math

from ..tuning import Tunable

BROAD, VEHICLES, HANDS, SIMULATED, UNRECORDED = "BROAD.", "Vehicles.", "Hands.", "Simulated.", "Not recorded."
EVEN, MIXED, FLIGHTS = "Even starts.", "Mixed.", "Flights."

_FILTER = (
    Tunable(
        "covariance_interval_s",
        0.049,
        "s",
        "Time between updates of the covariance.",
        "BROAD; 0.025 to 0.1 s give the same.",
        low=1e-3,
        high=1.0,
    ),
    Tunable("long_gap_s", 1.0, "s", "After an outage so long roll and pitch are initialised anew.", UNRECORDED),
    Tunable("valid_tilt_rad", math.radians(10.0), "rad", "Least sigma of tilt without ATTITUDE_VALID.", UNRECORDED),
    Tunable("valid_heading_rad", math.radians(20.0), "rad", "Least sigma of yaw without HEADING_VALID.", UNRECORDED),
)

_SENSOR = (
    Tunable("gap_periods", 1.5, "", "A step of more sample periods is a gap.", UNRECORDED),
    Tunable("gravity_spread", 0.0015, "", "Sigma of gravity on earth, over standard gravity.", "WGS-84, 0 to 60 deg."),
    Tunable(
        "accel_bias_time_s",
        100.0,
        "s",
        "Time in which the accelerometer bias changes by its instability.",
        UNRECORDED,
        low=1e-3,
    ),
    Tunable("accel_delay_sigma_s", 0.003, "s", "Sigma of the accelerometer's delay behind the gyro.", UNRECORDED),
    Tunable("mean_rate_noise", 3.0, "", "Noise of the mean rate at rest, over that of the gyro.", UNRECORDED),
)

_PROCESS_NOISE = (
    Tunable("gyro_noise_per_rate", 6e-4, "sqrt(s)", "Gyro noise density in proportion to the angular rate.", BROAD),
    Tunable(
        "gyro_bias_walk_per_acceleration",
        4.5e-5,
        "(rad/s)/(m/s^2)/sqrt(s)",
        "Random walk of the gyro bias in proportion to the acceleration (g-sensitivity).",
        BROAD,
    ),
    Tunable(
        "accel_noise_per_acceleration",
        0.02,
        "sqrt(s)",
        "Accelerometer noise density in proportion to the acceleration.",
        BROAD,
    ),
    Tunable(
        "shock_rotation",
        0.01,
        "rad/(m/s)",
        "Rotation, not resolved by the gyro, that comes with a velocity change too short to be sampled.",
        "BROAD (tapping).",
    ),
)

_OUTAGES = (
    Tunable("gap_rate_psd", 0.5**2, "(rad/s)^2/s", "Random walk of the angular rate in a gap.", UNRECORDED),
    Tunable("gap_force_psd", 3.0**2, "(m/s^2)^2/s", "Random walk of the specific force in a gap.", UNRECORDED),
    Tunable("fault_rate_radps", 0.3, "rad/s", "Error of the last rate that is held while the gyro fails.", UNRECORDED),
    Tunable("steady_rate_s", 0.2, "s", "Time for which the last rate is held as it is.", HANDS),
    Tunable(
        "held_rate_time_s",
        0.3,
        "s",
        "Time constant with which a rate that was held for steady_rate_s returns to zero.",
        HANDS,
        low=1e-3,
    ),
    Tunable("fault_force_psd", 10.0**2, "(m/s)^2/s", "Velocity noise while the accelerometer fails.", UNRECORDED),
    Tunable("stamp_time_s", 60.0, "s", "Time over which is learned whether it is stamps that scatter.", HANDS, low=0.1),
    Tunable("clipping_error", 0.5, "", "Error of a rotation beyond the gyro's range, over its estimate.", HANDS),
    Tunable(
        "clipping_slope_kept",
        0.9,
        "",
        "Least share of the slope before that the next sample has: a gyro that reaches its end rounds the corner.",
        HANDS,
        high=0.999,
    ),
    Tunable(
        "clipping_return_slope",
        0.05,
        "",
        "Least slope of a rate that was beyond the range when it comes back, over that with which it went there.",
        HANDS,
    ),
    Tunable(
        "clipping_return_sigmas",
        4.0,
        "sigma",
        "Least step of a rate that comes back into the range, in sigmas of the noise of a difference of two rates.",
        "Choice.",
    ),
    Tunable("flat_step", 0.005, "", "Largest flat step, as a share of the rate.", "As in `sensor_monitor.clipping`."),
    Tunable("saturation_noise", 0.2, "sqrt(s)", "Noise density of a saturated sensor, over its reading.", UNRECORDED),
)

_LEVELLING = (
    Tunable("initial_tilt_rad", 0.1, "rad", "Sigma of tilt from the first specific force.", UNRECORDED),
    Tunable("initial_angle_sigma_rad", math.radians(1.0), "rad", "Sigma of an angle that the user gives.", UNRECORDED),
    Tunable("levelling_time_s", 0.8, "s", "Duration of coarse levelling.", "Starts in the motion of BROAD."),
    Tunable("acceleration_time_s", 1.0, "s", "Correlation time of an acceleration that changes.", UNRECORDED, low=1e-3),
    Tunable(
        "initial_velocity_var", 1.0, "(m/s)^2", "Variance of the velocity after coarse levelling.", UNRECORDED, low=1e-3
    ),
    Tunable(
        "initial_velocity_scatter",
        0.3,
        "(m/s)^2",
        "First value of the velocity's scatter in motions shorter than a second.",
        UNRECORDED,
    ),
    Tunable(
        "min_gravity_ratio", 0.5, "", "Least specific force, over gravity, that may show the vertical.", UNRECORDED
    ),
    Tunable("max_gravity_ratio", 2.0, "", "Most specific force, over gravity, that may show the vertical.", UNRECORDED),
)

_MOTION = (
    Tunable(
        "velocity_scatter_time_s",
        1.0,
        "s",
        "Time over which mean and scatter of velocity are taken.",
        UNRECORDED,
        low=1e-3,
    ),
    Tunable(
        "position_decay_time_s",
        10.0,
        "s",
        "Time in which a new place becomes the origin of position.",
        UNRECORDED,
        low=1.0,
    ),
    Tunable(
        "position_scatter_time_s", 2.5, "s", "Time over which the scatter of position is taken.", UNRECORDED, low=1e-3
    ),
    Tunable(
        "travel_speed_mps", 1.0, "m/s", "Mean velocity above which a body is a vehicle.", "BROAD does not notice it."
    ),
    Tunable("travel_time_s", 30.0, "s", "Correlation time of a vehicle's velocity.", VEHICLES, low=1e-3),
    Tunable("travel_evidence", 2.0, "", "Squared sigmas of velocity that count as error.", "Akaike, one parameter."),
    Tunable(
        "travel_evidence_at_start",
        25.0,
        "",
        "Added to travel_evidence where there has been no rest; less with the time in motion.",
        SIMULATED,
    ),
    Tunable("hidden_speed_mps", 3.0, "m/s", "Speed in a steady turn that looks like tilt before a rest.", SIMULATED),
    Tunable("steady_turn_time_s", 30.0, "s", "Time over which turns to and fro cancel.", SIMULATED, low=1.0),
    Tunable("hypothesis_tilt_rad", 0.4, "rad", "Sigma of tilt where the body may move at any speed.", SIMULATED),
    Tunable("hypothesis_noise_per_rate", 0.005, "sqrt(s)", "Gyro scale errors as noise, in proportion.", SIMULATED),
    Tunable(
        "hypothesis_speed_noise_mps", 0.05, "m/s", "Velocity that the hypotheses' process does not describe.", SIMULATED
    ),
    Tunable(
        "hypothesis_speed_noise_share",
        0.1,
        "",
        "Velocity that the hypotheses' process does not describe, as a share of the speed.",
        SIMULATED,
    ),
    Tunable("hypothesis_carried_time_s", 60.0, "s", "Time in which accelerations in the body change.", SIMULATED),
    Tunable(
        "hypothesis_evidence",
        0.7,
        "",
        "Exponent of the hypotheses' likelihoods, which are not exact.",
        SIMULATED,
        high=1.0,
    ),
    Tunable(
        "hypothesis_weight_evidence",
        0.05,
        "",
        "Exponent of the likelihoods of the hypotheses without hands, which fade.",
        SIMULATED,
        high=1.0,
    ),
    Tunable(
        "hypothesis_weight_time_s",
        20.0,
        "s",
        "Time in which the evidence in the hypotheses' weights fades.",
        SIMULATED,
        low=1.0,
    ),
    Tunable("hypothesis_hand_odds", 3.5, "", "Log odds of a hand's over another before any evidence.", SIMULATED),
    Tunable("hypothesis_max_odds", 12.0, "", "Most log odds against a hypothesis.", SIMULATED),
    Tunable("vibration_time_s", 0.5, "s", "Time over which the vibration is averaged.", VEHICLES, low=1e-3),
    Tunable("road_slope", 0.03, "", "Sigma of the slope of roads.", UNRECORDED),
    Tunable("reset_velocity_var", 0.1, "(m/s)^2", "Variance of a velocity that is reset.", UNRECORDED),
    Tunable("reset_position_var", 0.1, "m^2", "Variance of a position that is reset.", UNRECORDED),
)

_PSEUDO_MEASUREMENTS = (
    Tunable("zero_velocity_noise", 0.023, "m/s sqrt(s)", "Noise density of zero velocity in slow motion.", BROAD),
    Tunable("zero_velocity_noise_per_scatter", 3.0, "sqrt(s)", "In proportion to the scatter of velocity.", BROAD),
    Tunable("shared_scatter", 0.5, "", "Part of the scatter of velocity that all axes share.", UNRECORDED, high=1.0),
    Tunable(
        "unseen_velocity_var",
        0.2,
        "(m/s)^2",
        "Scatter of velocity too slow to be seen when a motion begins without rest.",
        SIMULATED,
        low=1e-3,
    ),
    Tunable(
        "unseen_velocity_time_s",
        5.0,
        "s",
        "Time in motion after which half of the unseen scatter of velocity is left.",
        SIMULATED,
        low=1e-3,
    ),
    Tunable("stationary_velocity_noise", 0.09, "m/s sqrt(s)", "Noise density of zero velocity at rest.", BROAD),
    Tunable("velocity_reset_gate", 4.0, "sigma", "A larger velocity is real: it is reset, not fused.", UNRECORDED),
    Tunable("zero_position_noise", 0.5, "m sqrt(s)", "Noise density of zero position.", BROAD),
    Tunable("zero_position_noise_per_scatter", 6.0, "sqrt(s)", "In proportion to the scatter of position.", BROAD),
)

_STATIONARITY = (
    Tunable("mean_time_s", 0.35, "s", "Time constant of the running means of rate and force.", UNRECORDED, low=1e-3),
    Tunable("stationary_time_s", 1.0, "s", "Duration of low motion after which the body may be at rest.", UNRECORDED),
    Tunable("max_rate_deviation_radps", 0.035, "rad/s", "Most deviation of a rate from its mean at rest.", UNRECORDED),
    Tunable("max_force_deviation_mps2", 0.5, "m/s^2", "Most deviation of a force from its mean at rest.", UNRECORDED),
    Tunable("max_force_change_mps2", 0.1, "m/s^2", "Most change of the mean force at rest.", UNRECORDED),
    Tunable("rate_change_gate", 6.0, "sigma", "Most change of the mean rate at rest.", UNRECORDED),
    Tunable("acceleration_gate", 5.0, "sigma", "Most difference of the mean force from gravity at rest.", UNRECORDED),
    Tunable("force_change_gate", 3.0, "sigma", "Change of the force's magnitude that contradicts or fits.", SIMULATED),
    Tunable("bias_gate", 5.0, "sigma", "Most difference of the mean rate from the known bias at rest.", UNRECORDED),
    Tunable("max_bias_sigma", 4.0, "sigma", "Most bias, over the profile's, that a rate at rest may show.", UNRECORDED),
    Tunable(
        "min_bias_sigma_radps",
        5e-4,
        "rad/s",
        "How well a gyro bias is ever known: temperature, quantization, earth rate.",
        "A tenth of the bias of a consumer part, seven earth rates.",
    ),
    Tunable("min_force_sigma_mps2", 0.03, "m/s^2", "How well the specific force at rest is ever known.", UNRECORDED),
    Tunable(
        "gravity_magnitude_gate", 2.5, "sigma", "Most error of the force's magnitude at the first rest.", UNRECORDED
    ),
    Tunable(
        "relevel_tilt_rad", 0.1, "rad", "Tilt sigma added where the force exceeds gravity_magnitude_gate.", UNRECORDED
    ),
    Tunable("min_rate_across_gravity", 0.5, "", "Sine of the angle to gravity of a rate that may turn it.", UNRECORDED),
    Tunable("fixed_gravity_gate", 8.0, "sigma", "Turn of gravity that must be seen, or the rate is bias.", UNRECORDED),
    Tunable("confirmation_time_s", 3.0, "s", "How long a contradiction must last at obvious rest.", UNRECORDED),
    Tunable("max_curve_time_s", 60.0, "s", "No curve is even for so long.", UNRECORDED, low=1e-3),
    Tunable("even_motion_probability", 0.25, "", "That the first rest is even motion if it is shaken.", EVEN, high=1.0),
    Tunable("even_acceleration_mps2", 0.7, "m/s^2", "RMS acceleration of even motion.", EVEN),
    Tunable("moving_vibration_ratio", 2.5, "", "Vibration of what moves, over the sensor's noise.", EVEN, low=0.1),
    Tunable(
        "turn_ratio",
        10.0,
        "",
        "A rate about the vertical so many times the others may be a turn.",
        "Of three alike gyros one in a hundred (Student's t, two degrees of freedom).",
        low=0.1,
    ),
    Tunable(
        "standing_vibration_ratio",
        5.0,
        "",
        "A body that stood after it travelled vibrates less by this factor.",
        "Amplitudes of neighbouring classes of roads differ by 2 (ISO 8608).",
    ),
    Tunable(
        "moving_log_odds",
        math.log(3.0),
        "",
        "Prior log odds that a vehicle of even motion moves.",
        UNRECORDED,
        low=-10.0,
        high=10.0,
    ),
)

_DIVERGENCE = (
    Tunable("converged_tilt_rad", math.radians(15.0), "rad", "Tilt sigma below which tilt has converged.", UNRECORDED),
    Tunable("lost_tilt_rad", math.radians(30.0), "rad", "Tilt sigma above which a converged tilt is lost.", UNRECORDED),
    Tunable("max_velocity_gain_mps", 50.0, "m/s", "A gain of velocity that no vehicle has.", "Cars, light aircraft."),
    Tunable(
        "common_velocity_gain", 0.25, "", "Part of max_velocity_gain_mps that many vehicles have.", UNRECORDED, high=1.0
    ),
    Tunable("velocity_gain_time_s", 300.0, "s", "Time constant of the gain of velocity.", VEHICLES, low=1e-3),
)

_ATTITUDE_STEP = (
    Tunable("gain_time_s", 5.0, "s", "Time over which a gain of velocity is taken.", HANDS, low=0.1),
    Tunable("usual_gain_time_s", 30.0, "s", "Time over which the usual gain is learned.", HANDS, low=0.1),
    Tunable(
        "usual_gain_sigmas",
        3.0,
        "sigma",
        "Gain of velocity, over the usual one, from which it is evidence of a step.",
        HANDS,
    ),
    Tunable(
        "min_gain_mps",
        0.4,
        "m/s",
        "Least gain of velocity that is evidence of a step: a body that is carried off.",
        HANDS,
    ),
    Tunable(
        "rise_gain_sigmas",
        1.5,
        "sigma",
        "Gain of velocity, not yet in its mean, over the usual one, from which a slip may have begun.",
        HANDS,
    ),
    Tunable(
        "rise_gain_mps",
        0.2,
        "m/s",
        "Least gain of velocity, not yet in its mean, by which a slip may have begun.",
        HANDS,
    ),
    Tunable(
        "rise_time_s", 0.15, "s", "Time after which half of the angle of a slip that may have begun is believed.", HANDS
    ),
    Tunable("rise_angle_rad", 0.35, "rad", "RMS angle of slips.", HANDS, low=0.01),
    Tunable(
        "rise_slip_probability",
        0.2,
        "",
        "Probability that a gain of velocity, not yet in its mean, is a slip.",
        HANDS,
        high=1.0,
    ),
    Tunable("step_gain_sigmas", 5.0, "sigma", "Gain of velocity, over the usual one, that is a step.", HANDS),
    Tunable("step_gain_mps", 1.2, "m/s", "Least gain of velocity that is a step: somebody begins to walk.", HANDS),
    Tunable(
        "min_step_s", 0.5, "s", "Shortest time in which a gain of velocity is evidence of a step.", HANDS, low=0.05
    ),
    Tunable(
        "steady_share", 0.75, "", "The share of a mean force that its newest value shows if it lasts.", HANDS, high=1.0
    ),
    Tunable("lean_time_s", 0.1, "s", "Time over which vibration is averaged.", FLIGHTS, low=1e-3),
    Tunable("lean_share", 0.5, "", "Angle that a force moves in a body that leans, over the lean.", FLIGHTS, high=1.0),
    Tunable("hand_time_s", 10.0, "s", "Lively motion after which a body is no vehicle.", HANDS),
    Tunable("hand_rate_radps", 1.0, "rad/s", "A rate across the vertical that halves hand_time_s.", HANDS, low=0.01),
    Tunable("min_hand_probability", 0.99, "", "Of a hand, before a rest, for a step to be one.", HANDS, high=1.0),
    Tunable("lively_acceleration_mps2", 0.3, "m/s^2", "RMS acceleration of lively motion, about its mean.", HANDS),
    Tunable("lively_rate_radps", 0.2, "rad/s", "RMS rate of lively motion.", HANDS),
    Tunable("vehicle_acceleration_mps2", 3.0, "m/s^2", "RMS acceleration of vehicles.", VEHICLES, low=0.01),
    Tunable("travel_proof_s", 3.0, "s", "Travel after which a body is a vehicle.", VEHICLES),
    Tunable(
        "vehicle_time_s",
        600.0,
        "s",
        "Time constant with which it is forgotten that a body is a vehicle.",
        UNRECORDED,
        low=1.0,
    ),
)

_VARIANCE_FACTOR = (
    Tunable("correction_time_s", 10.0, "s", "Time over which corrections of the tilt are summed.", MIXED, low=0.1),
    Tunable("correction_memory_s", 120.0, "s", "Time over which squared sums are compared.", MIXED, low=1.0),
    Tunable("correction_gate", 3.0, "", "A sum counts at once over so many times its expectation.", MIXED, low=0.1),
)

_DRAG = (
    Tunable("drag_block_s", 2.0, "s", "Time over which forces and velocities are averaged.", FLIGHTS, low=0.1),
    Tunable(
        "drag_memory_s", 60.0, "s", "Time over which the forces and velocities of drag are compared.", FLIGHTS, low=10.0
    ),
    Tunable("drag_mean_s", 300.0, "s", "Time over which the direction of the thrust is taken.", FLIGHTS, low=1.0),
    Tunable(
        "min_drag_blocks", 15, "", "Least blocks of forces and velocities from which drag is found.", FLIGHTS, low=3
    ),
    Tunable(
        "min_drag_correlation2", 0.3, "", "Least share of the force that the velocity explains.", FLIGHTS, high=1.0
    ),
    Tunable("max_drag", 1.0, "1/s", "Most drag per velocity and mass.", FLIGHTS),
    Tunable("drag_constant_weight", 0.4, "", "Weight of a constant force of zero.", FLIGHTS, low=1e-3),
    Tunable(
        "accel_bias_walk_per_acceleration",
        3e-3,
        "1/sqrt(s)",
        "Random walk of the accelerometer bias of what hangs on its rotors, in proportion to the acceleration.",
        FLIGHTS,
    ),
    Tunable("gust_noise", 10.0, "m/s sqrt(s)", "Noise density of slow gusts.", FLIGHTS),
    Tunable("drag_noise", 4.0, "", "Noise of the velocity by drag, over that of white residuals.", FLIGHTS),
)

_QUANTIZATION = (
    Tunable("max_lsb_radps", math.radians(0.2), "rad/s", "A larger step between readings is motion.", UNRECORDED),
    Tunable("min_lsb_radps", math.radians(0.001), "rad/s", "A step whose half is not noticed.", UNRECORDED),
    Tunable("min_step_radps", 1e-6, "rad/s", "A smaller step between readings is rounding.", UNRECORDED),
    Tunable(
        "max_code_error", 0.1, "LSB", "Most distance of a reading from a whole number of LSB.", UNRECORDED, high=0.5
    ),
    Tunable(
        "truncation_prior",
        math.log(1.0 / 10.0),
        "",
        "Prior log odds that readings are truncated toward zero.",
        UNRECORDED,
        low=-10.0,
        high=10.0,
    ),
    Tunable("max_log_odds", 12.0, "", "Limit of the log odds of truncation.", UNRECORDED),
    Tunable("block_samples", 1000, "", "Samples in a histogram of readings at rest.", UNRECORDED, low=2),
    Tunable("max_blocks", 16, "", "Most histograms of equal noise that are evaluated.", UNRECORDED),
    Tunable("min_noise_lsb", 0.7, "LSB", "Less noise does not reach the next code.", UNRECORDED, low=0.1),
    Tunable("max_noise_lsb", 4.0, "LSB", "More noise shows no single code.", UNRECORDED),
    Tunable("min_whiteness", 0.4, "", "Least part of the variance between successive readings.", UNRECORDED),
    Tunable("histogram_reach", 4.0, "sigma", "Half the width of the evaluated part of a histogram.", UNRECORDED),
    Tunable("outlier_probability", 0.02, "", "Probability of a reading that is not Gaussian.", UNRECORDED, high=0.5),
)

TUNABLES = (
    *_FILTER,
    *_SENSOR,
    *_PROCESS_NOISE,
    *_OUTAGES,
    *_LEVELLING,
    *_MOTION,
    *_PSEUDO_MEASUREMENTS,
    *_STATIONARITY,
    *_DIVERGENCE,
    *_ATTITUDE_STEP,
    *_VARIANCE_FACTOR,
    *_DRAG,
    *_QUANTIZATION,
)
