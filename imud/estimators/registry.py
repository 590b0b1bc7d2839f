"""Which estimators there are. A new one is a module with an `ESTIMATOR` and a line here, imported when asked for."""

import importlib

from imud.errors import UsageError

from . import Estimator

NAMES = ("attitude", "navigation", "tilt")


def by_name(name: str) -> Estimator:
    """The estimator called `name`. Raises UsageError naming those there are."""
    if name not in NAMES:
        raise UsageError(f"no estimator is called {name!r}; there are {', '.join(NAMES)}")
    estimator = importlib.import_module(f"{__package__}.{name}").ESTIMATOR
    assert isinstance(estimator, Estimator)
    return estimator
