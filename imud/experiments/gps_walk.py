"""Prasanna's GPS track: 700 m on foot in Singapore with a receiver of the FV-M11's 3.3 m CEP at 1 Hz, simulated."""

import math
from dataclasses import dataclass

import numpy as np

from ..compile.jit import interpreted
from ..configuration.settings import GpsTrack, Initial, Settings
from ..estimators.papers import gps_track
from ..estimators.records import FIX, SOLUTION
from ..math.arrays import Floats
from ..math.earth import radii
from ..pipeline import Filter
from .report import Row, at_most, rms, within
from .simulate import level_at_rest, samples_of

LAT, LON = math.radians(1.3), math.radians(103.77)  # rad, National University of Singapore
CEP_M = 3.3  # of the receiver, its data sheet
SIGMA_M = CEP_M / math.sqrt(2.0 * math.log(2.0))  # per axis: half of the fixes lie within the CEP
SPHERE_M = 6378.14e3  # his radius of the earth
WALK_S = 500


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


def walk(t: Floats) -> Floats:
    """North and east in m at t s: about 1.4 m/s along a bending path."""
    heading = 0.6 + 1.1 * np.sin(2.0 * np.pi * t / 170.0) + 0.5 * np.sin(2.0 * np.pi * t / 61.0)
    step = 1.4 * (t[1] - t[0])
    return np.cumsum(step * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)


def tracked(truth: Floats, raw: Floats, t: Floats, settings: Settings) -> Track:
    """Fixes at t s through `gps-track`, read at each fix."""
    meridian, prime_vertical = interpreted(radii)(LAT)
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


def walked(rng: np.random.Generator) -> tuple[Track, Track]:
    """One walk through his filter, with his Q and R and with those of the receiver and of a walk."""
    t = np.arange(1.0, WALK_S + 1.0)
    truth = walk(t)
    raw = truth + SIGMA_M * rng.standard_normal(truth.shape)
    matched = Settings(gps_track=GpsTrack(acceleration_var=0.01, position_var=SIGMA_M**2))
    return tracked(truth, raw, t, Settings()), tracked(truth, raw, t, matched)


def gps_rows(his: Track, matched: Track) -> list[Row]:
    """His verdicts on the filtered track, and whether its covariance is right."""
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


def distance_rows() -> list[Row]:
    """His metres per degree of longitude against the ellipsoid's, which differ by cos(latitude) and 0.2 %."""
    rows = []
    for lat_deg, where in ((1.3, "Singapore"), (48.0, "Munich")):
        _, prime_vertical = interpreted(radii)(math.radians(lat_deg))
        ours = math.radians(1.0) * prime_vertical * math.cos(math.radians(lat_deg))
        his = math.radians(1.0) * SPHERE_M
        text = f"{ours:.0f} m ({100.0 * (his / ours - 1.0):+.2f} % in the print)"
        same = abs(his * math.cos(math.radians(lat_deg)) / ours - 1.0) < 0.005
        rows.append(Row(f"1 deg of longitude, {where}", f"{his:.0f} m", text, same))
    return rows
