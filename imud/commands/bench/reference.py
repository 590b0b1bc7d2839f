"""The same algorithm in C: translated from the kernels and compiled on the spot, where source tree and compiler are.

The C daemon and the C replay around it stand in tests/c, which is no part of an installed imud.
"""

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from imud.drivers.sample import SAMPLE

from ...compile import c
from ...compile.c.kinds import stored
from ...estimators.records import SOLUTION
from ...math.arrays import Records
from ...pipeline import Filter, InertialPipeline

SOURCES = Path(__file__).resolve().parents[3] / "tests" / "c"
FLAGS = ("-std=gnu11", "-O3", "-march=native", "-w")


class NoReferenceError(Exception):
    """There is no C to compare with; the message says why."""


def compiler() -> str:
    """The C compiler. Raises NoReferenceError."""
    for name in ("gcc", "cc", "clang"):
        if path := shutil.which(name):
            return path
    raise NoReferenceError("no C compiler (gcc, cc, clang) is on this machine")


class _Recorder:
    """Replaces a kernel, and records the arguments of its last call."""

    def __init__(self, answer: int) -> None:
        self._answer = answer
        self.arguments: tuple[Any, ...] = ()

    def __call__(self, *arguments: Any) -> int:
        self.arguments = arguments
        return self._answer


def _dtypes(arguments: tuple[Any, ...]) -> list[np.dtype[Any] | None]:
    return [a.dtype if isinstance(a, np.ndarray) else None for a in arguments]


def to_c(filters: Sequence[Filter], folder: Path) -> None:
    """Replace the kernels of filters, for samples and for fixes, by C of one library. Raises NoReferenceError."""
    unit = c.Translation()
    for number, filter_ in enumerate(filters):
        kernel, recorder = filter_.stages.feed, _Recorder(0)
        filter_.stages.feed = recorder
        filter_.run(np.zeros(1, SAMPLE), np.zeros(1, SOLUTION))
        unit.export(kernel, _dtypes(recorder.arguments), f"feed_{number}")
    library = build(unit.source, folder)
    for number, filter_ in enumerate(filters):
        filter_.stages.feed = partial(call, library[f"feed_{number}"])


def pipeline_source(pipeline: InertialPipeline) -> tuple[str, bytes]:
    """`InertialPipeline.ingest` in C as `int64_t ingest(received, arrival_ns)`, with its memory; and the contents.

    RX, DECODER and SOLUTIONS name the buffers; `memory` lists all of them, in the order of the bytes returned.
    """
    unit = c.Translation()
    s, f = pipeline, pipeline.filter
    parts: dict[str, tuple[Any, tuple[Any, ...]]] = {
        "decode": (s.decode, (s.rx, "fill + received", s.decoder, s.samples)),
        "advance": (
            f.stages.step_batch,
            (s.samples, "n", "arrival_ns", s.clock, f.health, f.correction, f.parameters, f.state, s.solutions),
        ),
    }
    buffers: dict[int, tuple[str, Any]] = {}
    texts = {}
    for name, (kernel, arguments) in parts.items():
        unit.export(kernel, _dtypes(arguments), name)
        for array in (a for a in arguments if isinstance(a, np.ndarray)):
            buffers.setdefault(array.ctypes.data, (f"memory_{len(buffers)}", array))
        texts[name] = ", ".join(
            f"(int64_t){buffers[a.ctypes.data][0]}, {len(a)}" if isinstance(a, np.ndarray) else a for a in arguments
        )
    lines = [unit.source, "#include <stddef.h>"]
    for name, array in buffers.values():
        lines.append(f"static {stored(unit.of_dtype(array.dtype))} {name}[{len(array)}];")
    listed = ", ".join(f"{{{name}, sizeof {name}}}" for name, _ in buffers.values())
    lines.append(f"static const struct {{ void *at; size_t size; }} memory[] = {{{listed}}};")
    for alias, array in (("RX", pipeline.rx), ("DECODER", pipeline.decoder), ("SOLUTIONS", pipeline.solutions)):
        lines.append(f"#define {alias} {buffers[array.ctypes.data][0]}")
    lines.append(
        "static int64_t fill;\n"
        "static int64_t ingest(int64_t received, int64_t arrival_ns)\n{\n"
        f"  int64_t n = decode({texts['decode']});\n  fill = DECODER->leftover;\n"
        f"  if (n)\n    advance({texts['advance']});\n  return n;\n}}\n"
    )
    return "\n".join(lines), b"".join(array.tobytes() for _, array in buffers.values())


def build(text: str, folder: Path, main: Path | None = None, options: Sequence[str] = ()) -> ctypes.CDLL:
    """Compile to a shared library and load it; main: a file that includes kernels.c. Raises NoReferenceError."""
    (folder / "kernels.c").write_text(text)
    shared = ("-shared", "-fPIC", "-Wl,-Bsymbolic", f"-I{folder}")
    compile_c(main or folder / "kernels.c", folder / "kernels.so", *shared, *options)
    return ctypes.CDLL(str(folder / "kernels.so"))


def compile_c(file: Path, output: Path, *options: str) -> None:
    """Raises NoReferenceError with what the compiler said."""
    if not file.exists():
        raise NoReferenceError(f"{file} is not installed: run from a checkout of the source")
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
            passed.append(
                argument if isinstance(argument, ctypes.c_void_p | ctypes.c_char_p) else ctypes.c_int64(argument)
            )
    function.restype = ctypes.c_int64
    return int(function(*passed))


def pointer(record: Records) -> ctypes.c_void_p:
    """A record as an argument for `call`."""
    return ctypes.c_void_p(record.ctypes.data)
