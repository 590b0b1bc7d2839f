"""The golden traces: what the estimators make of simulated recordings, one for each class of fault, thinned, in git.

    python tests/golden.py                  write all of them anew
    python tests/golden.py NAME..           some of them: a file's name without .csv, or its beginning
    python tests/golden.py --check [NAME..] compare instead, and say from when on which column differs

A change of any number shows in the diff, and is either meant or a bug. The traces hold on other processors too:
the noise is of numpy's frozen generator, and the comparison leaves room for the last bits of sines and of fused
multiplication, nothing more.
"""

import argparse
import csv
import functools
import sys
from pathlib import Path

import golden_aiding  # noqa: F401  each of these lists its recordings
import golden_attitude  # noqa: F401
import golden_attitude_faults  # noqa: F401
import golden_external  # noqa: F401
import golden_gnss  # noqa: F401
import golden_motion  # noqa: F401
import golden_others  # noqa: F401
import golden_samples  # noqa: F401
import golden_starts  # noqa: F401
import numpy as np
from golden_run import GOLDENS, Recording, trace
from simulated import motion, received, sensed

from imud.configuration.settings import Initial
from imud.estimators.registry import NAMES

FOLDER = Path(__file__).with_name("golden")
SECONDS, RATE_HZ = 80.0, 100.0
TOLERANCE = 2e-6  # of a column's largest value
NOTHING = 1e-12  # what rounding makes of a zero
INITIAL = {"ins9": Initial(yaw_deg=86.0), "stationary": Initial(yaw_deg=86.0)}
STILL = ("stationary",)  # on a sensor at rest; the others drive


def usual(name):
    """The recording that every estimator has: of an M-G350 and a receiver, a rest of 5 s, then a drive."""
    rng = np.random.RandomState(7)  # its stream never changes (NEP 19)
    m = motion("rest" if name in STILL else "car", SECONDS, RATE_HZ)
    samples, _ = sensed(m, rng)
    return Recording(name, samples, received(m, rng), initial=INITIAL.get(name, Initial()), rows=20)


# name: what makes the recording
CLASSES = {name: functools.partial(usual, name) for name in NAMES} | GOLDENS


@functools.cache
def recording(name):
    """The recording of this name; treat it as constant."""
    return CLASSES[name]()


def traced(name, changed=lambda original: original, **how):
    """The trace of a recording as it is, or `changed`."""
    return trace(changed(recording(name)), **how)


def write(name, table):
    with (FOLDER / f"{name}.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        for row in zip(*table.values(), strict=True):
            writer.writerow([f"{value:.{digits(column)}g}" for column, value in zip(table, row, strict=True)])


def digits(column):
    """Significant ones: places on the earth need more, 0.1 m and better."""
    return 11 if column in ("lat_deg", "lon_deg") else 7


def read(name):
    with (FOLDER / f"{name}.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    values = np.array(rows, dtype=float)
    return {column: values[:, i] for i, column in enumerate(head)}


def differences(wanted, got):
    """What differs, in words: column, first row, by how much."""
    if list(wanted) != list(got):
        return [f"columns {sorted(set(wanted) ^ set(got))} or their order"]
    said = []
    for name, old in wanted.items():
        new = got[name]
        room = TOLERANCE * np.nanmax(np.abs(old)) + NOTHING
        if name in ("lat_deg", "lon_deg"):
            room = TOLERANCE * np.nanmax(np.abs(old - old[-1])) + 1e-9
        bad = np.flatnonzero(~((np.abs(new - old) <= room) | (np.isnan(new) & np.isnan(old))))
        if len(bad):
            k = bad[0]
            said.append(f"{name} from {wanted['t_s'][k]:g} s on: {old[k]:.9g}, now {new[k]:.9g}")
    return said


def check(names):
    """Print what differs; returns how many traces do."""
    wrong = 0
    for name in names:
        said = differences(read(name), traced(name))
        wrong += bool(said)
        for text in said:
            print(f"{name}: {text}")
    print(f"{len(names) - wrong} of {len(names)} golden traces are as they were")
    return wrong


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument("names", nargs="*", metavar="NAME", help="a trace, or the beginning of several; default: all")
    args = parser.parse_args()
    names = [name for name in CLASSES if not args.names or name.startswith(tuple(args.names))]
    if not names:
        parser.error(f"no such trace; there are {', '.join(CLASSES)}")
    if args.check:
        sys.exit(check(names) > 0)
    FOLDER.mkdir(exist_ok=True)
    for name in names:
        write(name, traced(name))
        print(FOLDER / f"{name}.csv")


if __name__ == "__main__":
    main()
