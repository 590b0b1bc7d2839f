"""Levels of a processor: the library has all kernels for any, and on x86-64 once more for those with AVX2.

AVX2 makes vectors of four numbers instead of two: the covariances take fewer instructions, and the bits are the same.
The library says itself which level this processor has, so that one wheel serves all. FMA, which would change the bits,
belongs to no level.
"""

import ctypes
from pathlib import Path

PLAIN, AVX2 = "", "_avx2"  # what the symbols of a level end with

# Intel's manual, vol. 1, sec. 14.3: the processor has AVX2, and the system saves its registers.
_HAS_AVX2 = """
#ifdef __x86_64__
#include <cpuid.h>
int64_t has_avx2(void)
{
  const unsigned avx = bit_OSXSAVE | bit_AVX;
  unsigned a, b, c, d;
  if (!__get_cpuid(1, &a, &b, &c, &d) || (c & avx) != avx) return 0;
  __asm__ volatile("xgetbv" : "=a"(a), "=d"(d) : "c"(0));
  if ((a & 6) != 6 || !__get_cpuid_count(7, 0, &a, &b, &c, &d)) return 0;
  return (b & bit_AVX2) != 0;
}
#endif
"""
_BEGIN_AVX2 = """#ifdef __x86_64__
#define EXPORTED(name) name##_avx2
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
#endif
"""


def files(source: str) -> dict[str, str]:
    """The C of each level of kernels; on another machine than x86-64 all but the first are empty."""
    return {PLAIN: source + _HAS_AVX2, AVX2: _BEGIN_AVX2 + source + _END_AVX2}


def options(target: str | None) -> dict[str, tuple[str, ...]]:
    """More options of the compiler for each level.

    Where the library is built for this machine, and that has AVX2, the plain level serves only if the library is
    copied to an older one. Less optimisation gives the same bits and compiles it in a third of the time.
    """
    cpuinfo = Path("/proc/cpuinfo")
    is_native = target is None and cpuinfo.exists() and "avx2" in cpuinfo.read_text(errors="replace").split()
    return {PLAIN: ("-O1",) if is_native else (), AVX2: ()}


def level(library: ctypes.CDLL) -> str:
    """The highest level of this library that this processor has."""
    has_avx2 = getattr(library, "has_avx2", None)
    return AVX2 if has_avx2 is not None and has_avx2() else PLAIN
