"""Goldens of the navigation filter: a receiver with faults, latency, RTK, or few data."""

import numpy as np
from golden_data import HEADED, between, data, moved, navigated, random, road, seconds, silent
from golden_run import golden
from navigation_simulation import at_antenna, received, sensed
from simulated_errors import outliers

from imud.estimators.records import NEW_RECEIVER


@golden("navigation")
def no_velocity():
    samples, fixes = data(seed=2)
    return navigated(samples, silent(fixes))


@golden("navigation")
def jump():
    """100 m that stay, against the velocity that the receiver measures."""
    samples, fixes = data()
    return navigated(samples, moved(fixes, 90.0, 1e9, 100.0))


@golden("navigation")
def short_jump():
    samples, fixes = data(seed=3)
    return navigated(samples, moved(fixes, 90.0, 96.0, 300.0))


@golden("navigation")
def jump_without_velocity():
    """After an outage, which leaves nothing to vouch for the velocity."""
    samples, fixes = data(seed=4)
    fixes = silent(moved(fixes, 95.0, 1e9, 500.0))
    return navigated(samples, fixes[~between(fixes, 80.0, 95.0)], HEADED)


@golden("navigation")
def smaller_jump_without_velocity():
    """After an outage, in which the errors of the estimate may have grown by as much."""
    samples, fixes = data(seed=4)
    fixes = silent(moved(fixes, 95.0, 1e9, 15.0))
    return navigated(samples, fixes[~between(fixes, 80.0, 95.0)], HEADED)


@golden("navigation")
def stamps_that_step():
    """They fall back by a second, and later by a tenth."""
    samples, fixes = data(seed=9)
    fixes["t_ns"][between(fixes, 80.0, 1e9)] -= 1_000_000_000
    fixes["t_ns"][between(fixes, 110.0, 1e9)] -= 100_000_000
    return navigated(samples, fixes)


@golden("navigation")
def another_receiver():
    """It is plugged in after four seconds, and its stamps are late by a tenth."""
    samples, fixes = data(seed=9)
    fixes = fixes[~between(fixes, 86.0, 90.0)]
    late = between(fixes, 90.0, 1e9)
    fixes["t_ns"][late] += 100_000_000
    fixes["flags"][np.flatnonzero(late)[0]] = NEW_RECEIVER
    return navigated(samples, fixes)


@golden("navigation")
def jump_of_height():
    samples, fixes = data(seed=5)
    fixes["height"][between(fixes, 90.0, 1e9)] += 60.0
    return navigated(samples, fixes)


@golden("navigation")
def no_height():
    samples, fixes = data(seed=6)
    fixes["height"][~between(fixes, 60.0, 65.0)] = np.nan
    return navigated(samples, fixes)


@golden("navigation")
def slow_drift():
    """Of the positions alone, at 1 m/s, which is found by what it does to the innovations."""
    samples, fixes = data(seed=1)
    return navigated(samples, silent(moved(fixes, 90.0, 125.0, 0.0, per_second=1.0)))


@golden("navigation")
def slow_drift_against_velocity():
    samples, fixes = data(seed=7)
    return navigated(samples, moved(fixes, 80.0, 115.0, 0.0, per_second=2.0), HEADED)


@golden("navigation")
def slow_drift_against_velocity_that_lasts():
    """For longer than positions drift, so that the velocity is taken for the false one."""
    samples, fixes = data(road(260.0), seed=7)
    return navigated(samples, moved(fixes, 80.0, 1e9, 0.0, per_second=1.0), HEADED)


@golden("navigation")
def slow_drift_parked():
    samples, fixes = data(road(rest=1e3), seed=8)
    return navigated(samples, silent(moved(fixes, 70.0, 110.0, 0.0, per_second=1.0)), HEADED)


@golden("navigation")
def drift_that_stays():
    """The drift ends, and the positions stay where it has brought them."""
    samples, fixes = data(road(rest=1e3), seed=9)
    fixes = moved(moved(fixes, 60.0, 80.0, 0.0, per_second=3.0), 80.0, 1e9, 60.0)
    return navigated(samples, silent(fixes), HEADED)


@golden("navigation")
def alternating_receiver():
    """Every fourth position is elsewhere, then every third, every second; then for two seconds in a row, and seldom."""
    samples, fixes = data(road(320.0), seed=76)
    for begin, every, row in ((60.0, 4, 1), (100.0, 3, 1), (150.0, 2, 1), (200.0, 4, 2), (250.0, 12, 1)):
        for k in range(int(40.0 / every)):
            fixes = moved(fixes, begin + every * k, begin + every * k + row, 300.0)
    return navigated(samples, fixes, HEADED)


@golden("navigation")
def frozen_receiver():
    samples, fixes = data(seed=10)
    frozen = np.flatnonzero(between(fixes, 90.0, 115.0))
    for name in ("lat", "lon", "height", "speed", "course"):
        fixes[name][frozen] = fixes[name][frozen[0]]
    return navigated(samples, fixes)


@golden("navigation")
def frozen_slow_receiver():
    """Five fixes a second that stand still, of a vehicle about as slow as it may be for that to show."""
    d = road(100.0, speed=2.6, swing=0.5)
    samples, fixes = data(d, seed=62, every=0.2)
    for begin in (40.0, 52.0, 64.0, 76.0):
        frozen = np.flatnonzero(between(fixes, begin, begin + 4.0))
        fixes["lat"][frozen], fixes["lon"][frozen] = fixes["lat"][frozen[0]], fixes["lon"][frozen[0]]
    return navigated(samples, fixes)


@golden("navigation")
def two_jumps_without_velocity():
    samples, fixes = data(seed=63)
    fixes = silent(moved(moved(fixes, 80.0, 1e9, 300.0), 91.0, 1e9, 400.0))
    return navigated(samples, fixes, HEADED)


@golden("navigation")
def graded_jumps():
    """Each for three seconds, ever farther."""
    samples, fixes = data(road(200.0), seed=64)
    for k, metres in enumerate(np.geomspace(4.0, 40.0, 14)):
        fixes = moved(fixes, 50.0 + 10.0 * k, 53.0 + 10.0 * k, metres)
    return navigated(samples, fixes, HEADED)


@golden("navigation")
def graded_drifts():
    """Of a parked vehicle's positions, ever faster, each until it is far enough; and back."""
    samples, fixes = data(road(320.0, rest=1e3), seed=65)
    for k, speed in enumerate((0.3, 0.6, 1.2, 2.4, 4.5, 6.0)):
        fixes = moved(fixes, 60.0 + 40.0 * k, 80.0 + 40.0 * k, 0.0, per_second=speed)
    return navigated(samples, silent(fixes), HEADED)


@golden("navigation")
def graded_drifts_under_way():
    """The same of a car; each stays for a while where it has come to."""
    samples, fixes = data(road(330.0), seed=66)
    for k, speed in enumerate((0.8, 1.6, 5.6)):
        begin = 60.0 + 90.0 * k
        fixes = moved(fixes, begin, begin + 20.0, 0.0, per_second=speed)
        fixes = moved(fixes, begin + 20.0, begin + 55.0, 20.0 * speed)
    return navigated(samples, silent(fixes), HEADED)


@golden("navigation")
def survey_of_a_decimetre():
    """Whose fixes are just too uncertain for it to be one."""
    d, rng = road(80.0), random(67)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.5, sigma=0.08, white=0.05)
    fixes["arrival_ns"] = fixes["t_ns"]
    fixes["sigma"], fixes["hdop"] = (0.11, 0.11, 0.2), np.nan
    return navigated(samples, fixes)


@golden("navigation")
def outage_before_heading():
    """After two fixes under way; what was matched until then is too old as they come back."""
    samples, fixes = data(road(100.0, rest=0.0, fast_start=True), seed=68)
    return navigated(samples, fixes[~between(fixes, 7.5, 29.5)])


@golden("navigation")
def old_fixes():
    """About as old as may be used; none comes meanwhile."""
    samples, fixes = data(seed=69)
    fixes["arrival_ns"][between(fixes, 80.0, 81.0)] += 11_000_000_000
    fixes["arrival_ns"][between(fixes, 110.0, 111.0)] += 4_000_000_000
    fixes["t_ns"][between(fixes, 130.0, 131.0)] += 1_300_000_000
    return navigated(samples, fixes[~between(fixes, 81.0, 92.0) & ~between(fixes, 111.0, 115.0)], HEADED)


@golden("navigation")
def drift_that_returns():
    """Slowly, of a parked vehicle's positions."""
    samples, fixes = data(road(200.0, rest=1e3), seed=82)
    fixes = moved(moved(fixes, 70.0, 110.0, 0.0, per_second=1.0), 110.0, 190.0, 40.0, per_second=-0.5)
    return navigated(samples, silent(fixes), HEADED)


@golden("navigation")
def long_drift():
    """For longer than fixes are refused."""
    samples, fixes = data(road(200.0, rest=1e3), seed=83)
    return navigated(samples, silent(moved(fixes, 60.0, 1e9, 0.0, per_second=1.0)), HEADED)


@golden("navigation")
def overconfident_receiver():
    """Its positions wander farther than it says, for minutes, and drift at last."""
    samples, fixes = data(road(330.0, rest=1e3), seed=84, sigma=5.0, tau=30.0)
    return navigated(samples, silent(moved(fixes, 280.0, 1e9, 0.0, per_second=1.5)), HEADED)


@golden("navigation")
def overconfident_receiver_under_way():
    samples, fixes = data(road(330.0), seed=85, sigma=4.0, tau=20.0)
    return navigated(samples, silent(moved(fixes, 270.0, 1e9, 0.0, per_second=2.0)), HEADED)


@golden("navigation")
def outage():
    samples, fixes = data(seed=11)
    return navigated(samples, fixes[~between(fixes, 90.0, 130.0)])


@golden("navigation")
def latency():
    """0.4 s instead of the 0.15 s that are assumed, and a velocity that is 0.2 s older still."""
    d = road()
    rng = random(12)
    samples = sensed(d, rng)
    return navigated(samples, received(d, rng, late=0.4, stamp=0.25, lag=0.2), HEADED)


@golden("navigation")
def late_stamps():
    """By a second from the start on: the age is found before the heading; two are missing, the velocity is rough."""
    samples, fixes = data(seed=89, stamp=1.0, speed_sigma=0.35)
    fixes = fixes[~between(fixes, 15.5, 17.5)]
    fixes["arrival_ns"] = np.maximum(fixes["arrival_ns"], fixes["t_ns"])
    return navigated(samples, fixes)


@golden("navigation")
def late_positions():
    """By 0.6 s from the start on, with positions alone, of an antenna whose lever arm is given with a sigma."""
    d, rng, lever = road(110.0), random(87), (0.5, -0.4, -1.0)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.5, sigma=0.02, white=0.01, hdop=0.05)
    fixes = silent(at_antenna(d, fixes, np.array(lever)))
    fixes["t_ns"] += 600_000_000
    fixes["arrival_ns"] = np.maximum(fixes["arrival_ns"], fixes["t_ns"])
    return navigated(samples, fixes, lever_arm_m=lever, lever_arm_sigma_m=0.1)


@golden("navigation")
def wrong_lever_arm(late=0.1, right=-0.28):
    """Centimetres, and a lever arm that is given wrong by 0.12 m to the right."""
    d, rng, lever = road(110.0), random(88), (0.5, -0.4, -1.0)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, late=late, sigma=0.01, white=0.01)
    fixes = at_antenna(d, fixes, np.array(lever))
    fixes["sigma"], fixes["hdop"], fixes["quality"] = (0.02, 0.02, 0.04), np.nan, 4
    return navigated(samples, fixes, lever_arm_m=(0.5, right, -1.0))


@golden("navigation")
def wrong_lever_arm_of_a_survey():
    """The same by a metre, of one whose epochs count as exact."""
    return wrong_lever_arm(late=0.0, right=0.6)


@golden("navigation")
def smoothed_velocity():
    """Another receiver, under way, whose velocity lags by a second behind its positions; then the first one again."""
    d = road()
    samples, fixes = sensed(d, random(91)), received(d, random(92))
    t = fixes["t_ns"] * 1e-9
    smoothing = (t > 135.0) & (t < 195.0)
    fixes[smoothing] = received(d, random(92), lag=1.0)[smoothing]
    fixes["flags"][np.flatnonzero(np.diff(smoothing)) + 1] = NEW_RECEIVER
    return navigated(samples, fixes)


@golden("navigation")
def positions_behind_their_velocity():
    """By a second: each is that of the fix before."""
    samples, fixes = data(seed=93)
    for name in ("lat", "lon", "height"):
        fixes[name][1:] = fixes[name][:-1].copy()
    return navigated(samples, fixes)


@golden("navigation")
def late_fixes():
    """Some later than can be rewound, some out of order, some of the future, some that cannot be true."""
    samples, fixes = data(seed=13)
    t, odd = seconds(fixes), fixes["arrival_ns"]
    odd[between(fixes, 70.0, 80.0)] += 5_000_000_000
    odd[between(fixes, 100.0, 101.0)] += 1_500_000_000
    fixes["t_ns"][between(fixes, 110.0, 113.0)] += 3_000_000_000
    fixes["quality"][(t > 120.0) & (t < 123.0)] = 6
    fixes["lat"][(t > 125.0) & (t < 127.0)] = 2.0
    return navigated(samples, fixes, HEADED)


@golden("navigation")
def rtk():
    """Centimetres whose epochs a survey's log states, ten a second, the antenna beside the sensor."""
    d, rng, lever = road(100.0), random(14), (0.5, -0.4, -1.0)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, sigma=0.01, white=0.01, stamp=0.02)
    k = np.searchsorted(100.0 + d.t, fixes["arrival_ns"] * 1e-9 - 1e-6)
    arm = d.attitude[k].apply(lever)
    fixes["lat"] += arm[:, 0] / 6.37e6
    fixes["lon"] += arm[:, 1] / (6.39e6 * np.cos(fixes["lat"]))
    fixes["height"] -= arm[:, 2]
    fixes["arrival_ns"] = fixes["t_ns"]
    fixes["sigma"], fixes["hdop"], fixes["quality"] = (0.02, 0.02, 0.04), np.nan, 4
    return navigated(samples, silent(fixes), lever_arm_m=lever)


@golden("navigation")
def rtk_on_a_rough_road():
    """Blows of 0.4 m/s that the sensor does not show; each puts the next position beyond its gate."""
    d, rng = road(120.0), random(17)
    samples, fixes = sensed(d, rng), received(d, rng, sigma=0.01, white=0.01)
    for k in range(7000, 12000, 1500):
        samples["f"][k : k + 5, :2] += 8.0  # in 0.05 s; a single sample would be a spike
    fixes["arrival_ns"] = fixes["t_ns"]
    fixes["sigma"], fixes["hdop"], fixes["quality"] = (0.02, 0.02, 0.04), np.nan, 4
    return navigated(samples, silent(fixes))


def from_a_changed_gyro(seed, **receiver):
    """Its biases step at 80 s, about level axes: the estimate accelerates away from right positions."""
    d, rng = road(120.0, speed=12.0), random(seed)
    samples, fixes = sensed(d, rng), received(d, rng, **receiver)
    samples["w"][seconds(samples) > 80.0] += np.radians((2.0, -1.5, 0.0))
    return samples, silent(fixes)


@golden("navigation")
def gyro_that_steps():
    samples, fixes = from_a_changed_gyro(93)
    return navigated(samples, fixes)


@golden("navigation")
def gyro_that_steps_with_rtk():
    samples, fixes = from_a_changed_gyro(94, sigma=0.01, white=0.01)
    fixes["sigma"], fixes["hdop"], fixes["quality"] = (0.02, 0.02, 0.04), np.nan, 4
    return navigated(samples, fixes)


@golden("navigation")
def rtk_comes_and_goes():
    """By its quality alone: fixed, float, single, fixed."""
    d, rng = road(120.0), random(15)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.5, late=0.1, sigma=0.02, white=0.01)
    single = received(d, random(16), every=0.5, late=0.1)
    fixes["quality"] = 4
    fixes["quality"][between(fixes, 50.0, 65.0)] = 5
    fixes[between(fixes, 65.0, 85.0)] = single[between(single, 65.0, 85.0)]
    return navigated(samples, fixes)


@golden("navigation")
def ned_velocity():
    """As modern receivers measure it, with sigmas of the position, five a second."""
    d, rng = road(100.0), random(17)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, late=0.08)
    k = np.searchsorted(100.0 + d.t, fixes["t_ns"] * 1e-9 - 1e-6)
    fixes["v"] = d.v[k] + 0.05 * rng.standard_normal((len(fixes), 3))
    fixes["sigma"], fixes["hdop"] = (1.2, 1.2, 2.0), np.nan
    return navigated(samples, fixes)


@golden("navigation")
def sparse_fixes():
    """One every five seconds, without velocity or a word of their quality."""
    samples, fixes = data(seed=18, every=5.0)
    fixes["hdop"] = np.nan
    return navigated(samples, silent(fixes))


@golden("navigation")
def positions_often():
    """Without velocity, more often than the velocity changes that they show can be told from noise."""
    samples, fixes = data(seed=49, every=0.7)
    return navigated(samples, silent(fixes))


@golden("navigation")
def few_fixes():
    """Two; nobody asks for what rest told meanwhile, until there is more of it than is kept."""
    samples, fixes = data(road(rest=1e3), seed=50)
    return navigated(samples, fixes[[5, -5]], HEADED)


@golden("navigation")
def wrong_course():
    """The receiver's course is false for a while: its velocity contradicts its positions, and is not used."""
    samples, fixes = data(seed=19)
    fixes["course"][between(fixes, 70.0, 95.0)] += 1.6
    return navigated(samples, fixes, HEADED)


@golden("navigation")
def wrong_velocity_from_the_start():
    """Constant, and not used before the heading; which of the two is wrong is decided after a minute."""
    samples, fixes = data(seed=51)
    fixes["speed"], fixes["course"] = 2.5, 0.3
    return navigated(samples, fixes)


@golden("navigation")
def rtk_drifts_and_comes_back():
    """Against its velocity, so that either may be wrong; the estimate follows the positions."""
    d = road(160.0, speed=12.0, swing=0.1, straight_s=40.0)
    samples, fixes = data(d, seed=91, sigma=0.01, white=0.01, every=0.2)
    fixes["sigma"] = (0.03, 0.03, 0.05)
    return navigated(samples, moved(fixes, 80.0, 120.0, 0.0, per_second=0.5))


@golden("navigation")
def rtk_with_outliers():
    """One position in twenty is 20 m off: no evidence of a wrong lever arm, or of a step of the stamps."""
    d, rng = road(160.0, speed=12.0), random(92)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.2, sigma=0.01, white=0.01, every=0.2)
    fixes["sigma"] = (0.03, 0.03, 0.05)
    return navigated(samples, outliers(d, fixes, rng, 20.0))
