"""`python -m imud.compile LIBRARY`: all kernels of these sources in one shared library. Takes some 15 s.

--c FILE keeps the C; its `#line` directives say from which line of Python each line comes, for debuggers and profilers.

--coverage counts how often each line of Python runs, through gcc's gcov. Run whatever uses the library, then ask gcov:

    python -m imud.compile /tmp/k/kernels.so --coverage      # writes kernels.gcno beside it
    IMUD_KERNELS=/tmp/k/kernels.so pytest tests/test_x.py    # adds to kernels.gcda beside it at each process's end
    cd /tmp/k && gcov --json-format --stdout kernels.gcda    # or: gcov kernels.gcda, which writes NAME.py.gcov

--target builds for another machine, with the Python package `ziglang`.

A kernel that several others call with different types is several functions of C; gcov adds up their counts.
"""

import argparse
import sys
from pathlib import Path

from .build import CannotBuildError, compile_c
from .c import Translation, UnsupportedError
from .seal import loaded_sources, seal

_COVERAGE = ("--coverage", "-O0")  # optimised, lines would be merged; the bits are the same


def source(with_lines: bool) -> str:
    """All kernels that imud calls, in C. Raises UnsupportedError."""
    from ..compilation import entries  # which knows all of imud

    unit = Translation(with_lines)
    for symbol, (kernel, kinds) in entries().items():
        unit.export(kernel, kinds, symbol)
    return unit.source


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m imud.compile", description="all kernels in one shared library", allow_abbrev=False
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--c", type=Path, metavar="FILE", help="where to keep the C (default: nowhere)")
    parser.add_argument("--coverage", action="store_true", help="count the lines that run, for gcov")
    parser.add_argument("--target", help="another machine, as zig names it: aarch64-linux-gnu.2.28 (default: this one)")
    args = parser.parse_args()
    library = args.library.resolve()
    text = args.c or library.with_suffix(".c")
    try:
        text.write_text(source(with_lines=args.c is not None or args.coverage))
        compile_c(text, library, _COVERAGE if args.coverage else (), args.target)
        seal(library, loaded_sources())
    except (UnsupportedError, CannotBuildError, OSError) as error:
        print(f"imud.compile: {error}", file=sys.stderr)
        return 1
    if args.c is None and not args.coverage:
        text.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
