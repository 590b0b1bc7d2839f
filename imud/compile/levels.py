"""Levels of a processor: kernels for any, and on x86-64 those for processors with AVX2.

AVX2 makes vectors of four numbers instead of two: the covariances take fewer instructions, and the bits are the same.
A library that is built for this machine has the highest level of its processor; a wheel for others has them all. FMA,
which would change the bits, belongs to no level.
"""

import contextlib
import functools
import sys
from pathlib import Path

PLAIN, AVX2 = "", "_avx2"  # what the symbols of a level end with

_BEGIN_AVX2 = """#define EXPORTED(name) name##_avx2
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC target("avx2")
#endif
"""
_END_AVX2 = """
#ifdef __clang__
#pragma clang attribute pop
#endif
"""


@functools.cache
def of_processor() -> tuple[str, ...]:
    """The levels that this processor has, the highest first. Linux names AVX2 only if it saves the registers, too."""
    flags = ""
    with contextlib.suppress(OSError), Path("/proc/cpuinfo").open(errors="replace") as file:
        flags = next((line for line in file if line.startswith("flags")), "")
    return (AVX2, PLAIN) if "avx2" in flags.split() and sys.maxsize > 1 << 32 else (PLAIN,)


def of_library(target: str | None) -> tuple[str, ...]:
    """The levels that a library is built with. target: see `build.compiler`; None: this machine."""
    if target is None:
        return of_processor()[:1]
    return (PLAIN, AVX2) if target.startswith("x86_64") else (PLAIN,)


def text(source: str, level: str) -> str:
    """The C of kernels for processors of this level."""
    return _BEGIN_AVX2 + source + _END_AVX2 if level == AVX2 else source
