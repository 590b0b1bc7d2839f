"""`imud warmup`: compiles everything before the first start needs it, where installing did not, as from a checkout."""

import argparse
import sys

from ..configuration.settings import Settings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--estimator", action="append", metavar="NAME", help="only this one (repeats); default: all")


def run(args: argparse.Namespace) -> int:
    from .. import kernel_calls
    from ..compile import library, numba_cache
    from ..estimators import registry

    if library.library() is not None:
        print(f"all kernels are compiled: {library.current()}")
        return 0
    cache = numba_cache.required()
    estimators = [registry.by_name(name) for name in args.estimator or registry.NAMES]
    kernel_calls.warm_decoders()
    kernel_calls.warm_loop()
    for number, estimator in enumerate(estimators, 1):
        print(f"imud: compiling {number}/{len(estimators)}: {estimator.name}", file=sys.stderr, flush=True)
        kernel_calls.warm(estimator, Settings())
        kernel_calls.warm_replay(estimator, Settings())
    print(f"numba has compiled {len(estimators)} estimators and all drivers: {cache}")
    return 0
