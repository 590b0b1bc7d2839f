"""Kernels that only a test calls, compiled as C: numba would take ten times as long for those that call much."""

import ctypes
import functools
import tempfile
from pathlib import Path

from imud.compile import build
from imud.compile.c import Translation
from imud.compile.entry import entry


def in_c(function):
    """A function of records and arrays, all one-dimensional, that is translated at its first call; numba where there is
    no compiler. Returns nothing.
    """
    kernel = entry(function)

    @functools.cache
    def compiled(dtypes):
        unit = Translation()
        unit.export(kernel, dtypes, "entry")
        with tempfile.TemporaryDirectory() as folder:
            source, library = Path(folder, "test.c"), Path(folder, "test.so")
            source.write_text(unit.source)
            build.compile_c(source, library, ("-O1",))
            return ctypes.CDLL(str(library)).entry

    def call(*arguments):
        try:
            called = compiled(tuple(array.dtype for array in arguments))
        except build.CannotBuildError:
            kernel.by_numba(*arguments)
            return
        assert all(array.ndim == 1 and array.flags.carray for array in arguments)
        pairs = [(ctypes.c_void_p(a.ctypes.data), ctypes.c_int64(len(a))) for a in arguments]
        called(*(word for pair in pairs for word in pair))

    return call
