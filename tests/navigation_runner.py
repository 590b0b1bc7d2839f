"""Recorded drives through the navigation filter: CSV in, estimate out, each fix at its arrival, then the score."""

from __future__ import annotations

import functools
import importlib.util
import json
import sys
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


def evaluate(name, grade, vehicle="auto", outages=("60", "30"), profile="auto"):
    """Figures of one recording: RMS, NEES, outage errors."""
    score, folder = scorer(), SHARED / "navigation" / name
    meta = json.loads((folder / "meta.json").read_text())
    lever = meta["lever_frd"] if meta["truth_point"] == "antenna" else None
    settings = settings_of(vehicle, meta["lever_frd"], profile)
    samples, fixes = load(folder, grade)
    truth = truth_of(folder)
    est = table(navigate(samples, fixes, settings)[0])
    t, d, _ = score.errors(est, truth, lever)
    m = score.steady(t, str(folder / f"gnss_{grade}.csv")) & (t > t[0] + 100 * (name[:3] == "ixr") + 60)
    figures = {"channels": score.stats(d[m]), "nees": score.nees(est, t[m], d[m]), "outages": {}}
    for length in outages:
        ends = []
        for windows in json.loads((folder / "outages.json").read_text()).get(length, []):
            cut = table(navigate(samples, without(fixes, windows), settings)[0])
            ends += outage_ends(score, cut, truth, lever, windows)
        if ends:
            figures["outages"][length] = np.array(ends)
    return figures


def settings_of(vehicle="auto", lever=(0.0, 0.0, 0.0), profile="auto", tuning=None, lever_arm_sigma_m=0.0):
    from imud.configuration.settings import Imu, Navigation

    if not isinstance(lever, str):
        lever = tuple(map(float, lever))
    arm = {"lever_arm_m": lever, "lever_arm_sigma_m": lever_arm_sigma_m}
    return Settings(imu=Imu(profile=profile), navigation=Navigation(vehicle=vehicle, tuning=tuning or {}, **arm))


def line(name, grade, vehicle, figures):
    c, n = figures["channels"], figures["nees"]
    text = (
        f"{name:9s} {grade:13s} {vehicle:5s} pH {c['pH']['rms']:7.3f} pD {c['pD']['rms']:6.3f} vH {c['vH']['rms']:6.3f}"
    )
    text += f" vD {c['vD']['rms']:6.3f} NEES p {n['pos']['anees']:5.2f} v {n['vel']['anees']:5.2f}"
    if "yaw" in c:
        text += (
            f" rpy {c['roll']['rms']:.2f} {c['pitch']['rms']:.2f} {c['yaw']['rms']:.2f} NEES a {n['att']['anees']:.2f}"
        )
    for length, e in figures["outages"].items():
        rms = np.sqrt(np.mean(e[:, 0] ** 2))
        text += (
            f" | {length}s med {np.median(e[:, 0]):.1f} rms {rms:.1f} max {e[:, 0].max():.1f} nees {e[:, 1].mean():.1f}"
        )
    return text


if __name__ == "__main__":
    wanted = sys.argv[1].split(",") if len(sys.argv) > 1 else ["ixr-0412", "dtu-ugv4"]
    grades = sys.argv[2].split(",") if len(sys.argv) > 2 else ["rtk", "nmea_grade", "receiver_like"]
    vehicles = sys.argv[3].split(",") if len(sys.argv) > 3 else ["auto"]
    for n in wanted:
        for g in grades:
            for v in vehicles:
                print(line(n, g, v, evaluate(n, g, v, ("60", "30") if len(sys.argv) < 5 else ())), flush=True)
