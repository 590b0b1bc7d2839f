"""Prasanna, Vehicle Localisation Using GPS and IMU: his GPS track, table-top loop and tilt, simulated.

The walk: 700 m in Singapore with a receiver of the FV-M11's 3.3 m CEP at 1 Hz. The loop: a rectangle of 1.5 m by
2.0 m, anticlockwise from its bottom right corner back to it, after a rest, with an M-G350. He prints no numbers for
either, only figures and verdicts ("smoother", "very high drift"); these are the claims.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..configuration.settings import GpsTrack, Imu, Initial, Settings
from ..estimators import gps_track, ins9, registry
from ..estimators.records import FIX, SOLUTION
from ..kernels.earth import STANDARD_GRAVITY, radii
from ..kernels.rotation import euler_of_quat
from ..pipeline import Filter
from .prasanna_figures import gps_figure, loop_figure, tilt_figure
from .report import Floats, Report, Row, at_most, rms, within
from .simulate import PROFILE, level_at_rest, m_g350, samples_of

LAT, LON = math.radians(1.3), math.radians(103.77)  # rad, National University of Singapore
CEP_M = 3.3  # of the receiver, its data sheet
SIGMA_M = CEP_M / math.sqrt(2.0 * math.log(2.0))  # per axis: half of the fixes lie within the CEP
SPHERE_M = 6378.14e3  # his radius of the earth
WALK_S = 500
LOOP_HZ, REST_S, SIDE_S, PAUSE_S = 200.0, ins9.REST_S + 1.0, 3.0, 0.5
CORNERS = ((0.0, 0.0), (2.0, 0.0), (2.0, -1.5), (0.0, -1.5), (0.0, 0.0))  # m, north and east
STRAY_M = 0.75  # half the short side: the rectangle is still one; three times the computed sigma at the end
TILTS_DEG = (0.0, 10.0, 30.0, 60.0, 90.0, 130.0, 180.0)


@dataclass(frozen=True)
class Track:
    """A filtered track against the truth, at the fixes; m and m/s, columns north and east."""

    t: Floats
    truth: Floats
    raw: Floats
    p: Floats
    v: Floats
    sigma_p: Floats
    sigma_v: Floats
    nis: Floats


def _parameter_rows() -> list[Row]:
    """What the settings begin with."""
    settings = Settings()
    printed = (
        ("GPS: Q", "0.2", settings.gps_track.acceleration_var, 0.2),
        ("GPS: R", "0.5", settings.gps_track.position_var, 0.5),
        ("GPS: least number of satellites", "greater than 4", settings.gnss.min_satellites, 5),
        ("INS: Q (ours: per second)", "0.7", settings.ins9.acceleration_walk, 0.7),
        ("INS: R", "0.2", settings.ins9.distance_var, 0.2),
    )
    return [Row(quantity, his, f"{ours:g}", ours == expected) for quantity, his, ours, expected in printed]


def walk(t: Floats) -> Floats:
    """North and east in m at t s: about 1.4 m/s along a bending path."""
    heading = 0.6 + 1.1 * np.sin(2.0 * np.pi * t / 170.0) + 0.5 * np.sin(2.0 * np.pi * t / 61.0)
    step = 1.4 * (t[1] - t[0])
    return np.cumsum(step * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)


def tracked(truth: Floats, raw: Floats, t: Floats, settings: Settings) -> Track:
    """Fixes at t s through `gps-track`, read at each fix."""
    meridian, prime_vertical = radii(LAT)
    scale = np.array([meridian, prime_vertical * math.cos(LAT)])
    filter_ = Filter(gps_track.ESTIMATOR, settings, Initial(), 1.0)
    samples, out = samples_of(t, *level_at_rest(len(t))), np.zeros(1, SOLUTION)
    fix = np.zeros(1, FIX)
    for name in ("sigma", "v", "hdop", "speed", "course", "height"):
        fix[name] = math.nan
    fix["quality"] = 1
    rows, nis = [], []
    for k in range(len(t)):
        fix["t_ns"] = fix["arrival_ns"] = samples["t_ns"][k]
        fix["lat"], fix["lon"] = np.array([LAT, LON]) + raw[k] / scale
        innovations = filter_.update(fix)
        nis.append(
            float(np.mean(innovations["value"] ** 2 / innovations["variance"])) if len(innovations) else math.nan
        )
        filter_.run(samples[k : k + 1], out)
        o = out[0]
        rows.append(
            [*(np.array([o["lat"] - LAT, o["lon"] - LON]) * scale), *o["v"][:2], *o["sigma_p"][:2], *o["sigma_v"][:2]]
        )
    r = np.array(rows)
    return Track(t, truth, raw, r[:, 0:2], r[:, 2:4], r[:, 4:6], r[:, 6:8], np.array(nis))


def roughness(p: Floats) -> float:
    """RMS second difference in m: what smoothing takes away."""
    return rms(np.diff(p, 2, axis=0))


def _gps_rows(his: Track, matched: Track) -> list[Row]:
    late = slice(20, None)
    raw = rms((his.raw - his.truth)[late]) * math.sqrt(2.0)
    raw_v = rms((np.diff(his.raw, axis=0) - np.diff(his.truth, axis=0))[late]) * math.sqrt(2.0)
    rows = []
    for name, track in (("Q, R as printed", his), ("R of the receiver, Q of a walk", matched)):
        p = rms((track.p - track.truth)[late]) * math.sqrt(2.0)
        v = rms(track.v[late] - np.gradient(track.truth, axis=0)[late]) * math.sqrt(2.0)
        rough = roughness(track.p[late]) / roughness(track.raw[late])
        rows += [
            at_most(f"GPS: horizontal RMS, {name} (raw {raw:.2f})", "improved", p, raw, "m"),
            at_most(f"GPS: velocity RMS, {name} (raw {raw_v:.2f})", "improved", v, raw_v, "m/s"),
            at_most(f"GPS: roughness of raw, {name}", "smoother", rough, 1.0),
        ]
    nis = float(np.nanmean(matched.nis[late]))
    spread = 4.0 * math.sqrt(1.0 / (WALK_S - 20))
    rows.append(within("GPS: mean NIS per axis, matched", "not asked", nis, 1.0 - spread, 1.0 + spread))
    overconfident = float(np.nanmean(his.nis[late]))
    rows.append(Row("GPS: mean NIS per axis, Q, R as printed", "not asked", f"{overconfident:.2f}: R is too small"))
    return rows


def _distance_rows() -> list[Row]:
    """His metres per degree of longitude against the ellipsoid's, which differ by cos(latitude) and 0.2 %."""
    rows = []
    for lat_deg, where in ((1.3, "Singapore"), (48.0, "Munich")):
        _, prime_vertical = radii(math.radians(lat_deg))
        ours = math.radians(1.0) * prime_vertical * math.cos(math.radians(lat_deg))
        his = math.radians(1.0) * SPHERE_M
        text = f"{ours:.0f} m ({100.0 * (his / ours - 1.0):+.2f} % in the print)"
        same = abs(his * math.cos(math.radians(lat_deg)) / ours - 1.0) < 0.005
        rows.append(Row(f"1 deg of longitude, {where}", f"{his:.0f} m", text, same))
    return rows


def loop(t: Floats) -> tuple[Floats, Floats]:
    """Positions (north, east, down) in m and accelerations of the table-top loop at t s: rest, four sides, rest."""
    p, a = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for k in range(4):
        here, there = np.array(CORNERS[k]), np.array(CORNERS[k + 1])
        u = np.clip((t - REST_S - k * (SIDE_S + PAUSE_S)) / SIDE_S, 0.0, 1.0)[:, None]
        moving = (u > 0.0) & (u < 1.0)
        p[:, :2] += (there - here) * (u - np.sin(2.0 * np.pi * u) / (2.0 * np.pi))
        a[:, :2] += (there - here) * 2.0 * np.pi / SIDE_S**2 * np.sin(2.0 * np.pi * u) * moving
    return p, a


@dataclass(frozen=True)
class Loop:
    """The loop as he plots it; m, columns north, east, down."""

    t: Floats
    truth: Floats
    measured: Floats
    predicted: Floats
    estimated: Floats
    acceleration: Floats
    acceleration_sigma: Floats
    true_acceleration: Floats
    reckoned_sigma: Floats
    sigma: Floats
    literal: Floats
    literal_sigma: Floats


def as_printed(samples: Any, t: Floats) -> Floats:
    """His dead reckoning of a level unit, where 9.8 sin(angle) is 0: sums, and no biases removed."""
    dt = t[1] - t[0]
    p: Floats = np.cumsum(np.cumsum(samples["f"][:, :2], axis=0) * dt, axis=0) * dt
    return p


def looped(rng: np.random.Generator) -> Loop:
    """The table-top loop through `ins9`."""
    t = np.arange(0.0, REST_S + 4.0 * (SIDE_S + PAUSE_S), 1.0 / LOOP_HZ)
    truth, a = loop(t)
    w, f = level_at_rest(len(t))
    samples = m_g350(rng, t, w, f + a)
    settings = Settings(imu=Imu(profile="m-g350"))
    initial = Initial(lat_deg=math.degrees(LAT), lon_deg=math.degrees(LON), yaw_deg=0.0)
    p = ins9.configure(settings, LOOP_HZ)
    s = ins9.start(p, initial)
    out, rows = np.zeros(1, SOLUTION), []
    for k in range(len(t)):
        ins9.step(p[0], s[0], samples[k], out[0])
        drift, _ = ins9.reckoning_variance(p[0], s[0], 0)
        rows.append(
            [
                *s["reckoned_p"][0],
                *s["predicted"][0],
                *s["p"][0],
                *s["a"][0],
                math.sqrt(drift),
                math.sqrt(drift + s["P"][0, 0]),
                math.sqrt(s["P"][0, 5]),
            ]
        )
    r = np.array(rows)
    biased = 0.5 * PROFILE.accel_bias_initial * t**2
    literal = as_printed(samples, t)
    return Loop(t, truth, r[:, 0:3], r[:, 3:6], r[:, 6:9], r[:, 9:12], r[:, 14], a, r[:, 12], r[:, 13], literal, biased)


def _loop_rows(run: Loop) -> list[Row]:
    level = slice(0, 2)
    off = np.linalg.norm((run.estimated - run.truth)[:, level], axis=1)
    printed = float(np.linalg.norm(run.literal[-1] - run.truth[-1, level]))
    share = float(np.max(np.abs((run.estimated - run.truth)[:, level]) / run.sigma[:, None].clip(1e-6)))
    drift = Row("table top: end as printed, no bias removed", "very high drift", f"{printed:.2f} m", printed > 1.0)
    return [
        drift,
        at_most("table top: end with ins9", "expected: 0", float(off[-1]), STRAY_M, "m"),
        at_most("table top: farthest from the true path", "not rectangular", float(off.max()), STRAY_M, "m"),
        at_most("table top: worst |error| / σ", "not asked", share, 4.0),
    ]


def tilted(rng: np.random.Generator, tilt_deg: float) -> tuple[float, float, float, float]:
    """Tilt in deg and its sigma from the `tilt` estimator, roll in deg, and what his formula takes the acos of."""
    t = np.arange(0.0, 3.0, 1.0 / 125.0)
    angle = math.radians(tilt_deg)
    w, f = level_at_rest(len(t))
    f = np.column_stack([f[:, 0], f[:, 2] * math.sin(angle), f[:, 2] * math.cos(angle)])
    samples = m_g350(rng, t, w, f)
    filter_ = Filter(registry.by_name("tilt"), Settings(imu=Imu(profile="m-g350")), Initial(), 125.0)
    out = np.zeros(len(t), SOLUTION)
    filter_.run(samples, out)
    roll, pitch, _ = euler_of_quat(tuple(out["q_nb"][-1]))
    acc = -samples["f"].mean(axis=0)
    tilt = math.degrees(math.acos(math.cos(roll) * math.cos(pitch)))
    return tilt, math.degrees(out["sigma_rpy"][-1, 0]), math.degrees(roll), float(np.linalg.norm(acc) / acc[2])


def _tilt_rows(tilts: list[tuple[float, float, float, float]]) -> list[Row]:
    rows = []
    limit = math.degrees(4.0 * PROFILE.accel_bias_initial / STANDARD_GRAVITY)
    for true, (tilt, sigma, roll, ratio) in zip(TILTS_DEG, tilts, strict=True):
        ok = abs(tilt - true) < limit and abs(math.remainder(roll - true, 360.0)) < limit
        text = f"{tilt:.2f} ± {sigma:.2f} deg"
        rows.append(Row(f"tilt at {true:.0f} deg", f"acos({ratio:.3f}): none" if abs(ratio) > 1 else "0", text, ok))
    upside_down = tilts[-1][2]
    rows.append(
        Row("orientation with z up", "roll 180 deg", f"roll {upside_down:.2f} deg", abs(abs(upside_down) - 180) < limit)
    )
    return rows


def reproduce(seed: int) -> Report:
    """His verdicts and figures."""
    rng = np.random.default_rng(seed)
    t = np.arange(1.0, WALK_S + 1.0)
    truth = walk(t)
    raw = truth + SIGMA_M * rng.standard_normal(truth.shape)
    his = tracked(truth, raw, t, Settings())
    matched = tracked(truth, raw, t, Settings(gps_track=GpsTrack(acceleration_var=0.01, position_var=SIGMA_M**2)))
    run = looped(rng)
    tilts = [tilted(rng, angle) for angle in TILTS_DEG]
    rows = [*_parameter_rows(), *_gps_rows(his, matched), *_distance_rows(), *_loop_rows(run), *_tilt_rows(tilts)]
    figures = [gps_figure(his, matched, SIGMA_M), loop_figure(run), tilt_figure(TILTS_DEG, tilts)]
    return Report("Prasanna, Vehicle Localisation Using GPS and IMU", rows, figures)
