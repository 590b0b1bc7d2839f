"""`imud warmup`: compiles everything before the first start needs it, for installers and builders of disk images."""

import argparse
import os
import sys
from pathlib import Path

from ..configuration.settings import Settings
from ..errors import CannotCreateError
from ..process import runtime


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--estimator", action="append", metavar="NAME", help="only this one (repeats); default: all")


def run(args: argparse.Namespace) -> int:
    from .. import compilation
    from ..estimators import registry

    cache = os.environ.get("NUMBA_CACHE_DIR")
    if cache is None:
        places = " nor ".join(str(path) for path in runtime.candidates())
        raise CannotCreateError(f"neither {places} can be written to: name a directory in NUMBA_CACHE_DIR")
    estimators = [registry.by_name(name) for name in args.estimator or registry.NAMES]
    steps = len(estimators)
    for number, estimator in enumerate(estimators, 1):
        _show(f"{number}/{steps} {estimator.name}")
        compilation.fill(cache, estimator, Settings())
        compilation.warm_replay(estimator, Settings())
    _show("")
    files = [path for path in Path(cache).rglob("*") if path.is_file()]
    size_mb = sum(path.stat().st_size for path in files) * 1e-6
    print(f"{steps} estimators and all drivers are compiled: {cache} ({size_mb:.1f} MB)")
    return 0


def _show(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r  compiling {text:<30}" if text else f"\r{'':42}\r", end="", file=sys.stderr, flush=True)
