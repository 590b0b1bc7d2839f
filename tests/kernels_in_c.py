"""The estimators' kernels as one C library, which compiles in seconds: the golden traces run on it.

The library is kept in the cache directory under a digest of all sources that it is made from.
"""

import ctypes
import functools
import hashlib
import os
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from drivers.sample import SAMPLE
from imud.commands.bench import reference
from imud.compile import build
from imud.compile.c import Translation
from imud.configuration.settings import Initial, Settings
from imud.estimators import registry
from imud.estimators.records import FIX, INNOVATION, SOLUTION
from imud.pipeline import Filter
from imud.process import runtime
from imud.sensor_errors.calibration import CORRECTION
from imud.sensors.health import HEALTH


def symbol(part, name):
    return f"{part}_{name.replace('-', '_')}"


def translated(unit, names=registry.NAMES):
    """Add the entries `feed` and `told` of these estimators to a translation unit."""
    for name in names:
        filter_ = Filter(registry.by_name(name), Settings(), Initial(), 100.0)
        p, s = filter_.parameters.dtype, filter_.state.dtype
        feed = (HEALTH, SAMPLE, CORRECTION, p, s, SOLUTION, FIX, np.int64, INNOVATION)
        for part, kinds in (("feed", feed), ("told", (s, INNOVATION))):
            unit.export(getattr(filter_.stages, part), kinds, symbol(part, name))
    return unit


def digest():
    """Of the kernels and this file."""
    return hashlib.sha256(runtime.source_digest().encode() + Path(__file__).read_bytes()).hexdigest()[:16]


def compile_c(text, output):
    """Write a shared library, all of it or nothing. Raises CannotBuildError where there is no compiler."""
    with tempfile.TemporaryDirectory(dir=output.parent) as folder:
        source, made = Path(folder, "kernels.c"), Path(folder, "kernels.so")
        source.write_text(text)
        build.compile_c(source, made)
        made.replace(output)


@functools.cache
def library():
    """The loaded library of all estimators; compiled if the cache does not have it."""
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    path = folder / f"estimators-{digest()}.so"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        compile_c(translated(Translation()).source, path)
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
    except build.CannotBuildError:
        return filter_
