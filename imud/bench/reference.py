"""The same algorithm in C: translated from the kernels and compiled on the spot, where source tree and compiler are.

The translator stands in tests/c, beside the C daemon; neither is part of an installed imud.
"""

import ctypes
import importlib.util
import shutil
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.sample import SAMPLE
from imud.clock import new_clock
from imud.estimators.records import FIX, INNOVATION, SOLUTION
from imud.pipeline import Filter

Records = NDArray[np.void]
SOURCES = Path(__file__).resolve().parents[2] / "tests" / "c"
FLAGS = ("-std=gnu11", "-O3", "-march=native", "-w")


class NoReferenceError(Exception):
    """Why there is nothing to compare with."""


def compiler() -> str:
    """The C compiler. Raises NoReferenceError."""
    if not SOURCES.is_dir():
        raise NoReferenceError("the C reference is not installed: run from a checkout of the source")
    for name in ("gcc", "cc", "clang"):
        if path := shutil.which(name):
            return path
    raise NoReferenceError("no C compiler (gcc, cc, clang) is on this machine")


def translator() -> ModuleType:
    """tests/c/translate.py as a module."""
    spec = importlib.util.spec_from_file_location("imud_c_translate", SOURCES / "translate.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def source(filter_: Filter, decode: Any = None, decoder: Records | None = None) -> str:
    """C of the estimator's `run`, `advance` and `update`, and of a driver's `decode`, as exported functions."""
    c = translator()
    unit = c.Translation()

    def array(like: Any) -> Any:
        return unit.array(like.dtype if isinstance(like, np.ndarray) else like)

    parameters, state = array(filter_.parameters), array(filter_.state)
    matrix, clock, solutions = array(np.float64), array(new_clock(1e6, 0.0)), array(SOLUTION)
    unit.function(filter_._run, [array(SAMPLE), matrix, parameters, state, solutions], exported="run")
    advanced = [array(SAMPLE), c.INT, c.INT, clock, matrix, parameters, state, solutions]
    unit.function(filter_._advance, advanced, exported="advance")
    if filter_.estimator.update is not None:
        records = [unit.record(like.dtype) for like in (filter_.parameters, filter_.state)]
        updated = [*records, unit.record(FIX), array(INNOVATION)]
        unit.function(filter_.estimator.update, updated, exported="update")
    if decode is not None and decoder is not None:
        unit.function(decode, [array(np.uint8), c.INT, array(decoder), array(SAMPLE)], exported="decode")
    names = {"sample_t": SAMPLE, "solution_t": SOLUTION, "fit_t": new_clock(1e6, 0.0).dtype}
    names |= {"parameters_t": filter_.parameters.dtype, "state_t": filter_.state.dtype}
    if decoder is not None:
        names["decoder_t"] = decoder.dtype
    typedefs = [f"typedef struct {unit.record(dtype).name} {name};" for name, dtype in names.items()]
    return "\n".join([unit.source, *typedefs, ""])


def build(text: str, folder: Path, main: Path | None = None) -> ctypes.CDLL:
    """Compile to a shared library and load it; main: a file that includes kernels.c. Raises NoReferenceError."""
    (folder / "kernels.c").write_text(text)
    compile_c(main or folder / "kernels.c", folder / "kernels.so", "-shared", "-fPIC", "-Wl,-Bsymbolic", f"-I{folder}")
    return ctypes.CDLL(str(folder / "kernels.so"))


def compile_c(file: Path, output: Path, *options: str) -> None:
    """Raises NoReferenceError with what the compiler said."""
    command = [compiler(), *FLAGS, *options, "-o", str(output), str(file), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise NoReferenceError(f"{file} does not compile: {done.stderr[:500]}")


def call(function: Any, *arguments: Any) -> int:
    """Call an exported function: arrays as pointer and length, integers as they are."""
    passed: list[Any] = []
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            passed += [ctypes.c_void_p(argument.ctypes.data), ctypes.c_int64(len(argument))]
        else:
            passed.append(argument if isinstance(argument, ctypes.c_void_p) else ctypes.c_int64(argument))
    function.restype = ctypes.c_int64
    return int(function(*passed))


def pointer(record: Records) -> ctypes.c_void_p:
    """A record as an argument for `call`."""
    return ctypes.c_void_p(record.ctypes.data)
