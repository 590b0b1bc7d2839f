"""Prasanna, Vehicle Localisation Using GPS and IMU: his GPS track, table-top loop and tilt, simulated.

The loop: a rectangle of 1.5 m by 2.0 m, anticlockwise from its bottom right corner back to it, after a rest, with an
M-G350. He prints no numbers for it nor for the track, only figures and verdicts ("smoother", "very high drift"); these
are the claims.
"""

import math
from typing import Any

import numpy as np

from imud.drivers.crossbow import packet

from ..compile.jit import interpreted
from ..configuration.settings import Imu, Initial, Settings
from ..estimators import registry
from ..estimators.papers import ins9
from ..estimators.records import SOLUTION
from ..math.arrays import Floats
from ..math.earth import STANDARD_GRAVITY
from ..math.rotation import euler_of_quat
from ..pipeline import Filter
from .compensation import compensation_rows
from .gps_walk import LAT, LON, SIGMA_M, distance_rows, gps_rows, walked
from .prasanna_figures import gps_figure, loop_figure, tilt_figure
from .report import Report, Row, at_most
from .runs import LoopRun
from .simulate import PROFILE, level_at_rest, m_g350

LOOP_HZ, REST_S, SIDE_S, PAUSE_S = 200.0, ins9.REST_S + 1.0, 3.0, 0.5
CORNERS = ((0.0, 0.0), (2.0, 0.0), (2.0, -1.5), (0.0, -1.5), (0.0, 0.0))  # m, north and east
ERROR_MAX_M = 0.75  # half the short side: the rectangle is still one; three times the computed sigma at the end
TILTS_DEG = (0.0, 10.0, 30.0, 60.0, 90.0, 130.0, 180.0)


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
    counts = (
        ("DMU: acceleration of a count", "2 · 1.5 / 2¹⁵ g", packet.ACCEL_SCALE / STANDARD_GRAVITY, 3.0 / 32768.0),
        ("DMU: rate of a count", "100 · 1.5 / 2¹⁵ deg/s", math.degrees(packet.RATE_SCALE), 150.0 / 32768.0),
        ("DMU: angle of a count", "180 / 2¹⁵ deg", math.degrees(packet.ANGLE_SCALE), 180.0 / 32768.0),
    )
    return [
        Row(quantity, his, f"{ours:g}", math.isclose(ours, expected))
        for quantity, his, ours, expected in (*printed, *counts)
    ]


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


def as_printed(samples: Any, t: Floats) -> Floats:
    """His dead reckoning of a level unit, where 9.8 sin(angle) is 0: sums, and no biases removed."""
    dt = t[1] - t[0]
    p: Floats = np.cumsum(np.cumsum(samples["f"][:, :2], axis=0) * dt, axis=0) * dt
    return p


def looped(rng: np.random.Generator) -> LoopRun:
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
    return LoopRun(
        t, truth, r[:, 0:3], r[:, 3:6], r[:, 6:9], r[:, 9:12], r[:, 14], a, r[:, 12], r[:, 13], literal, biased
    )


def _loop_rows(run: LoopRun) -> list[Row]:
    level = slice(0, 2)
    off = np.linalg.norm((run.estimated - run.truth)[:, level], axis=1)
    printed = float(np.linalg.norm(run.literal[-1] - run.truth[-1, level]))
    share = float(np.max(np.abs((run.estimated - run.truth)[:, level]) / run.sigma[:, None].clip(1e-6)))
    drift = Row("table top: end as printed, no bias removed", "very high drift", f"{printed:.2f} m", printed > 1.0)
    return [
        drift,
        at_most("table top: end with ins9", "expected: 0", float(off[-1]), ERROR_MAX_M, "m"),
        at_most("table top: farthest from the true path", "not rectangular", float(off.max()), ERROR_MAX_M, "m"),
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
    roll, pitch, _ = interpreted(euler_of_quat)(tuple(out["q_nb"][-1]))
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
    his, matched = walked(rng)
    run = looped(rng)
    tilts = [tilted(rng, angle) for angle in TILTS_DEG]
    rows = [
        *_parameter_rows(),
        *gps_rows(his, matched),
        *distance_rows(),
        *_loop_rows(run),
        *_tilt_rows(tilts),
        *compensation_rows(),
    ]
    figures = [gps_figure(his, matched, SIGMA_M), loop_figure(run), tilt_figure(TILTS_DEG, tilts)]
    return Report("Prasanna, Vehicle Localisation Using GPS and IMU", rows, figures)
