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

from . import levels
from .build import UNTRANSLATABLE, CannotBuildError, compile_c, compile_library
from .c import Translation, UnsupportedError
from .seal import all_sources, digests, loaded_sources, seal

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
    try:
        before = digests(all_sources())  # of what is loaded next: an edit from now on makes other sources of them
        kernels = source(with_lines=args.c is not None or args.coverage)
        if args.c is not None:
            args.c.write_text(kernels)
        if args.coverage:  # of one level: the lines are the same
            text = library.with_suffix(".c")
            text.write_text(kernels)
            compile_c(text, library, _COVERAGE, args.target)
        else:
            _compile_levels(kernels, library, args.target)
        seal(library, {name: before.get(name, "") for name in loaded_sources()})
    except UnsupportedError as error:
        print(error, file=sys.stderr)
        return UNTRANSLATABLE
    except (CannotBuildError, OSError) as error:
        print(f"imud.compile: {error}", file=sys.stderr)
        return 1
    return 0


def _compile_levels(kernels: str, library: Path, target: str | None) -> None:
    """Compile the kernels for each level of processors to one library. Raises CannotBuildError, OSError."""
    sources, options = {}, levels.options(target)
    for level, text in levels.files(kernels).items():
        source = library.with_name(f"{library.name}{level}.c")
        source.write_text(text)
        sources[source] = options[level]
    compile_library(sources, library, target)
    for source in sources:
        source.unlink()


if __name__ == "__main__":
    sys.exit(main())
