"""Recorded drives through the navigation filter: CSV in, estimate out, each fix at its arrival, then the score."""

from __future__ import annotations

import functools
import importlib.util
from pathlib import Path

import numpy as np
from replay_in_process import new_filter, replay

from imud.batch import NO_MEASUREMENT
from imud.configuration.settings import Settings
from imud.drivers.sample import SAMPLE
from imud.estimators.records import ASSUMED, FIX

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def nanoseconds(t_s):
    return np.round(np.asarray(t_s) * 1e9).astype(np.int64)


def samples_of(t_s, w, f):
    rows = np.zeros(len(t_s), SAMPLE)
    rows["t_ns"], rows["w"], rows["f"] = nanoseconds(t_s), w, f
    rows["temperature"] = np.nan
    return rows


def fixes_of(columns, n):
    """FIX rows from columns by name (the names of gnss.csv), NaN where there is none."""
    none = np.full(n, np.nan)
    get = lambda name: np.asarray(columns[name]) if name in columns else none  # noqa: E731
    rows = np.zeros(n, FIX)
    rows["t_ns"] = nanoseconds(columns["t_s"])
    rows["arrival_ns"] = nanoseconds(columns.get("arrival_s", columns["t_s"]))
    rows["lat"], rows["lon"] = np.radians(get("lat_deg")), np.radians(get("lon_deg"))
    rows["height"], rows["hdop"], rows["speed"] = get("height_m"), get("hdop"), get("speed_mps")
    rows["course"] = np.radians(get("course_deg"))
    rows["sigma"] = np.column_stack([get(c) for c in ("sn_m", "se_m", "sd_m")])
    rows["v"] = np.column_stack([get(c) for c in ("vn_mps", "ve_mps", "vd_mps")])
    rows["quality"], rows["satellites"] = 1, -1
    return rows


@functools.lru_cache(maxsize=8)  # the files of one recording: tests with it follow each other
def numbers(path):
    """The names of a CSV file's columns, and its rows; NaN where there is no number."""
    text = path.read_text().replace(",,", ",nan,").replace(",,", ",nan,").replace(",\n", ",nan\n")
    head, *lines = text.splitlines()
    return head.split(","), np.loadtxt(lines, delimiter=",", ndmin=2)


def read(path):
    names, values = numbers(path)
    return {name: values[:, i] for i, name in enumerate(names)}


def load(folder, grade):
    imu = read(folder / "imu.csv")
    w = np.column_stack([imu[c] for c in ("gx_radps", "gy_radps", "gz_radps")])
    f = np.column_stack([imu[c] for c in ("ax_mps2", "ay_mps2", "az_mps2")])
    fixes = read(folder / f"gnss_{grade}.csv")
    return samples_of(imu["t_s"], w, f), fixes_of(fixes, len(fixes["t_s"]))


def navigate(samples, fixes, settings=None, initial=None, aiding=NO_MEASUREMENT):
    """(solutions, innovations of the fixes, final state) of one pass."""
    filter_ = new_filter("navigation", samples, settings, initial)
    out, innovations = replay(filter_, samples, fixes, aiding)
    return out, innovations[~np.isin(innovations["kind"], ASSUMED)], filter_.state


def euler_deg(q):
    w, x, y, z = q.T
    roll = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - x * z), -1, 1))
    return np.degrees(np.column_stack([roll, pitch, np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))]))


def table(out):
    """The columns of est.csv as the scorer reads them (t s, deg, m, m/s, deg, and the sigmas); rows with a position."""
    rows = np.column_stack(
        [
            out["t_ns"] * 1e-9,
            np.degrees(out["lat"]),
            np.degrees(out["lon"]),
            out["height"],
            out["v"],
            euler_deg(out["q_nb"]),
            out["sigma_p"],
            out["sigma_v"],
            np.degrees(out["sigma_rpy"]),
        ]
    )
    return rows[np.isfinite(rows[:, 1])]


def scorer():
    spec = importlib.util.spec_from_file_location("score_navigation", SHARED / "score_navigation.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def truth_of(folder):
    _, truth = numbers(folder / "truth.csv")
    return truth[truth[:, 10] == 1]


def without(fixes, windows):
    keep = np.ones(len(fixes), bool)
    for begin, end, _ in windows:
        t = fixes["t_ns"] * 1e-9
        keep &= ~((t > begin) & (t <= end))
    return fixes[keep]


def outage_ends(score, est, truth, lever, windows):
    """Horizontal and normalised error at the end of each window."""
    t, d, _ = score.errors(est, truth, lever)
    ends = []
    for begin, end, _ in windows:
        k = np.flatnonzero((t >= begin) & (t <= end))
        if len(k) and t[k[-1]] > end - 2:
            s = [np.interp(t[k[-1]], est[:, 0], est[:, c]) for c in (10, 11)]
            ends.append((np.hypot(*d[k[-1], :2]), 0.5 * ((d[k[-1], 0] / s[0]) ** 2 + (d[k[-1], 1] / s[1]) ** 2)))
    return ends


def settings_of(vehicle="auto", lever=(0.0, 0.0, 0.0), profile="auto", tuning=None, lever_arm_sigma_m=0.0):
    from imud.configuration.settings import Imu, Navigation

    if not isinstance(lever, str):
        lever = tuple(map(float, lever))
    arm = {"lever_arm_m": lever, "lever_arm_sigma_m": lever_arm_sigma_m}
    return Settings(imu=Imu(profile=profile), navigation=Navigation(vehicle=vehicle, tuning=tuning or {}, **arm))
