"""Entries: what Python calls as machine code is what the function says, from the cache as well, and without numba."""

import os
import subprocess
import sys

import numpy as np
import pytest

from drivers.entry import Entry, _kept, entry
from drivers.jit import kernel

PAIR = np.dtype([("a", "<f8"), ("n", "<i8")], align=True)

PROGRAM = """
import sys
import numpy as np
from drivers.entry import entry
from drivers.jit import kernel

@kernel
def triple(x):
    return 3.0 * x

@entry
def act(rows, k):
    rows[k].a = triple(rows[k].a)
    return rows[k].n

rows = np.array([(1.5, 7), (0.1, -8)], [("a", "<f8"), ("n", "<i8")])
print(act(rows, 1), rows["a"].tolist(), "numba" in sys.modules)
"""


@kernel
def add(x, y):
    return x + y


@entry
def total(rows, weights, offset):
    """Sum of all a, weighted, into the first row; returns how many rows there are."""
    sum_ = 0.0
    for i in range(len(rows)):
        sum_ = add(sum_, rows[i].a * weights[i])
    rows[0].a = sum_ + offset
    return len(rows)


@entry
def double(values):
    for i in range(len(values)):
        values[i] *= 2.0


@entry
def difference(a, b):
    return a - b


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))


def rows_of(*values):
    rows = np.zeros(len(values), PAIR)
    rows["a"] = values
    return rows


@pytest.mark.parametrize(
    ("values", "weights", "offset"),
    [((1.0, 2.0), (0.5, 0.25), 3), ((0.1,), (0.3,), -1), ((1e300, -1e300), (1.0, 1.0), 0)],
)
def test_an_entry_does_what_its_function_says(values, weights, offset):
    rows = rows_of(*values)
    assert total(rows, np.array(weights), offset) == len(values)
    assert rows["a"].tolist() == [sum(v * w for v, w in zip(values, weights, strict=True)) + offset, *values[1:]]


def test_an_array_that_took_the_place_of_another_is_not_taken_for_it():
    for length in range(1, 50):
        values = np.full(length, 1.0)  # likely where the last one was
        assert double(values) == 0
        assert values.tolist() == [2.0] * length
        del values


def test_an_entry_keeps_no_argument_alive():
    import weakref

    values = np.ones(3)
    double(values)
    alive = weakref.ref(values)
    del values
    assert alive() is None


def test_other_types_than_before_are_refused():
    double(np.ones(2))
    read_only = np.ones(2)
    read_only.flags.writeable = False
    for wrong in (np.ones(2, np.float32), np.ones(4)[::2], np.ones((2, 2)), read_only):
        with pytest.raises(TypeError, match=r"double.*argument 0 .*float64"):
            double(wrong)
    assert double(np.ones(2)) == 0


def test_other_kernels_may_call_an_entry_and_c_by_its_address():
    import ctypes

    @kernel
    def twice(a, b):
        return 2 * difference(a, b)

    assert twice(7, 4) == 6
    assert ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)(difference.address)(2**62, -5) == 2**62 + 5


def test_what_allocates_or_may_raise_is_no_entry():
    def raises(n):
        if n > 3:
            raise ValueError
        return n

    def allocates(n):
        return np.zeros(n)[n // 2] + n

    for function in (raises, allocates):
        with pytest.raises(TypeError, match="allocates or may raise"):
            Entry(function)(1)


def run(folder, **variables):
    program = folder / "program.py"
    program.write_text(PROGRAM)
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | variables
    done = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_without_a_cache_it_is_compiled_at_each_start(tmp_path):
    assert run(tmp_path) == "-8 [1.5, 0.30000000000000004] True\n"
    assert [path.name for path in tmp_path.iterdir()] == ["program.py"]


def test_from_the_cache_it_is_the_same_without_numba_and_what_is_damaged_is_made_anew(tmp_path):
    answer = "-8 [1.5, 0.30000000000000004] {}\n"
    assert run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)) == answer.format(True)
    assert run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)) == answer.format(False)
    (file,) = tmp_path.glob("__main__.act-*.o")
    whole = file.read_bytes()
    for damaged in (b"", whole[:-1], whole[:100] + bytes([whole[100] ^ 1]) + whole[101:]):
        file.write_bytes(damaged)
        assert _kept(file) is None
    assert run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)) == answer.format(True)
    assert _kept(file)


def test_what_a_power_cut_left_of_numbas_own_files_is_made_anew(tmp_path):
    answer = run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path))
    for file in (*tmp_path.glob("*.o"), *tmp_path.glob("*/*.nbi"), *tmp_path.glob("*/*.nbc")):
        file.write_bytes(b"")
    assert run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)) == answer
    assert all(file.stat().st_size for file in tmp_path.glob("*/*.nbi"))
