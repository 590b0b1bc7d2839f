"""Which lines of the estimators' kernels do the golden traces run? `python tests/golden_coverage.py`

All recordings run on a library in which gcc counts the lines, by the `#line` directives of the translation.
"""

import ast
import functools
import json
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path

from golden import CLASSES
from same_bits import digests

import imud.estimators
from imud.compile import build

FOLDER = Path(imud.estimators.__file__).resolve().parent
TESTS = Path(__file__).resolve().parent
LEAST_PERCENT = 97.0
NOT_RUN = {  # a function and its line, or all of a function: why no trace runs it
    "update_measurements: pitch, roll = x[PITCH], x[ROLL]": "Suh's filters as printed are the experiments' alone",
    "update_measurements: by_pitch, expected = 0.0, (cp * pitch, cr * cp * roll)": "as above",
    "adapt_accel_noise: inflation = PRINTED_ALPHA2 * (abs(e) if p.rule == ABSOLUTE else e)": "as above",
    "evaluate_axis: return False": "seen in no simulation: noise so coloured ends the rest before a block is full",
    "median_bin: return first": "the loop before it always returns; the compiler wants a result",
    "estimate_drift: return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0": "guards a division: fixes inform on both axes",
    "estimate_velocity_drift: return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0": "with wheels all report a velocity",
    "count_confirmation: g.confirmations = 0": "no receiver contradicts wheels before the heading is confirmed",
    "solve_heading: return unknown": "seen in no simulation: motion that only the receiver shows",
    "fuse_heading: return 0": "no recording of a compass points straight up",
    "rewind_to: return False": "one of its rings forgets first; the lines of the others are not run",
    "velocity_variance: noise = max(noise, reported * reported)": "no recording reports the sigma of its velocity",
    "fuse_nhc: h.mean_nis = 1.0": "another fault: tests/test_navigation_drift_beside_wheels.py",
    "step_gate: add_forward_variance(c, forward, z * z)": "as above",
    "drift_speed: return 0.0": "no recording has so few contradictions, or contradictions by a wrong heading",
    "add_outage_noise: add_noise(s, c.saturation_noise**2 * w2 * dt, 0.0)": "in all recordings `clipping` adds it",
    "fuse_across": "no recording has vibration so low with such biases: tests/test_navigation_large_biases.py",
    "measure_fixed_gravity": "as above",
    "shift_frame_rates": "as above",
    "share_excess": "as above",
    "inflate_earlier_estimates": "no recording's noise is so far too small: tests/test_navigation_noise_learning.py",
    "forget_time_evidence": "called by it: tests/test_navigation_time_evidence.py",
    "move_innovations: pending.rows[k - n] = pending.rows[k]": "with little room: tests/test_pending_innovations.py",
    "record_transition": "the smoother's: tests/test_smoothing_attitude.py",
    "record_measurement": "as above",
    "record_reset": "as above",
    "record_age": "as above",
    "record_restart": "as above",
    "record_wrong_tilt": "as above",
    "record_hypotheses": "as above",
    "weigh_lever_arm: g.lever_arm_is_measured[i] = 0": "another fault: tests/test_navigation_lever_arm.py",
    "weigh_lever_arm: g.lever_arm_inflation[i] = 0.0": "as above",
    "weigh_lever_arm: continue": "as above",
    "forget_time_offset": "no recording has such a time offset: tests/test_navigation_lost_time_offset.py",
    "monitor_heading: realign(p, c)": "seen in no simulation: it is surer than its velocity pairs",
}


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
    """How often each line was run by these golden traces; the digest of each, as of `same_bits.py`.

    Raises CannotBuildError where gcc or gcov is missing.
    """
    if shutil.which("gcc") is None or shutil.which("gcov") is None:
        raise build.CannotBuildError("lines are counted by gcc and gcov")
    with tempfile.TemporaryDirectory() as folder:
        made = str(Path(folder, "kernels.so"))
        subprocess.run([sys.executable, "-m", "imud.compile", made, "--coverage"], check=True, cwd=TESTS.parent)
        printed = digests(names, IMUD_KERNELS=made)  # the counts are written as the process ends
        command = ["gcov", "--json-format", "--stdout", str(next(Path(folder).glob("*.gcda")))]
        said = json.loads(subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout)
    counted = Counter()
    for file in said["files"]:
        path = Path(file["file"])
        for line in file["lines"] if path.is_relative_to(FOLDER) else ():
            counted[line_of(path, line["line_number"])] += line["count"]
    return counted, dict(zip(printed[1::2], printed[::2], strict=True))


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
    counted, _ = counts()
    print("\n".join(report(counted)))
    print(f"{percent(counted):.1f} % of {len(counted)} lines")
