"""The messages on /states: a row of `estimators.filter_states`, without the numbers that are not known.

A source that is not there costs no byte, and seven digits are enough for the others. The numbers of the fields follow
from the order of STATES.
"""

import math
import struct
from collections.abc import Sequence

import numpy as np

from imud.drivers.protobuf import FIXED64, Field, delimited, fields, single, tag

from ..estimators.filter_states import FILTER_STATES
from ..filter_state_names import COVARIANCES, STATES
from ..math.arrays import Records

_FIRST = 3  # number of the first state's value; that of its sigma is one more
_NAMES = ["_".join(filter(None, (state.name, state.unit))) for state in STATES]
STATES_FIELDS = (
    Field(1, "t_ns", "sfixed64", about="CLOCK_MONOTONIC of the host, ns"),
    Field(2, "covariance", "float", True, f"upper triangle, row by row, m, m/s and rad: {' '.join(COVARIANCES)}"),
    *(
        field
        for i, (name, state) in enumerate(zip(_NAMES, STATES, strict=True))
        for field in (
            Field(_FIRST + 2 * i, name, "float", about=state.about),
            Field(_FIRST + 2 * i + 1, f"sigma_{name}", "float", about="1 sigma"),
        )
    ),
)


def states_message(row: np.void) -> bytes:
    """Of a row of FILTER_STATES."""
    parts = [tag(1, FIXED64) + struct.pack("<q", row["t_ns"])]
    with np.errstate(over="ignore"):  # infinite then
        covariance, numbers = row["covariance"].astype("<f4"), np.stack([row["value"], row["sigma"]], 1).astype("<f4")
    if np.isfinite(covariance[-1]):
        parts.append(delimited(2, covariance.tobytes()))
    parts += [
        single(i, number) for i, number in enumerate(numbers.reshape(-1).tolist(), _FIRST) if math.isfinite(number)
    ]
    return b"".join(parts)


def states_rows(messages: Sequence[bytes]) -> Records:
    """The other way round. Raises ValueError for what is no such message."""
    rows = np.zeros(len(messages), FILTER_STATES)
    for name in ("covariance", "value", "sigma"):
        rows[name] = math.nan
    for row, message in zip(rows, messages, strict=True):
        for number, value in fields(message):
            if not isinstance(value, bytes):
                raise ValueError("it is no imud.v1.States")
            if number == 1:
                (row["t_ns"],) = np.frombuffer(value, "<i8")
            elif number == 2:
                row["covariance"] = np.frombuffer(value, "<f4").reshape(len(COVARIANCES))
            elif 0 <= (i := number - _FIRST) < 2 * len(STATES):  # there may be more in a later version
                (row["sigma" if i % 2 else "value"][i // 2],) = np.frombuffer(value, "<f4")
    return rows
