"""Fixed-interval smoothing: every estimate from the data before it and after it (`imud replay --smooth`).

A two-filter smoother (Fraser & Potter 1969): the same filter runs over the data once forward and once backward in time,
and each sample's two estimates are averaged by their variances. Backward, positions, attitudes and specific forces are
as they were; velocities, rates and gyro biases have the other sign. Two corrections, from the forward estimate, make the
equations of motion the same: the earth turns the other way (rates), and so does the Coriolis force (specific force).

The backward filter begins where the forward one ended, with sigmas that are `WIDER` times as large, so that what both
have in common weighs little. Whole drives fit on disk, not in memory: rows are kept in temporary files.
"""

import math
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np

from imud.drivers.sample import DEVICE_ERROR, POWER_ON, RECONNECTED, SAMPLE, SATURATED, SUSPECT

from .batch import play
from .configuration.settings import Initial, Settings
from .estimators import Estimator
from .estimators.records import (
    ATTITUDE_VALID,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
    SOLUTION,
)
from .math.arrays import Floats, Records
from .math.earth import EARTH_RATE_RADPS
from .pipeline import Filter
from .sensor_errors.stored_biases import Biases

WIDER = 5.0
_EPOCH_SIGMA_S = 0.005
_EPOCH_TUNABLES = ("time_offset_sigma", "reported_epoch_sigma", "survey_epoch_sigma")
BLOCK = 65536  # rows
_MEAN_RADIUS_M = 6.371e6
_OF_DEVICES = SUSPECT | SATURATED | DEVICE_ERROR  # flags of a sample that stay; the sensor monitor makes its own anew


class Rows:
    """Rows of one dtype in a temporary file that has no name; grows, and is then read as an array."""

    def __init__(self, kind: "np.dtype[Any]") -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        self._kind = kind
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, rows: Records) -> None:
        """Copies of these rows."""
        self._file.write(np.ascontiguousarray(rows).tobytes())
        self._count += len(rows)

    def array(self) -> Records:
        """All rows, on disk; assignments stay there."""
        self._file.flush()
        if not self._count:
            return np.zeros(0, self._kind)
        return np.memmap(self._file, self._kind, "r+", shape=(self._count,))


def reversed_samples(samples: Records, solutions: Records) -> Iterator[Records]:
    """Samples in body axes as a sensor feels them while time runs backward, in blocks; their times count from 0.

    solutions: of the forward filter, for the two corrections.
    """
    end_ns = int(samples["t_ns"][-1])
    later = 0  # POWER_ON and RECONNECTED belong to the sample on the other side of the gap
    for stop in range(len(samples), 0, -BLOCK):
        part = slice(max(stop - BLOCK, 0), stop)
        rows, s = samples[part][::-1].copy(), solutions[part][::-1]
        north, down = EARTH_RATE_RADPS * np.cos(s["lat"]), -EARTH_RATE_RADPS * np.sin(s["lat"])
        earth = np.nan_to_num(np.stack([north, 0.0 * north, down], axis=1))
        positioned = (s["status"] & POSITION_VALID != 0) & (s["status"] & HEADING_VALID != 0)
        earth[~positioned] = 0.0
        coriolis = np.cross(earth, np.nan_to_num(s["v"]))
        matrix = _matrices(np.nan_to_num(s["q_nb"]))  # body to NED
        rows["t_ns"] = end_ns - rows["t_ns"]
        rows["tick"] = rows["tick"].max() - rows["tick"]
        rows["w"] = -rows["w"] + 2.0 * np.einsum("nji,nj->ni", matrix, earth)
        rows["f"] -= 4.0 * np.einsum("nji,nj->ni", matrix, coriolis)
        marks = rows["flags"] & (POWER_ON | RECONNECTED)
        rows["flags"] = (rows["flags"] & _OF_DEVICES) | np.concatenate([[later], marks[:-1]])
        later = int(marks[-1])
        yield rows


def reversed_fixes(fixes: Records, end_ns: int, delays_s: Any = 0.0) -> Records:
    """Fixes while time runs backward, with the other velocity. delays_s: by how much each is older than it says.
    """
    rows = fixes.copy()
    rows["t_ns"] = end_ns - (rows["t_ns"] - np.round(1e9 * np.asarray(delays_s)).astype(np.int64))
    rows["arrival_ns"] = rows["t_ns"]
    rows["v"] = -rows["v"]
    rows["course"] = np.mod(rows["course"] + math.pi, 2.0 * math.pi)
    return rows[np.argsort(rows["t_ns"], kind="stable")]


def reversed_measurements(measurements: Records, sources: Any, end_ns: int) -> Records:
    """Those of aiding sources."""
    rows = measurements[::-1].copy()
    rows["t_ns"] = end_ns - rows["t_ns"]
    rows["arrival_ns"] = rows["t_ns"]
    for source in sources:
        rows["value"][rows["kind"] == source.kind] *= source.backward
    return rows[np.argsort(rows["t_ns"], kind="stable")]


def backward_filter(estimator: Estimator, settings: Settings, rate_hz: float, last: Any) -> Filter:
    """A filter that begins where the forward one ended: at `last` (a SOLUTION), with wider sigmas.

    Its samples are in body axes: they were mounted and calibrated on the way forward.
    """
    status, known = int(last["status"]), dict[str, float]()
    sigmas = dict[str, float]()
    if status & ATTITUDE_VALID:
        roll, pitch, yaw = (math.degrees(angle) for angle in _euler(last["q_nb"]))
        known |= {"roll_deg": roll, "pitch_deg": pitch}
        sigmas["given_tilt_sigma"] = float(np.max(last["sigma_rpy"][:2]))
        if status & HEADING_VALID or estimator.update is None:
            known["yaw_deg"] = yaw
            sigmas["given_heading_sigma"] = float(last["sigma_rpy"][2])
    if status & POSITION_VALID:
        known |= {"lat_deg": math.degrees(last["lat"]), "lon_deg": math.degrees(last["lon"])}
        known |= {f"v{axis}_mps": -float(v) for axis, v in zip("ned", last["v"], strict=True)}
        sigmas["given_position_sigma"] = float(np.max(last["sigma_p"]))
        sigmas["given_velocity_sigma"] = float(np.max(last["sigma_v"]))
        if status & HEIGHT_VALID:
            known["height_m"] = float(last["height"])
    given = dict.fromkeys(_EPOCH_TUNABLES, _EPOCH_SIGMA_S)
    tunables = {tunable.name: tunable for tunable in estimator.tunables}
    given |= {
        name: min(max(WIDER * sigma, tunables[name].default / 4.0), tunables[name].most)
        for name, sigma in sigmas.items()
        if name in tunables and math.isfinite(sigma)
    }
    level = msgspec.structs.replace(settings, imu=msgspec.structs.replace(settings.imu, mount_rpy_deg=(0.0, 0.0, 0.0)))
    if given := {name: value for name, value in given.items() if name in tunables}:
        table = getattr(level, estimator.table)
        tuned = msgspec.structs.replace(table, tuning={**table.tuning, **given})
        level = msgspec.structs.replace(level, **{estimator.table: tuned})
    filter_ = Filter(estimator, level, Initial(**known), rate_hz)
    if np.isfinite([*last["bg"], *last["ba"], *last["sigma_bg"], *last["sigma_ba"]]).all():
        filter_.restore_biases(
            Biases(
                tuple((-last["bg"]).tolist()),
                tuple(last["ba"].tolist()),
                tuple((WIDER * last["sigma_bg"]).tolist()),
                tuple((WIDER * last["sigma_ba"]).tolist()),
            )
        )
    return filter_


def smooth(
    forward: Records,
    samples: Records,
    fixes: Records,
    delays_s: Any,
    measurements: Records | None,
    filter_: Filter,
    write: Callable[[Records], None],
) -> None:
    """Run backward, and write the smoothed solutions in blocks, first to last.

    forward: SOLUTION of each sample. samples: in body axes. filter_: of `backward_filter`.
    """
    end_ns = int(samples["t_ns"][-1])
    turned = Rows(SAMPLE)
    for block in reversed_samples(samples, forward):
        turned.append(block)
    backward = Rows(SOLUTION)
    aiding = None if measurements is None else reversed_measurements(measurements, filter_.estimator.sources, end_ns)
    play(filter_, turned.array(), reversed_fixes(fixes, end_ns, delays_s), backward.append, aiding=aiding)
    past = backward.array()
    yaw = _Heading()
    for start in range(0, len(forward), BLOCK):
        part = slice(start, min(start + BLOCK, len(forward)))
        back = past[len(past) - part.stop : len(past) - part.start][::-1]
        write(combined(forward[part], back, yaw))


class _Heading:
    """The yaw of an estimator that knows none from north: where the two differ in rate, the surer bias decides."""

    def __init__(self) -> None:
        self.difference: float | None = None  # of the last sample, backward less forward
        self.offset = 0.0

    def offsets(self, difference: Floats, weight: Floats) -> Floats:
        """What to add to the forward yaw. difference: backward less forward yaw; weight: of the backward rate."""
        first = difference[0] if self.difference is None else self.difference
        steps = np.diff(difference, prepend=first)
        steps = np.mod(steps + math.pi, 2.0 * math.pi) - math.pi
        offsets: Floats = self.offset + np.cumsum(np.nan_to_num(steps * weight))
        self.difference, self.offset = float(difference[-1]), float(offsets[-1])
        return offsets


def combined(forward: Records, backward: Records, yaw: _Heading) -> Records:
    """The two estimates of each sample, averaged by their variances. Each part only where both are valid."""
    out = forward.copy()
    both = forward["status"] & backward["status"]
    fore, aft = forward["status"] != 0, backward["status"] != 0
    _attitude(out, forward, backward, both, yaw)
    _position(out, forward, backward)
    for bias, sigma, sign in (("bg", "sigma_bg", -1.0), ("ba", "sigma_ba", 1.0)):
        mean, spread, _ = _average(forward[bias], sign * backward[bias], forward[sigma], backward[sigma])
        raw = {"bg": "w", "ba": "f"}[bias]
        out[raw] += forward[bias] - np.where(np.isfinite(mean), mean, forward[bias])
        out[bias], out[sigma] = mean, spread
    del fore, aft
    return out


def _average(a: Floats, b: Floats, sigma_a: Floats, sigma_b: Floats) -> tuple[Floats, Floats, Floats]:
    """(mean, its sigma, weight of b). Where one is unknown the other stands alone.

    Two that differ by more than their sigmas allow are both doubted: the sigma grows as their distance (Birge's ratio).
    """
    va, vb = np.square(sigma_a), np.square(sigma_b)
    va, vb = np.where(np.isfinite(a), va, np.inf), np.where(np.isfinite(b), vb, np.inf)
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.where(np.isinf(vb), 0.0, np.where(np.isinf(va), 1.0, va / (va + vb)))
        difference = np.where((weight > 0.0) & (weight < 1.0), b - a, 0.0)
        mean = np.where(weight == 1.0, b, a + weight * difference)
        variance = np.where(weight == 0.0, va, np.where(weight == 1.0, vb, weight * vb))
        ratio = np.where(difference != 0.0, np.square(difference) / (va + vb), 0.0)
        sigma = np.sqrt(variance * np.maximum(1.0, ratio / 4.0))
    return mean, np.where(np.isinf(sigma), np.nan, sigma), weight


def _position(out: Records, forward: Records, backward: Records) -> None:
    f_ok, b_ok = (rows["status"] & POSITION_VALID != 0 for rows in (forward, backward))
    f_h, b_h = (rows["status"] & HEIGHT_VALID != 0 for rows in (forward, backward))
    known = np.array([f_ok, f_ok, f_h]).T, np.array([b_ok, b_ok, b_h]).T
    sigma_f, sigma_b = (np.where(k, rows["sigma_p"], np.inf) for k, rows in zip(known, (forward, backward), strict=True))
    lat = np.where(f_ok, forward["lat"], backward["lat"])
    lon = np.where(f_ok, forward["lon"], backward["lon"])
    turn = np.mod(backward["lon"] - lon + math.pi, 2.0 * math.pi) - math.pi
    metres = np.stack([(backward["lat"] - lat) * _MEAN_RADIUS_M, turn * np.cos(lat) * _MEAN_RADIUS_M], axis=1)
    away = np.concatenate([metres, (forward["height"] - backward["height"])[:, None]], axis=1)  # NED
    zero = np.where(known[0], 0.0, np.nan)
    mean, sigma, weight = _average(zero, np.where(known[1], away, np.nan), sigma_f, sigma_b)
    fill = np.nan_to_num(mean)
    out["lat"] = lat + fill[:, 0] / _MEAN_RADIUS_M
    out["lon"] = lon + fill[:, 1] / (_MEAN_RADIUS_M * np.cos(lat))
    out["height"] = np.where(f_h | b_h, forward["height"] - fill[:, 2], forward["height"])
    out["sigma_p"] = np.where(known[0] | known[1], sigma, forward["sigma_p"])
    vf = np.where(f_ok[:, None], forward["v"], np.nan)
    vb = np.where(b_ok[:, None], -backward["v"], np.nan)
    v, spread, _ = _average(vf, vb, forward["sigma_v"], backward["sigma_v"])
    some = (f_ok | b_ok)[:, None]
    out["v"], out["sigma_v"] = np.where(some, v, forward["v"]), np.where(some, spread, forward["sigma_v"])
    bits = POSITION_VALID | HEIGHT_VALID
    out["status"] = forward["status"] & ~bits | (forward["status"] | backward["status"]) & bits


def _attitude(out: Records, forward: Records, backward: Records, both: Any, yaw: _Heading) -> None:
    qf, qb = forward["q_nb"], backward["q_nb"]
    f_ok, b_ok = (rows["status"] & ATTITUDE_VALID != 0 for rows in (forward, backward))
    f_north, b_north = (rows["status"] & HEADING_VALID != 0 for rows in (forward, backward))
    (roll_f, pitch_f, yaw_f), (roll_b, pitch_b, yaw_b) = _eulers(qf), _eulers(qb)
    sf, sb = forward["sigma_rpy"], backward["sigma_rpy"]
    # the levels first: the vertical in the body's axes, which no yaw changes
    down_f, down_b = (_vertical(q) for q in (qf, qb))
    tilt_f, tilt_b = (np.sqrt(0.5 * (s[:, 0] ** 2 + s[:, 1] ** 2)) for s in (sf, sb))
    _, _, weight = _average(
        np.where(f_ok, 0.0, np.nan), np.where(b_ok, 0.0, np.nan), tilt_f, tilt_b
    )
    down = (1.0 - weight)[:, None] * down_f + np.where(b_ok[:, None], weight[:, None] * down_b, 0.0)
    away = np.linalg.norm(down_f - down_b, axis=1)
    down /= np.linalg.norm(down, axis=1)[:, None]
    ratio = np.where(f_ok & b_ok, np.square(away) / 2.0 / (np.square(tilt_f) + np.square(tilt_b)), 0.0)
    wider = np.sqrt(np.maximum(1.0, ratio / 4.0))
    spread = [
        np.where(f_ok & b_ok, sf[:, i] * sb[:, i] / np.hypot(sf[:, i], sb[:, i]) * wider, np.where(f_ok, sf[:, i], sb[:, i]))
        for i in range(2)
    ]
    difference = np.mod(yaw_b - yaw_f + math.pi, 2.0 * math.pi) - math.pi
    north = f_north | b_north
    mean, yaw_sigma, _ = _average(
        np.where(f_north, 0.0, np.nan), np.where(b_north, difference, np.nan), sf[:, 2], sb[:, 2]
    )
    bias_f, bias_b = (np.linalg.norm(rows["sigma_bg"], axis=1) for rows in (forward, backward))
    _, _, of_rate = _average(np.zeros(len(qf)), np.zeros(len(qf)), bias_f, bias_b)
    offsets = yaw.offsets(difference, np.where(f_ok & b_ok & ~north, of_rate, 0.0))
    heading = yaw_f + np.where(north, np.nan_to_num(mean), offsets)
    roll, pitch = np.arctan2(down[:, 1], down[:, 2]), np.arcsin(np.clip(-down[:, 0], -1.0, 1.0))
    some = f_ok | b_ok
    out["q_nb"] = np.where(some[:, None], _quaternions(roll, pitch, heading), qf)
    out["sigma_rpy"] = np.where(
        some[:, None], np.stack([*spread, np.where(north, yaw_sigma, sf[:, 2])], axis=1), sf
    )
    bits = ATTITUDE_VALID | HEADING_VALID
    out["status"] = out["status"] & ~bits | (forward["status"] | backward["status"]) & bits


def _vertical(q: Floats) -> Floats:
    """Down in the body's axes: the last row of the matrix."""
    return _matrices(q)[:, 2, :]


def _matrices(q: Floats) -> Floats:
    """Body to NED, [n, 3, 3]."""
    w, x, y, z = np.moveaxis(q, 1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def _eulers(q: Floats) -> tuple[Floats, Floats, Floats]:
    m = _matrices(q)
    return (
        np.arctan2(m[:, 2, 1], m[:, 2, 2]),
        np.arcsin(np.clip(-m[:, 2, 0], -1.0, 1.0)),
        np.arctan2(m[:, 1, 0], m[:, 0, 0]),
    )


def _euler(q: Floats) -> tuple[float, float, float]:
    roll, pitch, yaw = (float(angle[0]) for angle in _eulers(np.asarray(q)[None]))
    return roll, pitch, yaw


def _quaternions(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    cr, sr, cp, sp, cy, sy = (f(0.5 * a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )
