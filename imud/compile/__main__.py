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
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from . import levels
from .build import UNTRANSLATABLE, CannotBuildError, compile_c, compile_library
from .c import Translation, UnsupportedError
from .seal import all_sources, digests, loaded_sources, seal

_COVERAGE = ("--coverage", "-O1", "-fno-inline")  # a third less time, to compile and to run, than not optimised


def source(with_lines: bool, is_wanted: Callable[[str], bool] = lambda symbol: True) -> str:
    """The kernels that imud calls, those of them that are wanted, in C. Raises UnsupportedError."""
    from ..kernel_calls import entries  # which knows all of imud

    unit = Translation(with_lines)
    for symbol, (kernel, kinds) in entries().items():
        if is_wanted(symbol):
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
    parser.add_argument("--plain", action="store_true", help="for any processor of this machine's kind")
    args = parser.parse_args()
    library = args.library.resolve()
    chosen = (levels.PLAIN,) if args.plain or args.coverage else levels.of_library(args.target)
    try:
        before = digests(all_sources())  # of what is loaded next: an edit from now on makes other sources of them
        if args.c is not None:
            args.c.write_text(source(with_lines=True))
        if args.coverage:
            text = library.with_suffix(".c")
            text.write_text(source(with_lines=True))
            compile_c(text, library, _COVERAGE, args.target)
        else:
            _compile_parts(library, chosen, args.target)
        seal(library, {name: before.get(name, "") for name in loaded_sources()}, chosen)
    except UnsupportedError as error:
        print(error, file=sys.stderr)
        return UNTRANSLATABLE
    except (CannotBuildError, OSError) as error:
        print(f"imud.compile: {error}", file=sys.stderr)
        return 1
    return 0


def _compile_parts(library: Path, chosen: Sequence[str], target: str | None) -> None:
    """Compile the kernels for these levels of processors. Raises UnsupportedError, CannotBuildError, OSError.

    While a compiler has navigation's, the others are translated and compiled, too.
    """
    written = []

    def sources() -> Iterator[Path]:
        for part, is_wanted in (("navigation", _is_navigation), ("others", lambda symbol: not _is_navigation(symbol))):
            kernels = source(with_lines=False, is_wanted=is_wanted)
            for level in chosen:
                written.append(library.with_name(f"{library.name}.{part}{level}.c"))
                written[-1].write_text(levels.text(kernels, level))
                yield written[-1]

    compile_library(sources(), library, target)
    for file in written:
        file.unlink()


def _is_navigation(symbol: str) -> bool:
    """Whether it is an entry of the navigation filter: these take as long to compile as all the others."""
    return "_estimators_ins_" in symbol


if __name__ == "__main__":
    sys.exit(main())
