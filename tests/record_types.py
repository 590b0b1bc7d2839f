"""Writes types.py of both filters, imud/estimators/ahrs and ins: their records as types for mypy, from the dtypes.

`python tests/record_types.py`; a test holds the files against the dtypes.
"""

from pathlib import Path

from drivers.sample import SAMPLE
from imud.estimators.ahrs import state as ahrs
from imud.estimators.ins import parameters, state
from imud.estimators.records import FIX, INNOVATION, MEASUREMENT, SOLUTION

ESTIMATORS = Path(__file__).resolve().parents[1] / "imud" / "estimators"
INS = {
    "Sample": SAMPLE,
    "StoredSample": state.STORED_SAMPLE,
    "Fix": FIX,
    "Solution": SOLUTION,
    "Innovation": INNOVATION,
    "Tuning": parameters.PARAMETERS["tuning"],
    "Parameters": parameters.PARAMETERS,
    "Nav": state.NAV,
    "Earth": state.EARTH,
    "Imu": state.IMU,
    "Covariance": state.COVARIANCE,
    "Stationarity": state.STATIONARITY,
    "Nhc": state.NHC,
    "Gnss": state.GNSS,
    "Integrity": state.INTEGRITY,
    "Drift": state.DRIFT,
    "Alignment": state.ALIGNMENT,
    "Transition": state.TRANSITION,
    "Scratch": state.SCRATCH,
    "Snapshot": state.SNAPSHOT,
    "Core": state.CORE,
    "HypothesisBank": state.HYPOTHESIS_BANK,
    "Measurement": MEASUREMENT,
    "StoredMeasurement": state.STORED_MEASUREMENT,
    "State": state.STATE,
}
AHRS = {
    "Sample": SAMPLE,
    "Solution": SOLUTION,
    "Tuning": ahrs.PARAMETERS["tuning"],
    "Parameters": ahrs.PARAMETERS,
    "Nav": ahrs.NAV,
    "Covariance": ahrs.COVARIANCE,
    "Imu": ahrs.IMU,
    "Integrals": ahrs.INTEGRALS,
    "Levelling": ahrs.LEVELLING,
    "Motion": ahrs.MOTION,
    "Stationarity": ahrs.STATIONARITY,
    "Divergence": ahrs.DIVERGENCE,
    "Quantization": ahrs.QUANTIZATION,
    "Scratch": ahrs.SCRATCH,
    "State": ahrs.STATE,
}
FILES = {  # file: (what its filter is called, its records)
    ESTIMATORS / "ahrs" / "types.py": ("attitude", AHRS),
    ESTIMATORS / "ins" / "types.py": ("navigation", INS),
}
TO_KALMAN = {"columns": "np.int64"} | dict.fromkeys(("P", "x", "d", "ph", "values"), "np.float64")
HEAD = '''"""The records of the {} filter as types for mypy, written by tests/record_types.py."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Floats(Protocol):
    """A one-dimensional array of numbers."""

    def __getitem__(self, i: int) -> float: ...
    def __setitem__(self, i: Any, value: float) -> None: ...
    def __len__(self) -> int: ...


class Integers(Protocol):
    """A one-dimensional array of integers."""

    def __getitem__(self, i: int) -> int: ...
    def __setitem__(self, i: Any, value: int) -> None: ...
    def __len__(self) -> int: ...
'''


def type_of(dtype, name, records):
    """What mypy knows a field of this dtype as; the kernels of kalman take numpy's arrays."""
    if name in TO_KALMAN:
        return f"NDArray[{TO_KALMAN[name]}]"
    base, shape = dtype.subdtype or (dtype, ())
    if base.names:
        name = next(name for name, record in records.items() if record == base)
        return f"list[{name}]" if shape else name
    kind = "float" if base.kind == "f" else "int"
    if not shape:
        return kind
    return {"float": "Floats", "int": "Integers"}[kind] if len(shape) == 1 else "Any"


def text(path):
    """The whole of this file."""
    filter_name, records = FILES[path]
    parts = [HEAD.format(filter_name)]
    for name, dtype in records.items():
        fields = "".join(f"    {field}: {type_of(dtype[field], field, records)}\n" for field in dtype.names)
        parts.append(f"\n\nclass {name}:\n{fields}")
    return "".join(parts)


if __name__ == "__main__":
    for path in FILES:
        path.write_text(text(path))
