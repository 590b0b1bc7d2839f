"""What a faulty aiding source does to the rest: every source with every fault, beside the same drive without it.

`python tests/fault_matrix.py` prints the table of docs/faults.md. Each cell is a simulated drive with a receiver that
is lost for 20 s at the end; the source is right for 50 s, and then lost, late, frozen and so on until the end.
`python tests/fault_matrix.py --vehicles 11,12,13` prints, of other vehicles and these seeds, seconds wrong and sure.
"""

import argparse
import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np
from golden_external import external
from msgspec.structs import replace
from navigation_simulation import drive, errors, received, sensed
from test_navigation_aiding import estimated, headings
from test_navigation_odometer import without
from test_navigation_two_wheels import SETTINGS, wheels
from vehicle_simulation import FREE, LAND, VEHICLES, vehicle

from imud.configuration.settings import Navigation, Settings
from imud.estimators.records import (
    ATTITUDE_VALID,
    BAROMETER_SOURCE,
    BODY_VELOCITY_SOURCE,
    HEADING_VALID,
    HEIGHT_VALID,
    MEASUREMENT,
    POSE_SOURCE,
    POSITION_VALID,
    VELOCITY_SOURCE,
)

SECONDS, BEGIN_S, OUTAGE_S = 130.0, 50.0, 110.0
SIGMAS = 4.0
METRES, MPS, DEGREES = 5.0, 1.0, 5.0  # an error beyond that and beyond SIGMAS is wrong and sure


@cache
def scene(seed, name="drive"):
    """The drive, samples, and fixes until the outage; name: "drive", or a vehicle's."""
    rng = np.random.default_rng(seed)
    d = drive(SECONDS, speed=7.0) if name == "drive" else vehicle(name, seed, SECONDS)
    samples = sensed(d, rng, bg=(0.002, -0.001, 0.0015), ba=(0.03, -0.02, 0.02))
    return d, samples, without(received(d, rng, late=0.1, sigma=1.2), OUTAGE_S, SECONDS)


def _odometer(d, rng):
    rows = wheels(d, rng)
    rows["value"][:, 0] *= 1.01
    rows["value"][:, 1] = np.nan
    return rows


def _barometer(d, rng):
    _, k, rows = external(d, BAROMETER_SOURCE, 5)
    rows["value"][:, 0] = d.height[k] - 30.0 + 0.2 * rng.standard_normal(len(k))
    return rows


def _pose(d, rng):
    _, k, rows = external(d, POSE_SOURCE, 6)
    e = 0.1 * rng.standard_normal((len(k), 3))
    yaw = d.attitude.as_euler("ZYX")[k, 0] + 0.01 * rng.standard_normal(len(k))
    rows["value"][:, :4] = np.column_stack(
        [d.lat[k] + e[:, 0] / 6.37e6, d.lon[k] + e[:, 1] / (6.38e6 * np.cos(d.lat[k])), d.height[k] - e[:, 2], yaw]
    )
    rows["sigma"] = 0.15, 0.15, 0.15, 0.02
    return rows


def _velocity(kind):
    def rows_of(d, rng):
        _, k, rows = external(d, kind, 7)
        v = d.attitude[k].inv().apply(d.v[k]) if kind == BODY_VELOCITY_SOURCE else d.v[k]
        rows["value"][:, :3] = v + 0.1 * rng.standard_normal(v.shape)
        rows["sigma"][:, :3] = 0.1
        return rows

    return rows_of


SOURCES = {
    "odometer": _odometer,
    "two wheels": wheels,
    "heading": lambda d, rng: headings(d, rng, sigma=np.radians(0.5)),
    "barometer": _barometer,
    "pose": _pose,
    "velocity": _velocity(VELOCITY_SOURCE),
    "body_velocity": _velocity(BODY_VELOCITY_SOURCE),
}
JUMP = {"odometer": 3.0, "two wheels": 3.0, "heading": 0.6, "barometer": 15.0, "velocity": 3.0, "body_velocity": 3.0}
_KMH, _FEET = 3.6, 3.2808
UNITS = {
    "odometer": _KMH, "two wheels": _KMH, "heading": np.radians(1.0), "barometer": _FEET,
    "velocity": _KMH, "body_velocity": _KMH,
}  # fmt: skip


def lost(name, rows, t):
    """Nothing more comes."""
    return rows[t < BEGIN_S]


def late(name, rows, t):
    """Each comes 0.8 s later, and has no time of its own: it seems to be of its arrival."""
    rows["arrival_ns"][t >= BEGIN_S] += 800_000_000
    rows["t_ns"][t >= BEGIN_S] = rows["arrival_ns"][t >= BEGIN_S]
    return rows


def frozen(name, rows, t):
    """The last value is repeated."""
    first = np.searchsorted(t, BEGIN_S)
    rows["value"][first:] = rows["value"][first]
    return rows


def jumping(name, rows, t):
    """A lasting offset every other 10 s."""
    wrong = (t >= BEGIN_S) & (np.floor(t / 10.0) % 2 == 1)
    if name == "pose":
        rows["value"][wrong, 0] += 15.0 / 6.37e6
    else:
        rows["value"][wrong, 0] += JUMP[name]
    return rows


def wrong_units(name, rows, t):
    """km/h, feet, radians taken for degrees: from the first one on."""
    if name == "pose":
        rows["value"][:, 2] *= _FEET
    elif name == "heading":
        rows["value"][:, 0] = np.radians(np.mod(rows["value"][:, 0], 2.0 * np.pi))
    else:
        rows["value"][:, :3] *= UNITS[name]
    return rows


def own_clock(name, rows, t):
    """Its epochs are wrong by 0.3 s, and by 1 ms more each second."""
    gone = np.maximum(t - BEGIN_S, 0.0)
    rows["t_ns"] -= np.round(1e9 * np.where(t >= BEGIN_S, 0.3 + 0.001 * gone, 0.0)).astype(np.int64)
    return rows


def late_at_once(name, rows, t):
    """Late from the first one on."""
    rows["arrival_ns"] += 800_000_000
    rows["t_ns"] = rows["arrival_ns"]
    return rows


FAULTS = {
    "lost": lost,
    "late": late,
    "frozen": frozen,
    "jumping": jumping,
    "wrong units": wrong_units,
    "clock of its own": own_clock,
}


def mounted(deg):
    """A compass that is mounted wrong by `deg`."""

    def turned(name, rows, t):
        rows["value"][:, 0] += np.radians(deg)
        return rows

    return turned


def near_iron(name, rows, t):
    """A deviation of up to 30 deg, which changes with the heading."""
    rows["value"][:, 0] += np.radians(30.0) * np.sin(rows["value"][:, 0] + 2.0)
    return rows


def turned_map(deg):
    """Poses on a map that is turned by `deg`: from the first one on, and their positions are right."""

    def turned(name, rows, t):
        rows["value"][:, 3] += np.radians(deg)
        return rows

    return turned


OF_POSES = {"map turned by 10 deg": turned_map(10.0), "by 90 deg": turned_map(90.0), "by 180 deg": turned_map(180.0)}
OF_VEHICLES = FAULTS | {"late at once": late_at_once}
OF_COMPASSES = {"mounted 10 deg wrong": mounted(10.0), "mounted 180 deg wrong": mounted(180.0), "near iron": near_iron}
TOGETHER = ("odometer", "heading", "barometer")  # sources of `together`


@dataclass(frozen=True)
class Cell:
    """RMS errors from the fault's beginning on: position and height, m; velocity, m/s; roll and pitch, yaw, deg.

    sure: how long an error was beyond SIGMAS sigmas and large, s.
    """

    rms: dict[str, float]
    sure_s: float
    worst: str


def settings_of(name, where="drive"):
    """The settings of a source on a vehicle."""
    settings = SETTINGS if name == "two wheels" else Settings()
    return replace(settings, navigation=Navigation(vehicle="free")) if where in FREE else settings


def cell(seed, name=None, fault=None, where="drive"):
    """One drive. name None: without the source; where: its vehicle."""
    d, samples, fixes = scene(seed, where)
    rows = np.zeros(0, MEASUREMENT)
    if name is not None:
        rows = SOURCES[name](d, np.random.default_rng(100 + seed)).copy()
        t = rows["t_ns"] * 1e-9 - 100.0
        rows = rows if fault is None else (OF_VEHICLES | OF_COMPASSES | OF_POSES)[fault](name, rows, t)
    out, _ = estimated(samples, fixes, rows, settings_of(name, where))
    return judged(d, out)


def together(seed, name, fault, where="drive"):
    """One drive with a compass, a barometer and, on land, an odometer, of which `name` has the fault."""
    d, samples, fixes = scene(seed, where)
    parts = []
    for source in TOGETHER:
        if where in FREE and source == "odometer":
            continue
        rows = SOURCES[source](d, np.random.default_rng(100 + seed)).copy()
        if source == name:
            rows = (OF_VEHICLES | OF_COMPASSES)[fault](name, rows, rows["t_ns"] * 1e-9 - 100.0)
        parts.append(rows)
    rows = np.concatenate(parts)
    rows = rows[np.argsort(rows["arrival_ns"], kind="stable")]
    return judged(d, estimated(samples, fixes, rows, settings_of(None, where))[0])


def judged(d, out):
    """The errors of a run."""
    position, velocity, attitude = errors(d, out)[:3]
    attitude = np.degrees(attitude)
    status, sigma_a = out["status"], np.degrees(out["sigma_rpy"])
    groups = {
        "position": (position[:, :2], out["sigma_p"][:, :2], METRES, POSITION_VALID),
        "height": (position[:, 2:], out["sigma_p"][:, 2:], METRES, HEIGHT_VALID),
        "velocity": (velocity, out["sigma_v"], MPS, POSITION_VALID),
        "tilt": (attitude[:, :2], sigma_a[:, :2], DEGREES, ATTITUDE_VALID),
        "yaw": (attitude[:, 2:], sigma_a[:, 2:], DEGREES, HEADING_VALID),
    }
    since, rms, sure = d.t >= BEGIN_S, {}, {}
    for key, (error, sigma, large, valid) in groups.items():
        use = since & (status & valid != 0)
        rms[key] = float(np.sqrt(np.mean(np.sum(error[use] ** 2, axis=1)))) if use.any() else np.inf
        wrong = (np.abs(error) > SIGMAS * sigma) & (np.abs(error) > large)
        sure[key] = float(np.sum(wrong.any(axis=1) & use) * (d.t[1] - d.t[0]))
    worst = max(sure, key=lambda key: sure[key])
    return Cell(rms, sum(sure.values()), worst if sure[worst] else "")


LEAST = {"position": 1.0, "height": 1.0, "velocity": 0.15, "tilt": 0.1, "yaw": 0.5}  # errors below it harm nobody


def harm(found, alone):
    """The largest ratio of an RMS error to that without the source, and what it is of."""
    ratios = {key: found.rms[key] / max(alone.rms[key], LEAST[key]) for key in LEAST}
    worst = max(ratios, key=lambda key: ratios[key])
    return ratios[worst], worst


def table(seed=1):
    """The rows of the table in Markdown."""
    alone = cell(seed)
    yield "| source | right | " + " | ".join(FAULTS) + " |"
    yield "|---|" + "---|" * (1 + len(FAULTS))
    for name in SOURCES:
        texts = []
        for fault in (None, *FAULTS):
            found = cell(seed, name, fault)
            ratio, worst = harm(found, alone)
            texts.append(
                f"{ratio:.2f} {worst}" + (f", **{found.sure_s:.0f} s sure: {found.worst}**" if found.sure_s else "")
            )
        yield f"| {name} | " + " | ".join(texts) + " |"


def vehicles_table(seeds, vehicles=tuple(VEHICLES)):
    """Seconds wrong and sure over `seeds`, less those without the source, and the largest ratio of an RMS error."""
    yield "| vehicle | source | right | " + " | ".join(OF_VEHICLES) + " |"
    yield "|---|---|---|" + "---|" * len(OF_VEHICLES)
    for where in vehicles:
        alone = {seed: cell(seed, where=where) for seed in seeds}
        for name in SOURCES:
            if where not in LAND and name in ("odometer", "two wheels"):
                continue
            texts = []
            for fault in (None, *OF_VEHICLES):
                found = {seed: cell(seed, name, fault, where) for seed in seeds}
                sure = sum(max(found[seed].sure_s - alone[seed].sure_s, 0.0) for seed in seeds)
                texts.append(f"{sure:.0f} s, {max(harm(found[seed], alone[seed])[0] for seed in seeds):.1f}")
            yield f"| {where} | {name} | " + " | ".join(texts) + " |"


def compasses_table(seeds, vehicles=tuple(VEHICLES)):
    """The same of wrong compasses: alone, and with an odometer and a barometer."""
    faults = ("wrong units", *OF_COMPASSES)
    yield "| vehicle | sources | " + " | ".join(faults) + " |"
    yield "|---|---|" + "---|" * len(faults)
    for where in vehicles:
        without_it = {seed: cell(seed, where=where) for seed in seeds}
        for sources, run in (("compass", cell), ("compass, odometer, barometer", together)):
            texts = []
            for fault in faults:
                found = {seed: run(seed, "heading", fault, where=where) for seed in seeds}
                texts.append(f"{sum(max(found[seed].sure_s - without_it[seed].sure_s, 0.0) for seed in seeds):.0f} s")
            yield f"| {where} | {sources} | " + " | ".join(texts) + " |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("seed", nargs="?", type=int, default=1)
    parser.add_argument("--vehicles", type=lambda text: [int(seed) for seed in text.split(",")], metavar="SEED,..")
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(VEHICLES), metavar="VEHICLE,..")
    args = parser.parse_args()
    lines = [vehicles_table, compasses_table] if args.vehicles else []
    for line in itertools.chain(*(rows(args.vehicles, args.only) for rows in lines)) if lines else table(args.seed):
        print(line, flush=True)


if __name__ == "__main__":
    main()
