"""Prasanna's claims on a user's recording of an inertial sensor and a receiver."""

import math

import numpy as np

from ..batch import play
from ..compile.jit import interpreted
from ..configuration.settings import GpsTrack, Initial, Settings
from ..errors import BadDataError
from ..estimators import registry
from ..estimators.records import POSITION_VALID, SOLUTION
from ..math.arrays import Floats, Records
from ..math.earth import radii
from ..math.rotation_arrays import roll_and_pitch, wrapped
from ..pipeline import Filter
from ..setup import config
from .compensation import as_printed, mended, reckoned
from .gps_walk import CEP_M, roughness
from .prasanna_figures import path_figure
from .recorded import Recorded
from .report import Report, Row, at_most, rms

LEAST_FIXES = 10
DRIFT_S = 60.0  # of dead reckoning
HIGH_DRIFT_M = 1.0
HIS = GpsTrack()


def plane(fixes: Records, lat: Floats, lon: Floats) -> Floats:
    """North and east in m from the first fix."""
    first = fixes[0]
    meridian, prime_vertical = interpreted(radii)(float(first["lat"]))
    turn = wrapped(lon - first["lon"])
    return np.column_stack([(lat - first["lat"]) * meridian, turn * prime_vertical * math.cos(first["lat"])])


def _tracked(data: Recorded, fixes: Records) -> tuple[Floats, Floats, Floats]:
    """His filter at the fixes: (n, 2) m, sigmas, and the normalised squares of its innovations."""
    settings = Settings(gps_track=HIS, gnss=data.settings.gnss)
    filter_ = Filter(registry.by_name("gps-track"), settings, Initial(), 1.0)
    out, samples, rows, nis = np.zeros(1, SOLUTION), data.samples[:1].copy(), [], []
    fixes = fixes.copy()
    fixes["sigma"] = math.nan  # or his R would not count
    for fix in fixes:
        samples["t_ns"] = fix["t_ns"]
        innovations = filter_.update(fix.reshape(1))
        nis += (innovations["value"] ** 2 / innovations["variance"]).tolist()
        filter_.run(samples, out)
        rows.append([out["lat"][0], out["lon"][0], *out["sigma_p"][0, :2]])
    r = np.array(rows)
    return plane(fixes, r[:, 0], r[:, 1]), r[:, 2:], np.array(nis)


def _gps_rows(fixes: Records, raw: Floats, p: Floats, sigma: Floats, nis: Floats) -> list[Row]:
    few = int(np.count_nonzero((fixes["satellites"] >= 0) & (fixes["satellites"] <= 4)))
    result = f"RMS {rms(p - raw):.2f} m, σ {sigma.mean():.2f} m"
    return [
        Row("fixes; of them with 4 satellites or fewer", "greater than 4", f"{len(fixes)}; {few}", few == 0),
        at_most("his filter: roughness of the track, of the fixes'", "smoother", roughness(p) / roughness(raw), 1.0),
        at_most("his filter: RMS distance from the fixes", "close correspondence", rms(p - raw), CEP_M, "m"),
        Row("his filter, Q and R as printed: distance from the fixes, σ", "R = 0.5 m²", result),
        Row("his filter: NIS; 1 if Q and R fit", "not asked", f"{np.mean(nis):.2f}"),
    ]


def _tilts(data: Recorded) -> tuple[Floats, Floats]:
    """Roll and pitch by the estimator `tilt`, rad, (n, 2); and the device's own, NaN where it has none."""
    out = np.zeros(len(data.samples), SOLUTION)
    Filter(registry.by_name("tilt"), data.settings, Initial(), data.rate_hz).run(data.samples.copy(), out)
    d = data.samples["down"]
    own = np.column_stack([np.arctan2(d[:, 1], d[:, 2]), np.arctan2(-d[:, 0], np.hypot(d[:, 1], d[:, 2]))])
    own[~d.any(axis=1)] = np.nan
    return roll_and_pitch(out["q_nb"]), own


def _reckoning_rows(data: Recorded, t: Floats, raw: Floats, at: Floats) -> list[Row]:
    """INS: the displacement in DRIFT_S by the accelerometer, against the receiver's."""
    ours, own = _tilts(data)
    has_own = bool(np.isfinite(own).all())
    rows = []
    if has_own:
        apart = np.degrees(wrapped(own - ours))
        text = "{:.2f}, {:.2f} deg".format(*np.sqrt(np.mean(apart**2, axis=0)))
        rows.append(Row("the device's own roll and pitch against `tilt`, RMS", "satisfactory", text))
    roll, pitch = (own if has_own else ours).T
    part = t <= t[0] + DRIFT_S
    end = float(t[part][-1])
    begin_p, end_p = (np.array([np.interp(x, at, raw[:, i]) for i in range(2)]) for x in (float(t[0]), end))
    went = float(np.linalg.norm(end_p - begin_p))
    T = 1.0 / data.rate_hz
    for name, method in (("9.8 sin(angle) as printed", as_printed), ("by the rotation", mended)):
        f = data.samples["f"][part]
        reached = float(np.linalg.norm(reckoned(method(f, roll[part], pitch[part]), T)[-1]))
        ours_text = f"{reached:.4g} m; by the fixes {went:.4g} m"
        claim = bool(abs(reached - went) > HIGH_DRIFT_M)
        rows.append(Row(f"INS: distance in {end - t[0]:.0f} s, {name}", "very high drift", ours_text, claim))
    return rows


def _navigation_rows(data: Recorded, fixes: Records, raw: Floats) -> list[Row]:
    """His integrated program: here the navigation filter, or `riss` for a sensor with one gyro."""
    name = "navigation" if all(data.gyro_axes) else "riss"
    filter_ = Filter(registry.by_name(name), data.settings, config.initial_of(data.settings), data.rate_hz)
    kept: list[Records] = []
    play(filter_, data.samples.copy(), data.fixes, lambda rows: kept.append(rows.copy()))
    out = np.concatenate(kept)
    at = np.minimum(np.searchsorted(out["t_ns"], fixes["t_ns"]), len(out) - 1)
    known = (out["status"][at] & POSITION_VALID) > 0
    if not known.any():
        return [Row(f"integrated, `{name}`", "position", "no position", False)]
    apart = plane(fixes, out["lat"][at], out["lon"][at])[known] - raw[known]
    sigma = float(np.mean(out["sigma_p"][at][known][:, :2]))
    claim = f"integrated, `{name}`: RMS distance from the fixes (σ {sigma:.2f} m)"
    return [at_most(claim, "close correspondence", rms(apart), CEP_M, "m")]


def reproduce(data: Recorded) -> Report:
    """His verdicts from the recording."""
    fixes = data.fixes[np.isfinite(data.fixes["lat"] + data.fixes["lon"])]
    if len(fixes) < LEAST_FIXES:
        raise BadDataError(
            f"{data.name}: {len(fixes)} fixes of a receiver; at least {LEAST_FIXES} are needed (--gnss FILE)"
        )
    fixes = fixes[np.concatenate([[True], np.diff(fixes["t_ns"]) > 0])]
    raw = plane(fixes, fixes["lat"], fixes["lon"])
    p, sigma, nis = _tracked(data, fixes)
    at, t = fixes["t_ns"] * 1e-9, data.samples["t_ns"] * 1e-9
    rows = [
        Row("recording", "", f"{data.name}: {data.seconds:.1f} s at {data.rate_hz:.6g} Hz, {len(fixes)} fixes"),
        *_gps_rows(fixes, raw, p, sigma, nis),
        *_reckoning_rows(data, t, raw, at),
        *_navigation_rows(data, fixes, raw),
    ]
    figures = [path_figure(raw, p, sigma)]
    return Report(f"Prasanna, Vehicle Localisation, on {data.name}", rows, figures, ours=False)
