"""One recording through one estimator, and its trace: the columns that a golden file keeps."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from simulated import G350, rpy, unknown_fixes

from imud.batch import rate_hz_of
from imud.configuration.settings import Initial, Settings
from imud.estimators import registry
from imud.estimators.innovation_kinds import KINDS
from imud.estimators.records import INNOVATION, MEASUREMENT, SOLUTION
from imud.pipeline import Filter

TO_DEG = np.degrees(1.0)
ROWS = 8  # of a golden file
ROOM = 16  # innovations of a sample, a fix or a measurement, at most


@dataclass(frozen=True)
class Recording:
    """What an estimator is given. samples: SAMPLE rows; fixes: FIX rows; initial: what the user knows.

    measurements: MEASUREMENT rows of other aiding sources.
    """

    estimator: str
    samples: np.ndarray
    fixes: np.ndarray = field(default_factory=lambda: unknown_fixes(0))
    settings: Settings = G350
    initial: Initial = Initial()  # noqa: RUF009
    measurements: np.ndarray = field(default_factory=lambda: np.zeros(0, MEASUREMENT))
    rows: int = ROWS


GOLDENS = {}  # name: the function that makes the recording; in the order of definition


def golden(estimator=""):
    """Decorates a function that makes a recording; the trace's name is that of the estimator, and the function's."""

    def listed(make):
        GOLDENS[f"{estimator}-{make.__name__}".strip("-").replace("_", "-")] = make
        return make

    return listed


def run(recording, disturb=lambda samples: samples):
    """(solutions of every sample, innovations in the order in which they were made); fixes go in as they arrive.

    `disturb` may change the samples.
    """
    samples = disturb(recording.samples.copy())
    fixes = recording.fixes[np.argsort(recording.fixes["arrival_ns"], kind="stable")]
    estimator = registry.by_name(recording.estimator)
    filter_ = Filter(estimator, recording.settings, recording.initial, rate_hz_of(samples))
    out = np.zeros(len(samples), SOLUTION)
    places = np.searchsorted(samples["t_ns"], fixes["arrival_ns"]).astype(np.int64)
    measurements = recording.measurements[np.argsort(recording.measurements["arrival_ns"], kind="stable")]
    aided = np.searchsorted(samples["t_ns"], measurements["arrival_ns"])
    made = []
    due_to_place = aided[filter_.needing_place(measurements)]  # these are prepared from the state then
    for start, stop in pairwise(np.unique([0, *due_to_place[due_to_place < len(samples)], len(samples)])):
        last = stop == len(samples)
        due = slice(*np.searchsorted(places, [start, stop + last]))
        given = slice(*np.searchsorted(aided, [start, stop]))
        room = np.zeros(ROOM * (stop - start + len(fixes) + len(measurements)), INNOVATION)
        block = samples[start:stop], out[start:stop], fixes[due], places[due] - start, room
        made.append(filter_.feed(*block, measurements[given], aided[given] - start).copy())
    return out, np.concatenate([*made, filter_.pending_innovations()])


def solution_columns(out):
    """Name to numbers of solutions."""
    triples = [("v_mps", out["v"], 1.0), ("sp_m", out["sigma_p"], 1.0), ("sv_mps", out["sigma_v"], 1.0)]
    triples += [("srpy_deg", out["sigma_rpy"], TO_DEG)]
    triples += [("bg_radps", out["bg"], 1.0), ("sbg_radps", out["sigma_bg"], 1.0)]
    triples += [("ba_mps2", out["ba"], 1.0), ("sba_mps2", out["sigma_ba"], 1.0)]
    triples += [("w_radps", out["w"], 1.0), ("f_mps2", out["f"], 1.0)]
    triples += [("rpy_deg", rpy(out["q_nb"]), TO_DEG)]
    table = {"t_s": out["t_ns"] * 1e-9, "lat_deg": out["lat"] * TO_DEG, "lon_deg": out["lon"] * TO_DEG}
    table |= {"height_m": out["height"]}
    table |= {f"{name}_{axis}": unit * values[:, axis] for name, values, unit in triples for axis in range(3)}
    return table | {"status": out["status"].astype(float)}


def innovation_columns(innovations, t_ns):
    """Until each of these times: the sum of normalised squares; how many of each kind (code) were used, refused."""
    innovations = innovations[np.argsort(innovations["t_ns"], kind="stable")]
    last = np.searchsorted(innovations["t_ns"], t_ns, side="right")

    def until(values):
        return np.concatenate([[0.0], np.cumsum(values)])[last]

    known = np.isfinite(innovations["value"])
    nis = np.zeros(len(innovations))
    nis[known] = innovations["value"][known] ** 2 / innovations["variance"][known]
    table = {"nis_sum": until(nis)}
    for kind in KINDS:
        for word, used in (("used", 1), ("refused", 0)):
            these = (innovations["kind"] == kind) & (innovations["used"] == used)
            table[f"{word}_{kind}"] = until(these.astype(float))
    return table


def sum_columns(out):
    """Sums over all samples until each: they remember what was between the rows of a file."""
    sums = {"status": out["status"].astype(float)}
    for name in ("v", "bg", "ba", "sigma_p", "sigma_v", "sigma_rpy", "sigma_bg", "sigma_ba"):
        sums[name] = np.linalg.norm(np.nan_to_num(out[name]), axis=1)
    return {f"{name}_sum": np.cumsum(values) for name, values in sums.items()}


def trace(recording, **how):
    """Name to numbers of every so many samples; what the estimator never knows, and what never came, is left out."""
    out, innovations = run(recording, **how)
    every = max(len(out) // recording.rows, 1)
    kept = out[every - 1 :: every]
    counted = {name: values[every - 1 :: every] for name, values in sum_columns(out).items()}
    counted |= innovation_columns(innovations, kept["t_ns"])
    table = {name: values for name, values in solution_columns(kept).items() if np.isfinite(values).any()}
    return table | {name: values for name, values in counted.items() if values.any()}
