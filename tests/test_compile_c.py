"""Kernels as C: their numbers are those of numba, and what has no translation is named, with its place."""

import ctypes
import inspect
import json
import math
import re
import subprocess
import sys

import numpy as np
import pytest

from imud.compile import build
from imud.compile.c import Translation, UnsupportedError
from imud.drivers import elementary
from imud.drivers.jit import kernel, written_out

PLACE = np.dtype([("v", "<f8", (3,)), ("n", "<i4")], align=True)
PART = np.dtype([("place", PLACE), ("places", PLACE, (2,)), ("P", "<f8", (2, 3))], align=True)
LONG = np.dtype(
    [("one", [("v", "<f8", (40,)), ("n", "<i4")]), ("two", [("v", "<f8", (40,)), ("n", "<i4")])], align=True
)
WHOLE = np.dtype([("flag", "?"), ("nav", PART), ("parts", PART, (2, 2)), ("k", "<i8")], align=True)
TABLE = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
LIMIT = 7


@pytest.fixture(scope="module", autouse=True)
def compiler():
    try:
        build.compiler()
    except build.CannotBuildError as error:
        pytest.skip(str(error))


@pytest.fixture
def in_c(tmp_path):
    """Makes a function of arrays and integers from a Python function, through C."""

    def make(function, *arguments, options=()):
        unit = Translation(with_lines="--coverage" in options)
        unit.export(function, [a.dtype if isinstance(a, np.ndarray) else None for a in arguments], "entry")
        (tmp_path / "unit.c").write_text(unit.source)
        build.compile_c(tmp_path / "unit.c", tmp_path / "unit.so", options)
        entry = ctypes.CDLL(str(tmp_path / "unit.so")).entry
        entry.restype = ctypes.c_int64

        def call(*arguments):
            words = []
            for argument in arguments:
                pair = (argument.ctypes.data, len(argument)) if isinstance(argument, np.ndarray) else (argument,)
                words += [ctypes.c_int64(int(word)) for word in pair]
            return entry(*words)

        return call

    return make


@kernel
def move(place, by):
    """A nested record as an argument."""
    for i in range(3):
        place.v[i] += by
    place.n += 1


@kernel
def total(values):
    """What is left of an array of unknown length."""
    sum_ = 0.0
    for k in range(len(values)):
        sum_ += values[k]
    return sum_


@kernel
def nested(rows):
    c = rows[1]
    nav = c.nav
    nav.place.v[0] = 3.0
    nav.P[1, 2] = c.nav.place.v[0] * 0.5
    c.nav.P[0][1] = -1.0
    move(nav.place, 0.25)
    move(c.parts[1, 0].places[1], 2.0)
    c.parts[0, 1].places[0] = nav.place
    c.parts[1, 1] = c.parts[0, 1]
    c.flag = c.parts[1, 1].places[0].n == 1
    return nav.place.n


@kernel
def copied(rows):
    rows[0].one, rows[0].two = rows[1].two, rows[1].one
    rows[1].two = rows[0].one
    return rows[0].two.n


@kernel
def arithmetic(x, y, out):
    a, b = x[0], x[1]
    a, b = b, a
    out[0] = a**3 - b**2 / (1.0 + abs(a)) + b**0.5
    out[1] = elementary.atan2(a, b) if a > 0.0 else elementary.sin(b)
    out[2] = -7 // y + (-7 % y) + (5 if y in (1, 2, 3) else 9)
    out[3] = max(a, b, 0.5) - min(a, b)
    p, q, r = TABLE[1]
    n = 0
    for k in range(10, 0, -3):
        if k == 4:
            continue
        n += k
    while n > LIMIT:
        n -= 2
    for z in (0.5, a):
        out[4] += z
    out[5] = p + q * r + n + total(x[1:]) + int(3.9) + math.floor(-0.5)
    out[6] = min(math.nan, a) + math.isnan(out[5])
    return (~y ^ 3) & 0xFF | 1 << 9


@kernel
def summed(values, out):
    for i in written_out(3):
        for k in range(i, 3):
            out[i] += values[k]
    return len(out)


@kernel
def divided(n, out):
    out[0], out[1], out[2], out[3] = n // 1, n % 1, n // 8, n % 8
    out[4], out[5], out[6], out[7] = n // 4096, n % 4096, n // 6, n % 6
    out[8], out[9] = n // -4, n % -4
    return n // 2


def test_nested_records_and_arrays_of_them(in_c):
    ours = np.zeros(3, WHOLE)
    ours["k"] = 5
    theirs = ours.copy()
    assert in_c(nested, theirs)(theirs) == nested(ours) == 1
    assert (theirs == ours).all()
    assert theirs[1]["parts"][1, 1]["places"][0]["v"].tolist() == [3.25, 0.25, 0.25]
    assert theirs[1]["flag"]


def test_long_records_are_copied(in_c):
    rows = np.zeros(2, LONG)
    rows[1]["one"]["v"], rows[1]["two"]["v"] = np.arange(40.0), -np.arange(40.0)
    rows["one"]["n"] = 7
    assert in_c(copied, rows)(rows) == 7
    assert rows[0]["two"]["v"].tolist() == np.arange(40.0).tolist()
    assert rows[0]["one"]["v"].tolist() == rows[1]["two"]["v"].tolist() == (-np.arange(40.0)).tolist()


@pytest.mark.thorough
@pytest.mark.parametrize("y", [0, 1, 2, 3, -3, 100])
@pytest.mark.parametrize("x", [(1.5, 2.25, -4.0), (0.1, 1e9, 0.2), (3.0, -7.0, 1e-300), (-0.3, 0.7, math.inf)])
def test_the_bits_are_numbas(in_c, x, y):
    ours, theirs = np.zeros(7), np.zeros(7)
    assert in_c(arithmetic, np.array(x), y, theirs)(np.array(x), y, theirs) == arithmetic(np.array(x), y, ours)
    assert theirs.tobytes() == ours.tobytes()


def test_a_loop_that_is_written_out_does_what_any_other_does(in_c, tmp_path):
    values, out = np.array([1.0, 2.0, 4.0]), np.zeros(3)
    assert in_c(summed, values, out)(values, out) == 3
    assert out.tolist() == [7.0, 6.0, 4.0]
    assert re.search(r"#pragma GCC unroll 64\n *for ", (tmp_path / "unit.c").read_text())


@pytest.mark.parametrize("n", [0, 1, -1, 7, -8, -9, 4095, -4096, -4097, 2**63 - 1, -(2**63)])
def test_a_division_by_a_known_number_rounds_down(in_c, n):
    got = np.zeros(10, np.int64)
    assert in_c(divided, n, got)(n, got) == n // 2
    pairs = [[n // by, n % by] for by in (1, 8, 4096, 6, -4)]
    assert got.reshape(5, 2).tolist() == pairs


def test_a_line_of_c_names_its_line_of_python(in_c, tmp_path):
    """So gcov counts the lines of Python that ran."""
    if "gcc" not in subprocess.run([*build.compiler(), "-v"], capture_output=True, text=True, check=True).stderr:
        pytest.skip("gcov needs gcc")
    program = f"import ctypes; ctypes.CDLL('{tmp_path}/unit.so').entry"
    in_c(branching, 1, options=("--coverage", "-O0"))
    subprocess.run([sys.executable, "-c", f"{program}(ctypes.c_int64(1))"], check=True)
    command = ("gcov", "--json-format", "--stdout", str(next(tmp_path.glob("*.gcda"))))
    counted = json.loads(subprocess.run(command, capture_output=True, check=True, cwd=tmp_path).stdout)
    (file,) = (file for file in counted["files"] if file["file"] == __file__)
    counts = {line["line_number"]: line["count"] for line in file["lines"]}
    first = inspect.getsourcelines(branching.py_func)[1]
    assert [counts[first + k] > 0 for k in (2, 3, 4)] == [True, True, False]


@kernel
def branching(n):
    if n > 0:
        return 5
    return n * 7


def deleting(n):
    del n


def raising(n):
    if n > 3:
        raise ValueError
    return n


def allocating(n):
    return np.zeros(n)[0]


def named(n):
    return math.fma(n, y=n)


def of_the_c_library(x):
    return math.sin(x[0])


def fractional(x):
    return x[0] ** 1.5


def unknown(n):
    return print(n)


def rounded(x):
    return round(x[0])


@kernel
def add(a, b):
    return a + b


def too_few(n):
    return add(n)


def two_casts(n):
    return float(n, 2)


def too_many_values(n):
    a, b = n, n, n
    return a + b


def from_the_end(values):
    values[-1] = 0.0


def several(n):
    x = 1.0
    x = (1.0, 2.0)
    return x[0] > n


def copying_a_row(parts):
    parts[0].P[1] = parts[0].P[0]


def copying_elements(parts):
    parts[0].P[:] = parts[0].P


@pytest.mark.parametrize(
    ("function", "what"),
    [
        (deleting, r"statement: del n"),
        (raising, r"statement: raise ValueError"),
        (allocating, r"function of a library; write np\.empty\(N\), .*: np\.zeros\(n\)"),
        (named, r"call with keywords or \*: math"),
        (of_the_c_library, r"use imud\.drivers\.elementary\.sin for this: math\.sin"),
        (fractional, r"power, whose exponent is no positive integer constant: x\[0\] \*\* 1\.5"),
        (rounded, r"call; write int\(np\.rint\(x\)\): round\(x\[0\]\)"),
        (unknown, r"call: print\(n\)"),
        (from_the_end, r"index from the end: values\[-1\]"),
        (several, r"variable that is both double and t2_double"),
        (copying_a_row, r"assignment of a whole array: parts\[0\]\.P\[1\]"),
        (too_few, r"call with 1 arguments of a kernel that takes 2: add\(n\)"),
        (two_casts, r"call with 2 arguments instead of one: float\(n, 2\)"),
        (too_many_values, r"assignment of 3 values: \(a, b\)"),
        (copying_elements, r"assignment of a whole array: parts\[0\]\.P\[:\]"),
    ],
)
def test_what_has_no_translation_is_named_with_file_and_line(function, what):
    unit = Translation()
    argument = {copying_a_row: PART, copying_elements: PART} | dict.fromkeys(
        (from_the_end, of_the_c_library, fractional, rounded), np.dtype(float)
    )
    with pytest.raises(UnsupportedError, match=rf"test_compile_c\.py:\d+: .*{what}"):
        unit.export(function, [argument.get(function)], "entry")


def test_a_kernel_that_calls_itself_is_refused():
    @kernel
    def endless(n):
        return endless(n - 1)

    with pytest.raises(UnsupportedError, match="endless calls itself"):
        Translation().export(endless, [None], "entry")


def test_a_record_whose_layout_c_would_not_have_is_not_compiled(tmp_path):
    packed = np.dtype([("a", "u1"), ("b", "<f8")])
    unit = Translation()
    unit.record(packed)
    (tmp_path / "unit.c").write_text(unit.source)
    with pytest.raises(build.CannotBuildError, match="layout"):
        build.compile_c(tmp_path / "unit.c", tmp_path / "unit.so")


@pytest.mark.thorough
def test_all_kernels_of_imud_have_a_translation():
    from imud.compile.__main__ import source

    text = source(with_lines=False)
    for name in (
        "feed_imud_estimators",
        "advance_pipeline",
        "decode_received_imud_drivers_epson",
        "stages_ingest",
        "fast_loop_run_until_event",
    ):
        assert re.search(rf"^int64_t EXPORTED\(\w*{name}\w*\)\(int64_t", text, re.MULTILINE), name
