"""Kernels that only tests call, compiled as C: numba would take ten times as long for those that call many others."""

import ctypes
import functools
import tempfile
from pathlib import Path

import numpy as np

from imud.compile import build
from imud.compile.c import Translation, UnsupportedError
from imud.compile.c.kinds import BOOL, FLOAT, INT, VOID, Scalar, Tuple
from imud.drivers.jit import Kernel

NUMBERS = {bool: BOOL, int: INT, float: FLOAT}


class Module:
    """A module with its kernels compiled as C."""

    def __init__(self, module):
        self._module = module

    def __getattr__(self, name):
        value = getattr(self._module, name)
        setattr(self, name, in_c(value) if isinstance(value, Kernel) else value)
        return getattr(self, name)


@functools.cache
def in_c(kernel):
    """The kernel, translated anew for each types of arguments; where that cannot be, numba's.

    Arguments: numbers, tuples of them, records, and contiguous arrays. A tuple that is returned has one type.
    """

    @functools.cache
    def compiled(types):
        unit = Translation()
        kinds = [_kind(unit, each) for each in types]
        function = unit.function(kernel, kinds)
        parameters, passed = [], []
        for i, kind in enumerate(kinds):
            n = kind.n if isinstance(kind, Tuple) else 1
            parameters += [f"{kind.item.c if isinstance(kind, Tuple) else kind.c} a{i}_{k}" for k in range(n)]
            values = ", ".join(f"a{i}_{k}" for k in range(n))
            passed.append(f"({kind.c}){{{{{values}}}}}" if isinstance(kind, Tuple) else values)
            if types[i][0] == "array":
                parameters.append(f"int64_t a{i}_n")
                passed.append(f"a{i}_n")
        returns, call = function.returns, f"{function.name}({', '.join(passed)})"
        if isinstance(returns, Tuple):
            assert isinstance(returns.item, Scalar)
            head, body = "void", f"*({returns.c} *)out = {call};"
            parameters.append("void *out")
        else:
            head, body = returns.c, f"{'' if returns == VOID else 'return '}{call};"
        source = f"{unit.source}\n{head} entry({', '.join(parameters)}) {{ {body} }}\n"
        return _library(source), returns

    def call(*arguments):
        try:
            function, returns = compiled(tuple(map(_type, arguments)))
        except (build.CannotBuildError, UnsupportedError):
            return kernel(*arguments)
        words = [word for argument in arguments for word in _words(argument)]
        if isinstance(returns, Tuple):
            out = np.zeros(returns.n, {"f": float, "i": np.int64, "b": np.bool_}[returns.item.kind])
            function(*words, ctypes.c_void_p(out.ctypes.data))
            return tuple(out.tolist())
        function.restype = {"f": ctypes.c_double, "i": ctypes.c_int64, "b": ctypes.c_bool, "v": None}[returns.kind]
        return function(*words)

    call.py_func = kernel.py_func  # for `interpreted`
    return call


def _type(argument):
    if isinstance(argument, np.void):
        return "record", argument.dtype
    if isinstance(argument, np.ndarray):
        if argument.ndim == 0 or not argument.flags.c_contiguous:
            raise UnsupportedError(argument.shape)
        return "array", argument.dtype, argument.shape[1:]
    if isinstance(argument, tuple):
        return "tuple", float, len(argument)
    return "number", type(argument.item() if isinstance(argument, np.generic) else argument)


def _kind(unit, each):
    name, what, *size = each
    return {
        "record": lambda: unit.of_dtype(what),
        "array": lambda: unit.array(np.dtype((what, size[0]))),
        "tuple": lambda: unit.tuple_of([FLOAT] * size[0]),
        "number": lambda: NUMBERS[what],
    }[name]()


def _words(argument):
    match argument:
        case np.void():
            yield ctypes.c_void_p(np.frombuffer(argument, np.uint8).ctypes.data)
        case np.ndarray():
            yield ctypes.c_void_p(argument.ctypes.data)
            yield ctypes.c_int64(len(argument))
        case tuple():
            yield from map(ctypes.c_double, argument)
        case bool() | np.bool_():
            yield ctypes.c_bool(argument)
        case int() | np.integer():
            yield ctypes.c_int64(int(argument))
        case _:
            yield ctypes.c_double(argument)


def _library(source):
    with tempfile.TemporaryDirectory() as folder:
        text, made = Path(folder, "test.c"), Path(folder, "test.so")
        text.write_text(source)
        build.compile_c(text, made, ("-O1",))
        return ctypes.CDLL(str(made)).entry
