"""Which lines of the estimators' kernels do the golden traces run? `python tests/golden_coverage.py`

All recordings run on a library in which gcc counts the lines, by the `#line` directives of the translation.
"""

import ast
import ctypes
import functools
import json
import shutil
import subprocess
import tempfile
from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from golden import CLASSES, recording
from golden_run import run
from kernels_in_c import to_c, translated

import imud.estimators
from imud.compile import build
from imud.compile.c import Translation

FOLDER = Path(imud.estimators.__file__).resolve().parent
DUMP = "void __gcov_dump(void);\nvoid write_counts(void) { __gcov_dump(); }\n"  # at once, not when the process ends
LEAST_PERCENT = 97.0
NOT_RUN = {  # a function and its line, or all of a function: why no trace runs it
    "correct: pitch, roll = x[PITCH], x[ROLL]": "Suh's filters as printed are the experiments' alone",
    "correct: by_pitch, expected = 0.0, (cp * pitch, cr * cp * roll)": "as above",
    "evaluate_axis: return False": "seen in no simulation: noise so coloured ends the rest before a block is full",
    "median_bin: return first": "the loop before it always returns; the compiler wants a result",
    "estimate_drift: return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0": "guards a division: fixes inform on both axes",
    "propagate_to: return": "guards a division: the ring takes newer samples only",
    "process_sample: return": "guards a division: as above",
    "solve_heading: return unknown": "seen in no simulation: motion that only the receiver shows",
    "monitor_heading: realign(p, c)": "seen in no simulation: it is surer than its velocity pairs",
}
NO_SOURCE = "needs a measurement beside fixes, which the pipeline does not bring yet"
NOT_RUN |= dict.fromkeys(
    ("fuse_heading", "sigma_of", "fuse_source", "fuse_stored", "fuse_from", "insert_measurement", "first_fix_after"),
    NO_SOURCE,
)
NOT_RUN["rewind_to"] = NO_SOURCE


@dataclass(frozen=True, order=True)
class Line:
    """A line of a kernel; path: below imud/estimators."""

    path: str
    number: int
    function: str
    text: str


@functools.cache
def functions_of(path):
    """Line number to the name of the function, for all lines of the functions in a file."""
    nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)]
    return {number: node.name for node in nodes for number in range(node.lineno, node.end_lineno + 1)}


def line_of(path, number):
    text = path.read_text().splitlines()[number - 1].partition("  # ")[0].strip()
    return Line(path.relative_to(FOLDER).as_posix(), number, functions_of(path)[number], text)


def counts(names=tuple(CLASSES)):
    """How often each line was run by these golden traces. Raises CannotBuildError where gcc or gcov is missing."""
    if shutil.which("gcc") is None or shutil.which("gcov") is None:
        raise build.CannotBuildError("lines are counted by gcc and gcov")
    with tempfile.TemporaryDirectory() as folder:
        source, made = Path(folder, "kernels.c"), Path(folder, "kernels.so")
        source.write_text(translated(Translation(with_lines=True)).source + DUMP)
        build.compile_c(source, made, ("--coverage", "-O0"))  # optimised, lines would be merged
        library = ctypes.CDLL(str(made))
        for name in names:
            run(recording(name), partial(to_c, loaded=library))
        library.write_counts()
        command = ["gcov", "--json-format", "--stdout", str(next(Path(folder).glob("*.gcda")))]
        said = json.loads(subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout)
    counted = Counter()
    for file in said["files"]:
        path = Path(file["file"])
        for line in file["lines"] if path.is_relative_to(FOLDER) else ():
            counted[line_of(path, line["line_number"])] += line["count"]
    return counted


def percent(counted):
    return 100.0 * sum(n > 0 for n in counted.values()) / len(counted)


def unexplained(counted):
    """Lines that no trace runs, and of which NOT_RUN does not say why."""
    return [line for line, n in sorted(counted.items()) if n == 0 and reason(line) is None]


def reason(line):
    return NOT_RUN.get(f"{line.function}: {line.text}") or NOT_RUN.get(line.function)


def report(counted):
    """The share of each file, and each line that no trace runs."""
    files = defaultdict(list)
    for line, n in sorted(counted.items()):
        files[line.path].append((line, n))
    rows = []
    for path, lines in files.items():
        missed = [line for line, n in lines if n == 0]
        rows.append(f"{100.0 * (1.0 - len(missed) / len(lines)):5.1f} %  {len(lines):4d} lines  {path}")
        rows += [f"        {line.number:4d} {line.function}: {line.text} ({reason(line)})" for line in missed]
    return rows


if __name__ == "__main__":
    counted = counts()
    print("\n".join(report(counted)))
    print(f"{percent(counted):.1f} % of {len(counted)} lines")
