"""Do the compilers agree? `python tests/same_bits.py [NAME..]` prints a digest of all words of each golden trace's run.

Compare what it prints with IMUD_JIT=1 (numba), with CC=clang and IMUD_KERNELS=/tmp/clang.so (another compiler), or with
IMUD_KERNELS=/tmp/plain.so of `python -m imud.compile /tmp/plain.so --plain` (for any processor, without AVX2).
"""

import functools
import hashlib
import os
import subprocess
import sys
from pathlib import Path

from golden import CLASSES, recording
from golden_run import run

from imud.compile import library

LARGER = ("attitude", "navigation", "ins9", "suh-adaptive")


def digest(name):
    """Of all solutions and innovations of a golden trace's run, before they are thinned and rounded."""
    whole = hashlib.sha256()
    for rows in run(recording(name)):
        for field in rows.dtype.names:  # not the padding
            whole.update(rows[field].tobytes())
    return whole.hexdigest()[:16]


@functools.cache
def digests(names, **variables):
    """What this command prints, as words, with these variables in its environment."""
    command = [sys.executable, Path(__file__).name, *names]
    environment = {**os.environ, **variables}
    folder = Path(__file__).resolve().parent
    ended = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, cwd=folder)
    assert ended.stderr.splitlines()[-1] == f"kernels of {'numba' if 'IMUD_JIT' in variables else 'the library'}"
    return ended.stdout.split()


if __name__ == "__main__":
    names = sys.argv[1:]
    print(f"kernels of {'numba' if library.library() is None else 'the library'}", file=sys.stderr)
    for name in names or CLASSES:
        print(digest(name), name, flush=True)
