"""How much each tunable of the attitude filter matters, on recordings with optical truth, as a table in Markdown.

Usage: python tests/tuning_sensitivity.py [NAME...]. Each tunable is made 25 % smaller and 25 % larger. The table has
the change of the mean RMS tilt error and of the mean size of the drift, over all trials of ../shared/data/attitude
but one whose gyro is beyond its range throughout. Tunables that change neither by 1 % are left out.
"""

import sys
from pathlib import Path

import numpy as np
from broad import HALF_TURN_ABOUT_X, samples_of

from imud.configuration.settings import Attitude, Initial, Settings
from imud.estimators import registry
from imud.estimators.records import SOLUTION
from imud.pipeline import Filter

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
LEFT_OUT = "TStick_Test05"
LEAST_PERCENT = 1.0
FACTORS = (0.75, 1.25)
ESTIMATOR = registry.by_name("attitude")


def errors_of(trial, tuning):
    """(RMS tilt error in deg, size of the heading drift in deg/min) of one trial."""
    import score_attitude

    samples = samples_of(trial["t"], trial["gyr"] * HALF_TURN_ABOUT_X, trial["acc"] * HALF_TURN_ABOUT_X)
    rate_hz = 1e9 / float(np.median(np.diff(samples["t_ns"])))
    settings = Settings(attitude=Attitude(tuning=tuning))
    filter_ = Filter(ESTIMATOR, settings, Initial(), rate_hz)
    out = np.zeros(len(samples), SOLUTION)
    filter_.run(samples, out)
    found = score_attitude.errors(out["q_nb"] * np.concatenate([[1.0], HALF_TURN_ABOUT_X]), trial)
    return found["incl"], abs(found["drift"])


def means(trials, tuning):
    return np.nanmean([errors_of(trial, tuning) for trial in trials], axis=0)


def row(trials, tunable, usual):
    """Changes in percent: tilt smaller, drift smaller, tilt larger, drift larger."""
    kind = type(tunable.default)
    changed = [means(trials, {tunable.name: kind(factor * tunable.default)}) for factor in FACTORS]
    return 100.0 * (np.concatenate(changed) / np.tile(usual, len(FACTORS)) - 1.0)


def main(names):
    sys.path.append(str(DATA))
    import score_attitude

    files = sorted((DATA / "attitude").glob("*.npz"))
    trials = [score_attitude.load(path) for path in files if LEFT_OUT not in path.name]
    usual = means(trials, {})
    print(f"{len(trials)} trials: tilt {usual[0]:.3f} deg, drift {usual[1]:.3f} deg/min\n")
    print("| tunable | tilt, -25 % | drift, -25 % | tilt, +25 % | drift, +25 % |\n|---|---|---|---|---|")
    for tunable in ESTIMATOR.tunables:
        if not names or tunable.name in names:
            changes = row(trials, tunable, usual)
            if np.max(np.abs(changes)) >= LEAST_PERCENT:
                print(f"| `{tunable.name}` | {' | '.join(f'{change:+.1f} %' for change in changes)} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
