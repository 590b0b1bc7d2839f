"""The estimators' kernels as one C library, which compiles in seconds: the golden traces run on it.

The library is kept in the cache directory under a digest of all sources that it is made from.
"""

import ctypes
import functools
import hashlib
import os
import subprocess
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from drivers.sample import SAMPLE
from imud.commands.bench import reference
from imud.configuration.settings import Initial, Settings
from imud.estimators import registry
from imud.estimators.records import FIX, INNOVATION, SOLUTION
from imud.pipeline import Filter
from imud.process import runtime
from imud.sensor_errors.calibration import CORRECTION
from imud.sensors.health import HEALTH

# no fused multiplication and addition: the same rounding on every machine
FLAGS = ("-std=gnu11", "-O2", "-w", "-fPIC", "-shared", "-ffp-contract=off", "-fno-math-errno", "-Wl,-Bsymbolic")
TRANSLATOR = reference.SOURCES


def symbol(part, name):
    return f"{part}_{name.replace('-', '_')}"


def translated(unit, names=registry.NAMES):
    """Add the entries `feed` and `told` of these estimators to a translation unit."""
    for name in names:
        filter_ = Filter(registry.by_name(name), Settings(), Initial(), 100.0)
        p, s = filter_.parameters.dtype, filter_.state.dtype
        feed = (HEALTH, SAMPLE, CORRECTION, p, s, SOLUTION, FIX, np.int64, INNOVATION)
        for part, kinds in (("feed", feed), ("told", (s, INNOVATION))):
            kernel = getattr(filter_.stages, part)
            unit.function(kernel, [unit.array(kind) for kind in kinds], exported=symbol(part, name))
    return unit


def digest():
    """Of the kernels, the translator and this file."""
    whole = hashlib.sha256(runtime.source_digest().encode())
    for path in (*sorted(TRANSLATOR.glob("*.py")), Path(__file__)):
        whole.update(path.read_bytes())
    return whole.hexdigest()[:16]


def compile_c(text, output, flags=FLAGS):
    """Write a shared library, all of it or nothing. Raises NoReferenceError where there is no compiler."""
    with tempfile.TemporaryDirectory(dir=output.parent) as folder:
        source, made = Path(folder, "kernels.c"), Path(folder, "kernels.so")
        source.write_text(text)
        subprocess.run([reference.compiler(), *flags, "-o", str(made), str(source), "-lm"], check=True)
        made.replace(output)


@functools.cache
def library():
    """The loaded library of all estimators; compiled if the cache does not have it."""
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    path = folder / f"estimators-{digest()}.so"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        compile_c(translated(reference.translator().Translation()).source, path)
    return ctypes.CDLL(str(path))


def to_c(filter_, loaded=None):
    """Let a Filter call the C library instead of kernels that numba compiles."""
    loaded = loaded or library()
    for part in ("feed", "told"):
        function = getattr(loaded, symbol(part, filter_.estimator.name))
        setattr(filter_.stages, part, partial(reference.call, function))
    return filter_


def to_c_if_possible(filter_):
    """The same; where there is no compiler it stays with the kernels that numba compiles."""
    try:
        return to_c(filter_)
    except reference.NoReferenceError:
        return filter_
