"""The golden traces: what each estimator makes of one simulated recording, thinned, in git.

`python tests/golden.py` writes them anew; a change of any number then shows in the diff, and is either meant or a bug.
They hold on other processors too: the noise is of numpy's frozen generator, and the comparison leaves room for the last
bits of sines and of fused multiplication, nothing more.
"""

import csv
from pathlib import Path

import numpy as np

from imud.process import runtime

runtime.prepare()  # else numba would run stale kernels

from simulated import estimated, motion, received, rpy, sensed  # noqa: E402

from imud.configuration.settings import Initial  # noqa: E402
from imud.estimators.registry import NAMES  # noqa: E402

FOLDER = Path(__file__).with_name("golden")
SECONDS, RATE_HZ, EVERY = 80.0, 100.0, 200
TOLERANCE = 2e-6  # of a column's largest value
TO_DEG = np.degrees(1.0)
INITIAL = {"ins9": Initial(yaw_deg=86.0), "stationary": Initial(yaw_deg=86.0)}
STILL = ("stationary",)  # on a sensor at rest; the others drive


def recording(scenario):
    """(samples, fixes) of an M-G350 and a receiver: a rest of 5 s, then the scenario."""
    rng = np.random.RandomState(7)  # its stream never changes (NEP 19)
    m = motion(scenario, SECONDS, RATE_HZ)
    samples, _ = sensed(m, rng)
    return samples, received(m, rng)


def columns(out):
    """Name to numbers of solutions; what the estimator does not know is left out."""
    triples = [("v_mps", out["v"], 1.0), ("sp_m", out["sigma_p"], 1.0), ("sv_mps", out["sigma_v"], 1.0)]
    triples += [("srpy_deg", out["sigma_rpy"], TO_DEG)]
    triples += [("bg_radps", out["bg"], 1.0), ("sbg_radps", out["sigma_bg"], 1.0)]
    triples += [("ba_mps2", out["ba"], 1.0), ("sba_mps2", out["sigma_ba"], 1.0)]
    triples += [("rpy_deg", rpy(out["q_nb"]), TO_DEG)]
    table = {"t_s": out["t_ns"] * 1e-9, "lat_deg": out["lat"] * TO_DEG, "lon_deg": out["lon"] * TO_DEG}
    table |= {"height_m": out["height"]}
    table |= {f"{name}_{axis}": unit * values[:, axis] for name, values, unit in triples for axis in range(3)}
    table |= {"status": out["status"].astype(float)}
    return {name: values for name, values in table.items() if np.isfinite(values).any()}


def trace(name, disturb=lambda samples: samples):
    """The columns of the estimator `name` on its recording; `disturb` may spoil the samples."""
    samples, fixes = recording("rest" if name in STILL else "car")
    out, innovations = estimated(name, disturb(samples), fixes, initial=INITIAL.get(name), every=EVERY)
    table = columns(out)
    innovations = innovations[np.argsort(innovations["t_ns"], kind="stable")]
    if len(innovations):
        nis = np.cumsum(innovations["value"] ** 2 / innovations["variance"])
        last = np.searchsorted(innovations["t_ns"], out["t_ns"], side="right") - 1
        table["nis_sum"] = np.where(last < 0, 0.0, nis[last])
    return table


def write(name, table):
    with (FOLDER / f"{name}.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        for row in zip(*table.values(), strict=True):
            writer.writerow([f"{value:.{digits(column)}g}" for column, value in zip(table, row, strict=True)])


def digits(column):
    """Significant ones: places on the earth need more, 0.1 m and better."""
    return 11 if column in ("lat_deg", "lon_deg") else 7


def read(name):
    with (FOLDER / f"{name}.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    values = np.array(rows, dtype=float)
    return {column: values[:, i] for i, column in enumerate(head)}


def differences(wanted, got):
    """What differs, in words: column, first row, by how much."""
    if list(wanted) != list(got):
        return [f"columns {sorted(set(wanted) ^ set(got))} or their order"]
    said = []
    for name, old in wanted.items():
        new = got[name]
        room = TOLERANCE * np.nanmax(np.abs(old))
        if name in ("lat_deg", "lon_deg"):
            room = TOLERANCE * np.nanmax(np.abs(old - old[-1])) + 1e-9
        bad = np.flatnonzero(~((np.abs(new - old) <= room) | (np.isnan(new) & np.isnan(old))))
        if len(bad):
            k = bad[0]
            said.append(f"{name} from {wanted['t_s'][k]:g} s on: {old[k]:.9g}, now {new[k]:.9g}")
    return said


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for estimator in NAMES:
        write(estimator, trace(estimator))
        print(FOLDER / f"{estimator}.csv")
