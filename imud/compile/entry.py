"""Entries: the kernels that Python calls while samples come, as machine code.

An entry of ours is in the shared library (see `library`); a user's own is compiled by numba when it is first called. A
call is cheap: there is one signature, so nothing is dispatched, and an array that was passed before is passed by the
address that it had.
"""

import contextlib
import ctypes
import functools
import os
import re
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar, cast

import numpy as np

from imud.drivers.jit import Kernel

from ..errors import ImudError
from . import library
from .hashing import digest_of

Function = TypeVar("Function", bound=Callable[..., Any])
Dtype = np.dtype[Any] | None  # of an array's elements; None: an integer
_recorded: "dict[str, tuple[Entry, tuple[Dtype, ...]]] | None" = None  # by symbol, within `recording_entries`


class Entry(Kernel):
    """A kernel whose arguments are integers and 1-d arrays, always of the same types. Returns an integer, or None as 0.

    Called from another kernel it is a kernel like any. Not thread-safe.
    """

    def __init__(self, function: Callable[..., Any], waits: bool = False) -> None:
        """waits: release the GIL during a call, so that other threads run meanwhile."""
        super().__init__(function, nogil=waits)
        self._parameters = function.__code__.co_argcount
        self._interface = ctypes.CFUNCTYPE if waits else ctypes.PYFUNCTYPE
        self._call: Callable[..., int] | None = None  # in the library
        self._dtypes: tuple[Dtype, ...] = ()
        self._last: list[Callable[[], Any]] = []  # weak: an array given once must not be kept alive
        self._words: list[int] = []

    def __call__(self, *arguments: Any) -> int:
        """Raises TypeError if an argument is not of the type it was in the first call; ImudError as `address`."""
        if _recorded is not None:
            return self._record_call(arguments)
        if not self._dtypes:
            self._load(arguments)
        last = self._last
        for i, argument in enumerate(arguments):
            if argument is not last[i]():
                self._set_argument(i, argument)
        if self._call is not None:
            return self._call(*self._words)
        with _compiling(self.name):
            return int(self.by_numba(*arguments) or 0)

    @property
    def address(self) -> int:
        """Address of the machine code, for callers that are compiled themselves. All arguments must be integers.

        Raises ImudError where numba has to compile the function and cannot.
        """
        integers = (0,) * self._parameters
        if _recorded is not None:
            return self._record_call(integers)
        return library.address(symbol(self, _dtypes(integers))) or cast(int, self._callback.address)

    @functools.cached_property
    def by_numba(self) -> Callable[..., int | None]:
        """The same function as numba compiles it. Raises UsageError where there is no numba."""
        _prepare_numba()
        return cast(Callable[..., int | None], self.compiled)

    @functools.cached_property
    def _callback(self) -> Any:
        _prepare_numba()
        import numba

        long = numba.types.int64
        signature = long(*[long] * self._parameters)
        with _compiling(self.name):
            return numba.cfunc(signature, cache="NUMBA_CACHE_DIR" in os.environ, error_model="numpy")(self.py_func)

    def _record_call(self, arguments: tuple[Any, ...]) -> int:
        assert _recorded is not None
        dtypes = _dtypes(arguments)
        _recorded[symbol(self, dtypes)] = self, dtypes
        return 0

    def _load(self, arguments: tuple[Any, ...]) -> None:
        dtypes = _dtypes(arguments)
        sizes = [1 if dtype is None else 2 for dtype in dtypes]
        if (address := library.address(symbol(self, dtypes))) is not None:
            self._call = self._interface(ctypes.c_int64, *[ctypes.c_int64] * sum(sizes))(address)
        self._first_words, self._words = [sum(sizes[:i]) for i in range(len(sizes))], [0] * sum(sizes)
        self._last, self._dtypes = [_nothing] * len(dtypes), dtypes

    def _set_argument(self, i: int, argument: Any) -> None:
        """Remember an argument that differs from the one in the last call."""
        dtype, first = self._dtypes[i], self._first_words[i]
        if dtype is None:
            self._words[first] = argument
        elif argument.dtype == dtype and argument.ndim == 1 and argument.flags.carray:
            self._words[first : first + 2] = argument.ctypes.data, len(argument)
            self._last[i] = weakref.ref(argument)
        else:
            raise TypeError(f"{self.name}: argument {i} must be a writable contiguous array of {dtype}")


@contextlib.contextmanager
def _compiling(name: str) -> Iterator[None]:
    """Within the block numba may compile the function of this name. Raises ImudError if it cannot, with its reason."""
    try:
        yield
    except Exception as error:
        from numba.core.errors import NumbaError

        if not isinstance(error, NumbaError):
            raise
        reason = re.sub(r"\x1b\[\d*m", "", str(error))  # without colours
        raise ImudError(f"numba cannot compile {name}; docs/compile.md says what a kernel may use\n{reason}") from error


def _prepare_numba() -> None:
    from . import numba_cache  # which most processes do not need

    library.require_numba()
    numba_cache.prepare()


def _dtypes(arguments: tuple[Any, ...]) -> tuple[Dtype, ...]:
    return tuple(a.dtype if isinstance(a, np.ndarray) else None for a in arguments)


def _nothing() -> None:
    """Stands for a weak reference whose object is gone."""


def entry(function: Function) -> Function:
    """Make `function` an entry; its own type is kept for the type checker."""
    return cast(Function, Entry(function))


def waiting_entry(function: Function) -> Function:
    """An entry that releases the GIL: other threads run while it waits."""
    return cast(Function, Entry(function, waits=True))


def address_of(kernel: Callable[..., Any]) -> int:
    """Address of an entry's machine code, for `compile.system.call`. All its arguments must be integers."""
    return cast(Entry, kernel).address


def set_unique_name(function: Callable[..., Any], *parts: Callable[..., Any] | np.dtype[Any]) -> None:
    """Name a function that is made for these kernels and dtypes after them, so that no other has its name."""
    names = [_digest([p]) if isinstance(p, np.dtype) else f"{p.__module__}.{p.__qualname__}" for p in parts]
    function.__qualname__ = f"{function.__name__}[{','.join(names)}]"


@contextlib.contextmanager
def recording_entries() -> Iterator[dict[str, tuple[Entry, tuple[Dtype, ...]]]]:
    """Within the block a call of an entry does nothing but note the entry, by symbol, and its arguments' types."""
    global _recorded  # noqa: PLW0603
    _recorded = {}
    try:
        yield _recorded
    finally:
        _recorded = None


def symbol(kernel: Kernel, dtypes: Sequence[Dtype]) -> str:
    """The name in the library of an entry for arguments of these types."""
    return f"{re.sub(r'[^A-Za-z0-9]+', '_', kernel.name).strip('_')}_{_digest(dtypes)}"


def _digest(dtypes: Sequence[Dtype]) -> str:
    types = repr([dtype and (dtype.descr, dtype.itemsize) for dtype in dtypes])
    return digest_of(types.encode())[:8]
