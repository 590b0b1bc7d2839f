"""Do the golden traces notice when a tunable of an estimator changes? `python tests/mutate.py [NAME..]`

Each tunable is changed alone: by a quarter, whole numbers by one at least. It is noticed if a golden trace differs. Of
those that no trace notices, NOT_NOTICED says why. NAME: `attitude.KEY`, or its beginning; default: all. --quick takes
these for not noticed without trying: every trace runs for each of them, which is most of the time; the percentage is
then the least that it can be. --jobs: processes, each with its share of the tunables.
"""

import argparse
import dataclasses
import functools
import multiprocessing
import sys
from dataclasses import dataclass

import msgspec
from golden import CLASSES, differences, read, traced
from golden_run import Recording

from imud.estimators import registry
from imud.estimators.tuning import Tunable

LEAST_PERCENT = 85.0
BETWEEN = "no recording has one between the two: "
CLASSES_SECOND = "the velocity itself tells each rest in the recordings before the motion class does"
BY_WHEELS = BETWEEN + "contradiction between wheels and a receiver that drifts"
OLDER = "each drift in the recordings is found from an older onset"
CONFIRMED = "each drift in the recordings begins long after the motion has confirmed the heading"
NOT_NOTICED = {
    "attitude.min_step_radps": "tells equal readings from others: anything between rounding and a count does",
    "attitude.max_blocks": "the odds of no recording are still open after so many blocks",
    "attitude.acceleration_gate": BETWEEN + "mean force at a disturbed rest",
    "attitude.min_force_sigma_mps2": BETWEEN + "mean force at a disturbed rest",
    "attitude.converged_tilt_rad": BETWEEN + "smallest sigma of the tilt between two starts",
    "attitude.min_rate_across_gravity": BETWEEN + "angle of a steady turn to gravity",
    "attitude.min_whiteness": BETWEEN + "whiteness of a block at rest",
    "attitude.lean_time_s": BETWEEN + "scatter of the force in a multicopter's body and in a hand's",
    "attitude.lean_share": BETWEEN + "angle by which a lean and a slip move the force in the body",
    "attitude.drag_mean_s": "no recorded flight is as long",
    "attitude.min_drag_correlation2": BETWEEN + "correlation of a multicopter's and of a car's forces and velocities",
    "attitude.max_drag": BETWEEN + "drag of a multicopter and of a turning hand",
    "navigation.confirmed_residual": BETWEEN + "mean NIS of fixes with a right and with a wrong heading",
    "navigation.deviation_step_s": BETWEEN + "time from one heading to the next",
    "navigation.pose_gate": BETWEEN + "NIS of a right and of a wrong pose",
    "navigation.pose_offset_s": BETWEEN + "distance at which rejected poses return",
    "navigation.pose_return_gate": BETWEEN + "distance at which rejected poses return",
    "navigation.heave_time_s": "of the boats in the recordings a current is found before their heave",
    "navigation.odometer_return": BETWEEN + "distance at which a faulty odometer returns",
    "navigation.odometer_max_inflation_s": BETWEEN + "time for which an odometer is rejected",
    "navigation.odometer_repetitions": BETWEEN + "longest repetition of a coarse reading",
    "navigation.elsewhere_gate": BETWEEN + "distance of the fixes from where a body was",
    "navigation.power_on_force_sigma": BETWEEN + "tilt of a sensor that is mounted anew",
    "navigation.power_on_tilt_gate": BETWEEN + "tilt of a sensor that is mounted anew",
    "navigation.stationary_accel": BETWEEN + "vibration on which a decision hangs",
    "navigation.long_rest_variance": BETWEEN + "variance of the velocity at a rest in an outage",
    "navigation.rest_variance": BETWEEN + "variance of the velocity at a rest in an outage",
    "navigation.slow_motion_max_speed": CLASSES_SECOND,
    "navigation.class_memory": CLASSES_SECOND,
    "navigation.class_min_windows": CLASSES_SECOND,
    "navigation.gnss_return_gate": BETWEEN + "NIS of the first fix after a drift",
    "navigation.inertial_heading_error": BETWEEN + "speed at which rejected fixes move",
    "navigation.match_gate": BETWEEN + "NIS of a velocity change that was not felt",
    "navigation.inertial_velocity_error": BETWEEN + "speed at which rejected fixes move",
    "navigation.time_tag_tolerance_s": "tells exact time tags from others: anything well below their step does",
    "navigation.nhc_retry_s": BETWEEN + "time after which a land vehicle is recognized again",
    "navigation.axis_across_land": BETWEEN + "velocity across the axis of a land vehicle",
    "navigation.match_rotation": "the limits of the time that it makes hold in all recordings",
    "navigation.whitening_position_sigma": "stands for infinity",
    "navigation.whitening_speed_sigma": "stands for infinity",
    "navigation.heading_fault_angle": BETWEEN + "error of a given heading",
    "navigation.heading_fault_gate": BETWEEN + "error of a given heading",
    "navigation.min_drift_s": OLDER,
    "navigation.min_drift_fixes": OLDER,
    "navigation.min_time_offset_step_s": BETWEEN + "step of the receiver's time tags",
    "navigation.max_time_offset_step_s": BETWEEN + "step of the receiver's time tags",
    "navigation.max_attitude_noise": "no recording has a gyro so noisy under way that the learned noise reaches it",
    "navigation.wheel_check_gate": BY_WHEELS,
    "navigation.wheel_check_speed": BY_WHEELS,
    "navigation.wheel_min_contradiction": BY_WHEELS,
    "navigation.wheel_evidence": BY_WHEELS,
    "navigation.heading_confirmations": CONFIRMED,
    "navigation.unconfirmed_heading_sigma": CONFIRMED,
    "navigation.wheel_fresh_s": BETWEEN + "time without a reading of the wheels",
    "navigation.wheel_reject_factor": BETWEEN + "number of rejected velocities with wheels",
    "navigation.wheel_max_reject_s": "no recording rejects fixes for so long",
    "navigation.burst_psd": "no fix in the recordings proves more noise",
    "navigation.burst_s": BETWEEN + "time since the last fix when one is rejected",
    "navigation.baro_gate": BETWEEN + "NIS of a gust or a door",
    "navigation.fixed_gravity_gate": BETWEEN + "rotation of gravity by a wrong bias at rest",
    "navigation.fixed_gravity_share": BETWEEN + "turn by a wrong bias at rest",
    "navigation.min_rate_across_gravity": BETWEEN + "angle of a rate to gravity at rest",
    "navigation.wrong_bias_gate": BETWEEN + "NIS of a wrong bias at rest",
    "attitude.usual_gain_time_s": "each slip in the recordings comes after less time in the hand",
    "attitude.travel_proof_s": BETWEEN + "time of travel of a body that slips",
    "attitude.min_hand_probability": "none that begins in motion has a step; test_attitude_hypotheses has a plane",
    "attitude.vehicle_time_s": "no body in the recordings travels before it is in a hand",
    "riss.gate": BETWEEN + "NIS of an outlier",
    "riss.rest_rate": BETWEEN + "yaw rate at a rest",
    "riss.max_tilt_sigma": BETWEEN + "sigma of the tilt when roll and pitch are first claimed",
    "navigation.gravity_memory_s": "each wrong bias in the recordings is found sooner",
    "navigation.max_speed_of_gravity": BETWEEN + "speed of a body with a wrong bias",
    "navigation.baro_known_height": BETWEEN + "sigma of the height when the barometer begins",
    "navigation.max_gravity_excess": "no recording turns in a circle so slow that it is no flight",
    "navigation.mag_agreement_gate": BETWEEN + "NIS of a field after a contradiction",
    "navigation.mag_heading_inflation": "a heading is inflated by 20 deg, or not at all",
    "navigation.max_lean": BETWEEN + "lean of a body in the recordings",
    "navigation.vector_pair_max_s": BETWEEN + "time between fixes of a start in motion",
    "navigation.vector_tilt_gate": BETWEEN + "NIS of a tilt found by vector pairs",
    "navigation.excluded_step_sigmas": BETWEEN + "sigma of a step of the time tags that is excluded",
    "navigation.mag_gate": BETWEEN + "NIS of a disturbed field",
    "navigation.min_events_unknown_rate": BETWEEN + "number of events by which a heading is found",
    "navigation.heading_min_level": BETWEEN + "level part of a compass's axis",
    "navigation.max_chord_turn": BETWEEN + "turn of north from one fix to the next",
    "navigation.contradicted_residual": BETWEEN + "mean NIS of fixes with a compass the wrong way round",
    "attitude.clipping_slope_kept": BETWEEN + "change of the slope with which a rate comes to the end of the range",
    "attitude.clipping_return_slope": BETWEEN + "slope with which a rate comes back from beyond the range",
    "attitude.flat_step": BETWEEN + "step of a rate beside the end of the range",
    "riss.min_white_position": "the white noise of no receiver in the recordings comes down to it",
    "riss.min_white_velocity": "as above",
    "riss.min_white_height": "as above",
    "riss.wheel_sign_sigmas": BETWEEN + "speed at which the sign of a reading is known",
    "navigation.long_gap_periods": "no recording has a sensor slower than 50 Hz",
    "navigation.new_quality_ratio": BETWEEN + "ratio of a reported sigma to the last one",
    "navigation.wheel_open_count": BY_WHEELS,
    "navigation.fix_age_min_pairs": BETWEEN + "number of pairs of fixes when an age is found",
    "navigation.heading_turn_memory": "headings that do not turn are found within few intervals, in all recordings",
}

EARLY = {  # between them these notice what test_mutate.py tries; each of the others notices less
    *("navigation-rest-gaps", "navigation-odometer-and-compass", "navigation-graded-drifts-under-way"),
    *("navigation-pose-of-a-map-that-is-turned", "navigation-compass-and-a-wrong-lever-arm", "navigation-late-stamps"),
    *("navigation-slow-drift-against-velocity-that-lasts", "navigation-no-velocity", "navigation-odometer"),
    *("navigation-overconfident-receiver", "navigation-odometer-against-a-drift", "attitude-start-in-a-steady-turn"),
    *("navigation-compass-mounted-wrong-without-boresight", "navigation-barometer-of-another-height"),
    *("attitude-gaps-of-about-a-second", "attitude-multicopter", "navigation-step-of-the-bias-in-an-outage"),
    "navigation-vibrating-gyro-at-rest",
}


@dataclass(frozen=True)
class Mutant:
    """A change of one tunable."""

    estimator: str
    tunable: Tunable

    @property
    def name(self) -> str:
        return f"{self.estimator}.{self.tunable.name}"

    @property
    def value(self) -> float:
        """A quarter more, of a whole number one more at least; less where so much is not allowed."""
        default = self.tunable.default
        step = max(1, round(0.25 * abs(default))) if isinstance(default, int) else 0.25 * default or 0.25
        return default + step if self.tunable.accepts(default + step) else default - step

    @property
    def reason(self) -> str | None:
        """Why no trace notices it, if that is known."""
        return NOT_NOTICED.get(self.name)

    def applied(self, original: Recording) -> Recording:
        """The recording with settings that have the change."""
        settings, table = original.settings, registry.by_name(self.estimator).table
        tuning = {**getattr(settings, table).tuning, self.tunable.name: self.value}
        changed = {table: msgspec.structs.replace(getattr(settings, table), tuning=tuning)}
        return dataclasses.replace(original, settings=msgspec.structs.replace(settings, **changed))


def mutants(beginnings=("",)) -> list[Mutant]:
    """All whose names begin so."""
    found = [Mutant(name, tunable) for name in registry.NAMES for tunable in registry.by_name(name).tunables]
    return [mutant for mutant in found if mutant.name.startswith(tuple(beginnings))]


class Search:
    """Looks for a golden trace that differs; those that did for the last mutants come first, then the EARLY ones."""

    def __init__(self) -> None:
        self._order = sorted(CLASSES, key=lambda name: name not in EARLY)

    def noticed_by(self, mutant: Mutant) -> str | None:
        """The name of a golden trace that the change moves; None: it moves none."""
        for name in self._order:
            if name.startswith(mutant.estimator) and differences(_golden(name), traced(name, mutant.applied)):
                self._order.remove(name)
                self._order.insert(0, name)
                return name
        return None


@functools.cache
def _golden(name):
    return read(name)


def not_noticed(share: list[Mutant], verbose: bool) -> list[Mutant]:
    """Those of the mutants that move no golden trace."""
    search, alive = Search(), []
    for mutant in share:
        name = search.noticed_by(mutant)
        alive += [mutant] if name is None else []
        if verbose:
            print(f"{mutant.name} {mutant.value:g}: {name}", flush=True)
    return alive


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("names", nargs="*", default=[""], metavar="NAME")
    parser.add_argument("--quick", action="store_true", help="do not try those with a reason")
    parser.add_argument("--jobs", type=int, default=1, metavar="N")
    parser.add_argument("-v", "--verbose", action="store_true", help="say which trace notices each")
    args = parser.parse_args()
    every = mutants(args.names)
    if not every:
        parser.error("no tunable's name begins so; `imud reference tuning` lists them")
    tried = [mutant for mutant in every if not (args.quick and mutant.reason)]
    shares = [tried[k * len(tried) // args.jobs : (k + 1) * len(tried) // args.jobs] for k in range(args.jobs)]
    with multiprocessing.Pool(args.jobs) as pool:
        found = pool.map(functools.partial(not_noticed, verbose=args.verbose), shares, chunksize=1)
    left = {mutant for share in found for mutant in share} | set(every).difference(tried)
    alive = [mutant for mutant in every if mutant in left]
    for mutant in alive:
        print(f"not noticed: {mutant.name} {mutant.tunable.default:g} as {mutant.value:g} ({mutant.reason})")
    percent = 100.0 * (1.0 - len(alive) / len(every))
    print(f"{percent:.1f} % of {len(every)} tunables are noticed")
    sys.exit(percent < LEAST_PERCENT or any(mutant.reason is None for mutant in alive))


if __name__ == "__main__":
    main()
