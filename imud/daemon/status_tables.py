"""The state of a running daemon as one nested table of numbers and texts, for `imud status` and Prometheus.

Most of it is computed only on request; the loop itself adds one sum per sample (its delay) and per innovation.
Counters of a port begin anew with each connection; a value that is not known is left out. Units stand in the names,
which are those of `imud replay`'s est.csv where both have them.
"""

import dataclasses
import json
import math
import os
import resource
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from imud.drivers.driver import ImuConfigured

from .. import __version__
from ..compile import library
from ..estimators import filter_states
from ..estimators.aiding_source import AidingSource
from ..estimators.innovation_kinds import KINDS
from ..estimators.records import ATTITUDE_VALID, REST_N, REST_Z
from ..outputs.gpsd_json import STATUS_NAMES, status_text
from ..outputs.view import decode, euler

if TYPE_CHECKING:
    from ..outputs.binary import BinaryOutputs
    from ..outputs.gpsd import GpsdServer
    from ..pipeline import Filter
    from ..sensors.inertial import Inertial
    from ..sensors.receiver import Receiver
    from .load import Load
    from .ports import Port
    from .sigma_shares import SigmaShares

_REST = range(REST_N, REST_Z + 1)  # these are rejected when a vehicle sets off, which says nothing of the sigmas
SILENT_S = 3.0  # without a measurement of a source
RATIO_SAMPLES = 32.0  # fixes over which an innovation ratio is averaged
Table = dict[str, Any]


class InnovationStatistics:
    """Statistics of innovations by kind: how many were used or rejected, and how large they were for their variance."""

    def __init__(self) -> None:
        self._table: dict[int, Table] = {}
        self._finite: Counter[int] = Counter()

    def add(self, rows: NDArray[np.void]) -> None:
        """Add rows of INNOVATION. One rejected without a value, as of a fix out of order, is counted and no more."""
        for _, kind, value, variance, used in rows.tolist():
            entry = self._table.setdefault(kind, {"used": 0, "rejected": 0, "ratio": 0.0})
            entry["used" if used else "rejected"] += 1
            if math.isfinite(value) and (used or kind not in _REST):
                self._finite[kind] += 1
                entry["ratio"] += (value * value / variance - entry["ratio"]) / min(RATIO_SAMPLES, self._finite[kind])

    def sum(self, kinds: Iterable[int]) -> Table:
        """Of measurements with an innovation of each of these kinds: counts, and the mean of the kinds' ratios."""
        entries = {kind: self._table[kind] for kind in kinds if kind in self._table}
        ratios = [entry["ratio"] for kind, entry in entries.items() if self._finite[kind]]
        counts = {what: max((entry[what] for entry in entries.values()), default=0) for what in ("used", "rejected")}
        return counts | ({"ratio": sum(ratios) / len(ratios)} if ratios else {})

    def table(self) -> Table:
        """By kind; `ratio` is the mean of innovation^2 / variance over the last fixes, 1 for a consistent filter.

        NaN as long as none had a value.
        """
        return {
            KINDS[kind].key: entry | ({} if self._finite[kind] else {"ratio": math.nan})
            for kind, entry in sorted(self._table.items())
        }


def of_sources(
    tables: Mapping[str, Table], innovations: InnovationStatistics, shares: "SigmaShares", known: Iterable[AidingSource]
) -> Table:
    """Of each aiding source that has sent something: what came, how much was used, whether its sigmas are right, and
    its share of what lowers the sigmas.

    tables: what came, by source. known: the sources that the estimator fuses.
    """
    kinds = {source.name: source.innovations for source in known}
    return {name: table | innovations.sum(kinds.get(name, ())) | shares.table(name) for name, table in tables.items()}


def add_estimates(tables: Mapping[str, Table], filter_: "Filter") -> None:
    """To the table of each aiding source: what the filter has found out of it (`Estimator.source_estimates`).

    late_s: by how much its measurements are late, s, its clock being wrong or none.
    """
    estimator, state = filter_.estimator, filter_.state
    ages = estimator.source_ages_s(state) if estimator.source_ages_s else None
    found = estimator.source_estimates(state) if estimator.source_estimates else {}
    for source in estimator.sources:
        if source.name not in tables:
            continue
        tables[source.name].update(found.get(source.kind, {}))
        if tables[source.name]["age_s"] > SILENT_S:  # that nothing comes is why nothing is used
            tables[source.name].pop("finding", None)
        if ages is not None and ages[source.kind] != 0.0:
            tables[source.name]["late_s"] = round(float(ages[source.kind]), 2)


def of_process(started_ns: int) -> Table:
    """Time and memory used by this process, and where its compiled kernels are."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    return {
        "version": __version__,
        "pid": os.getpid(),
        "uptime_s": round((time.monotonic_ns() - started_ns) * 1e-9, 3),
        "cpu_s": round(time.process_time(), 3),
        "memory_bytes": resident,
        "memory_peak_bytes": max(resident, usage.ru_maxrss * 1024),  # the kernel counts both roughly
        "open_files": len(os.listdir("/proc/self/fd")),  # noqa: PTH208  # names are all that is needed
        "kernels": library.origin(),
    }


def of_port(
    port: "Port", now_ns: int, part: "Inertial | Receiver | None" = None, faults: tuple[str, ...] | None = None
) -> Table:
    """A port, its device, and what was counted since it began to stream."""
    table: Table = {"path": port.spec.path, "state": port.state.name.lower(), "description": port.description}
    table |= {"connects": port.connects, "streaming": False}
    configured = port.configured
    if configured is None or part is None:
        return table
    identity = configured.identity
    table |= {
        "streaming": True,
        "driver": identity.driver,
        "model": identity.model,
        "serial": identity.serial,
        "firmware": identity.firmware,
        "baud": identity.baud or None,
        "health": "; ".join(faults or ()) or "ok",
        "fault_count": len(faults or ()),
        "rate_hz": part.rate.hz,
    }
    if isinstance(configured, ImuConfigured):
        table["rate_asked_hz"] = configured.rate_hz
    return table | part.properties(now_ns)


def of_all_connections(inertial: "Inertial | None") -> Table:
    """What was counted of the inertial sensor in all its connections together."""
    return {} if inertial is None else {"samples": inertial.samples, **inertial.totals()}


def of_filter(inertial: "Inertial | None", estimator: str, now_ns: int) -> Table:
    """The newest solution: state in words, its age, values and their standard deviations, biases."""
    solution = inertial.newest if inertial else None
    if solution is None:
        return {"estimator": estimator}
    s = decode(solution.tobytes())
    rpy = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), euler(s.q_nb), strict=True))
    return {
        "estimator": estimator,
        "state": status_text(s.status),
        "age_s": (now_ns - inertial.last_data_ns) * 1e-9 if inertial else None,
        "flags": {word: bool(s.status & bit) for bit, word in STATUS_NAMES.items()},
        "finding": "; ".join(inertial.pipeline.filter.findings() if inertial else ()) or None,
        **(rpy if s.status & ATTITUDE_VALID else {}),
        **_named("s{}_deg", ("roll", "pitch", "yaw"), s.sigma_rpy),
        "lat_deg": s.lat,
        "lon_deg": s.lon,
        "height_m": s.height,
        **_named("v{}_mps", "ned", s.v),
        **_named("s{}_m", "ned", s.sigma_p),
        **_named("sv{}_mps", "ned", s.sigma_v),
        **_named("bg{}_dps", "xyz", s.bg),
        **_named("sbg{}_dps", "xyz", s.sigma_bg),
        **_named("ba{}_mps2", "xyz", s.ba),
        **_named("sba{}_mps2", "xyz", s.sigma_ba),
        **_named("antenna_{}_m", "xyz", inertial.pipeline.filter.settings.navigation.lever_arm if inertial else ()),
        "sample": _sample_sigmas(inertial),
    }


def of_filter_states(inertial: "Inertial | None") -> Table:
    """What the filter has found beside its solution, and the covariance of position, velocity and attitude."""
    if inertial is None or not len(rows := inertial.pipeline.filter.filter_states()):
        return {}
    return {name: float(values[0]) for name, values in filter_states.cells(rows).items()}


def _sample_sigmas(inertial: "Inertial | None") -> Table:
    """Standard deviations of a sample by the noise profile, from which `imud ros2` makes covariances."""
    sigmas = inertial.sample_sigmas if inertial else (None, None)
    return {name: dataclasses.asdict(s) for name, s in zip(("rate_radps", "force_mps2"), sigmas, strict=True) if s}


def _named(form: str, names: Any, values: Any) -> Table:
    return {form.format(name): value for name, value in zip(names, values, strict=True)}


def of_outputs(gpsd: "GpsdServer", binary: "BinaryOutputs") -> Table:
    """The number of clients, and what slow ones have lost."""
    counted = dataclasses.asdict(gpsd.counters)
    return {
        "gpsd": {"addresses": " ".join(gpsd.addresses), "clients": gpsd.clients, **counted},
        "stream": {"clients": binary.stream.clients, "dropped": binary.stream.dropped},
    }


def of_load(load: "Load") -> Table:
    """Whether the machine keeps up."""
    return {"overloaded": load.overloaded, "shed": load.shed}


def flat(table: Mapping[str, Any], prefix: str = "") -> Table:
    """`{"a": {"b": 1}}` as `{"a.b": 1}`; without what is unknown (None, NaN, infinite)."""
    items: Table = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            items |= flat(value, f"{prefix}{key}.")
        elif value is not None and not (isinstance(value, float) and not math.isfinite(value)):
            items[prefix + key] = value
    return items


def status_object(table: Table) -> str:
    """The table as one flat JSON object with a class of its own; gpsd's clients do not accept nested ones."""
    return json.dumps({"class": "STATUS", **flat(table)}, separators=(",", ":"))
