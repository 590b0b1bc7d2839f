"""Entries: what Python calls as machine code is what the function says, from the library and from numba."""

import ctypes
import weakref

import numpy as np
import pytest

from imud.compile import build, entry, library
from imud.compile.c import Translation
from imud.compile.entry import Entry, address_of, recording_entries
from imud.drivers.jit import kernel
from imud.errors import ImudError

PAIR = np.dtype([("a", "<f8"), ("n", "<i8")], align=True)


@kernel
def add(x, y):
    return x + y


def total(rows, weights, offset):
    """Sum of all a, weighted, into the first row; returns how many rows there are."""
    sum_ = 0.0
    for i in range(len(rows)):
        sum_ = add(sum_, rows[i].a * weights[i])
    rows[0].a = sum_ + offset
    return len(rows)


def double(values):
    for i in range(len(values)):
        values[i] *= 2.0


def difference(a, b):
    return a - b


@pytest.fixture(params=["library", "numba"])
def made(request, monkeypatch, tmp_path):
    """Makes entries of functions: in a library made for them and their arguments, or not."""

    def make(function, *arguments):
        one = Entry(function)
        if request.param == "library":
            with recording_entries() as noted:
                one(*arguments)
            unit = Translation()
            for symbol, (kernel_, dtypes) in noted.items():
                unit.export(kernel_, dtypes, symbol)
            (tmp_path / "unit.c").write_text(unit.source)
            try:
                build.compile_c(tmp_path / "unit.c", tmp_path / "unit.so")
            except build.CannotBuildError as error:
                pytest.skip(str(error))
            loaded = ctypes.CDLL(str(tmp_path / "unit.so"))
            monkeypatch.setattr(library, "library", lambda: loaded)
        return one

    return make


def rows_of(*values):
    rows = np.zeros(len(values), PAIR)
    rows["a"] = values
    return rows


@pytest.mark.parametrize(
    ("values", "weights", "offset"),
    [((1.0, 2.0), (0.5, 0.25), 3), ((0.1,), (0.3,), -1), ((1e300, -1e300), (1.0, 1.0), 0)],
)
def test_an_entry_computes_what_its_function_computes(made, values, weights, offset):
    call = made(total, rows_of(1.0), np.ones(1), 0)
    rows = rows_of(*values)
    assert call(rows, np.array(weights), offset) == len(values)
    assert rows["a"].tolist() == [sum(v * w for v, w in zip(values, weights, strict=True)) + offset, *values[1:]]


def test_an_array_at_the_address_of_another_is_not_mistaken_for_it(made):
    call = made(double, np.ones(1))
    for length in range(1, 50):
        values = np.full(length, 1.0)  # likely where the last one was
        assert call(values) == 0
        assert values.tolist() == [2.0] * length
        del values


def test_an_entry_keeps_no_argument_alive(made):
    values = np.ones(3)
    made(double, values)(values)
    alive = weakref.ref(values)
    del values
    assert alive() is None


def test_other_types_than_before_are_refused(made):
    call = made(double, np.ones(2))
    call(np.ones(2))
    read_only = np.ones(2)
    read_only.flags.writeable = False
    for wrong in (np.ones(2, np.float32), np.ones(4)[::2], np.ones((2, 2)), read_only):
        with pytest.raises(TypeError, match=r"double.*argument 0 .*float64"):
            call(wrong)
    assert call(np.ones(2)) == 0


def test_other_kernels_may_call_an_entry_and_c_by_its_address(made):
    minus = made(difference, 0, 0)

    @kernel
    def twice(a, b):
        return 2 * minus(a, b)

    assert twice(7, 4) == 6
    assert ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)(address_of(minus))(2**62, -5) == 2**62 + 5


def test_while_noting_nothing_is_called_and_the_types_are_part_of_the_symbol():
    values = np.ones(2)
    one = Entry(double)
    with recording_entries() as noted:
        assert one(values) == one(values) == one(np.ones(1, np.float32)) == 0
    assert [dtypes for _, dtypes in noted.values()] == [(np.dtype(float),), (np.dtype(np.float32),)]
    assert values.tolist() == [1.0, 1.0]


def test_entries_made_for_different_kernels_or_records_have_different_names():
    def composed(*parts):
        def act(n):
            return n

        entry.set_unique_name(act, *parts)
        return Entry(act)

    parts = ((total,), (double,), (total, PAIR), (total, np.dtype(float)))
    names = {entry.symbol(composed(*part), [None]) for part in parts}
    assert len(names) == len(parts)


@pytest.mark.thorough
def test_what_numba_cannot_compile_is_named_with_the_reason(monkeypatch):
    def first(n):
        return sorted({n: n})[0].name

    monkeypatch.setattr(library, "library", lambda: None)
    for call in (lambda: Entry(first)(1), lambda: address_of(Entry(first))):
        with pytest.raises(ImudError, match=r"numba cannot compile .*first; docs/compile\.md") as caught:
            call()
        assert "sorted" in str(caught.value) and "\x1b" not in str(caught.value)
