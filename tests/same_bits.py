"""Do the compilers agree? `python tests/same_bits.py [NAME..]` prints a digest of all words of each golden trace's run.

Compare what it prints with IMUD_JIT=1 (numba), with CC=clang and IMUD_KERNELS=/tmp/clang.so (another compiler), or with
--plain (the kernels for any processor, without vectors of AVX2).
"""

import hashlib
import sys

from golden import CLASSES, recording
from golden_run import run

from imud.compile import levels, library


def digest(name):
    """Of all solutions and innovations of a golden trace's run, before they are thinned and rounded."""
    whole = hashlib.sha256()
    for rows in run(recording(name)):
        for field in rows.dtype.names:  # not the padding
            whole.update(rows[field].tobytes())
    return whole.hexdigest()[:16]


if __name__ == "__main__":
    names = sys.argv[1:]
    if "--plain" in names:
        names.remove("--plain")
        library.level = lambda _: levels.PLAIN
    print(f"kernels of {'numba' if library.library() is None else 'the library'}", file=sys.stderr)
    for name in names or CLASSES:
        print(digest(name), name, flush=True)
