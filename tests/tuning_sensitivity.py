"""How much each tunable of the filters matters on recordings with truth, as tables in Markdown.

    python tests/tuning_sensitivity.py [NAME..]     NAME: `attitude.KEY` or `navigation.KEY`, or its beginning

Each tunable is made 25 % smaller and 25 % larger ("-": beyond its range). The table has the changes of some figures;
tunables that change none of them by as much as a limit are left out.

attitude: mean RMS tilt error and mean size of the drift, over all trials of ../shared/data/attitude but one whose gyro
is beyond its range throughout. navigation: over five drives and flights of ../shared/data/navigation, the geometric
means of the RMS error of horizontal position and velocity from one minute after the first solution on, of the
horizontal error at the end of outages (cars: 60 s, slow vehicle: 30 s; median), and of the NEES of the position.
"""

import functools
import json
import sys

import navigation_runner
import numpy as np
from broad import HALF_TURN_ABOUT_X, samples_of

from imud.configuration.settings import Attitude, Initial, Navigation, Settings
from imud.estimators import registry
from imud.estimators.records import SOLUTION
from imud.pipeline import Filter

LEFT_OUT = "TStick_Test05"
FACTORS = (0.75, 1.25)
DRIVES = {  # recording: fixes, length of the outages
    "ixr-0412": ("receiver_like", "60"),
    "rtkx-drive": ("receiver_like", "60"),
    "dtu-ugv4": ("nmea_grade", "30"),
    "umn-thor75": ("ned", None),
    "apm-quad106": ("nmea", None),
}


@functools.cache
def trials():
    """The trials of the attitude recordings, and the module that scores them."""
    sys.path.append(str(navigation_runner.SHARED))
    import score_attitude

    files = sorted((navigation_runner.SHARED / "attitude").glob("*.npz"))
    return score_attitude, [score_attitude.load(path) for path in files if LEFT_OUT not in path.name]


def errors_of(trial, tuning):
    """(RMS tilt error in deg, size of the heading drift in deg/min) of one trial."""
    samples = samples_of(trial["t"], trial["gyr"] * HALF_TURN_ABOUT_X, trial["acc"] * HALF_TURN_ABOUT_X)
    rate_hz = 1e9 / float(np.median(np.diff(samples["t_ns"])))
    filter_ = Filter(registry.by_name("attitude"), Settings(attitude=Attitude(tuning=tuning)), Initial(), rate_hz)
    out = np.zeros(len(samples), SOLUTION)
    filter_.run(samples, out)
    found = trials()[0].errors(out["q_nb"] * np.concatenate([[1.0], HALF_TURN_ABOUT_X]), trial)
    return found["incl"], abs(found["drift"])


def attitude(tuning):
    return np.nanmean([errors_of(trial, tuning) for trial in trials()[1]], axis=0)


@functools.cache
def recorded(name):
    """Samples, fixes, truth, lever arm, the lever arm to the truth's point, and outages of a drive."""
    folder, (grade, length) = navigation_runner.SHARED / "navigation" / name, DRIVES[name]
    meta = json.loads((folder / "meta.json").read_text())
    windows = json.loads((folder / "outages.json").read_text())[length][0] if length else []
    to_truth = meta["lever_frd"] if meta["truth_point"] == "antenna" else None
    samples, fixes = navigation_runner.load(folder, grade)
    return samples, fixes, navigation_runner.truth_of(folder), tuple(map(float, meta["lever_frd"])), to_truth, windows


def figures_of(name, tuning):
    """Position m, velocity m/s, NEES of the position; of drives with outages also the error at their ends, m."""
    samples, fixes, truth, lever, to_truth, windows = recorded(name)
    settings, score = Settings(navigation=Navigation(lever_arm_m=lever, tuning=tuning)), navigation_runner.scorer()
    estimate = navigation_runner.table(navigation_runner.navigate(samples, fixes, settings)[0])
    t, d, _ = score.errors(estimate, truth, to_truth)
    late = t > t[0] + 60.0
    nees = score.nees(estimate, t[late], d[late])["pos"]["anees"]
    ends = np.nan
    if windows:
        cut = navigation_runner.navigate(samples, navigation_runner.without(fixes, windows), settings)[0]
        found = navigation_runner.outage_ends(score, navigation_runner.table(cut), truth, to_truth, windows)
        ends = np.median([error for error, _ in found])
    squares = np.nansum(d[late, :2] ** 2, axis=1), np.nansum(d[late, 3:5] ** 2, axis=1)
    return np.sqrt(squares[0].mean()), np.sqrt(squares[1].mean()), ends, nees


def navigation(tuning):
    return np.exp(np.nanmean(np.log([figures_of(name, tuning) for name in DRIVES]), axis=0))


FILTERS = {  # figures, their names with units, and the least change in percent that is shown
    "attitude": (attitude, ("tilt, deg", "drift, deg/min"), 1.0),
    "navigation": (navigation, ("position, m", "velocity, m/s", "outage, m", "NEES"), 5.0),
}


def row(figures, tunable, usual):
    """Changes in percent: all figures with the tunable smaller, then larger."""
    kind = type(tunable.default)
    values = [kind(factor * tunable.default) for factor in FACTORS]
    changed = [figures({tunable.name: v}) if tunable.accepts(v) else np.full(len(usual), np.nan) for v in values]
    return 100.0 * (np.concatenate(changed) / np.tile(usual, len(FACTORS)) - 1.0)


def table(estimator, beginnings):
    figures, names, least = FILTERS[estimator]
    usual = figures({})
    print(f"{estimator}: {'; '.join(f'{name} {value:.3f}' for name, value in zip(names, usual, strict=True))}\n")
    heads = [f"{name.split(',')[0]}, {change}" for change in ("-25 %", "+25 %") for name in names]
    print(f"| tunable | {' | '.join(heads)} |\n|{'---|' * (1 + len(heads))}")
    for tunable in registry.by_name(estimator).tunables:
        if f"{estimator}.{tunable.name}".startswith(beginnings):
            changes = row(figures, tunable, usual)
            if np.nanmax(np.abs(changes), initial=0.0) >= least:
                cells = ["-" if np.isnan(change) else f"{change:+.1f} %" for change in changes]
                print(f"| `{tunable.name}` | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    names = tuple(sys.argv[1:]) or ("",)
    for estimator in FILTERS:
        if any(f"{estimator}.".startswith(name) or name.startswith(estimator) for name in names):
            table(estimator, names)
