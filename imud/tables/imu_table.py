"""imu.csv as `imud export` writes it: a row for each sample, each number with as few digits as give it back exactly."""

from typing import BinaryIO

import msgspec
import numpy as np

from ..compile.entry import entry
from ..math.arrays import Floats, Indices
from ..math.decimal import MAX_WIDTH, Bytes, write_seconds

_OPEN, _CLOSE, _COMMA, _NEWLINE = (ord(c) for c in "[],\n")
_IN_NULL = ord("l")  # and above: the letters of null; of a number none is


@entry
def _join(text: Bytes, t_ns: Indices, out: Bytes) -> int:
    """text: rows of numbers as JSON, `[[1.5,null],[0,2e-7]]`. out: the same as CSV, a time before each row, null as an
    empty cell. Returns its length.
    """
    at = k = 0
    within = False
    for i in range(1, len(text)):
        c = text[i]
        if c == _OPEN:
            at = write_seconds(out, at, t_ns[k])
            out[at] = _COMMA
            at += 1
            k += 1
            within = True
        elif c == _CLOSE and within:
            out[at] = _NEWLINE
            at += 1
            within = False
        elif within and c < _IN_NULL:
            out[at] = c
            at += 1
    return at


def write_rows(file: BinaryIO, t_ns: Indices, cells: Floats) -> None:
    """Append a row for each time, of the numbers in the same row of `cells`; NaN is an empty cell."""
    text = np.frombuffer(bytearray(msgspec.json.encode(cells.tolist())), np.uint8)
    out = np.empty(len(text) + MAX_WIDTH * len(t_ns), np.uint8)
    file.write(out[: _join(text, np.ascontiguousarray(t_ns), out)].data)
