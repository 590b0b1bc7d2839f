"""Which estimators there are. A new one is a line here, as module:object; it is imported when asked for."""

import importlib

from imud.errors import UsageError

from . import Estimator

_PLACES = {
    "attitude": "imud.estimators.attitude:ATTITUDE",
    "navigation": "imud.estimators.navigation:NAVIGATION",
}
NAMES = tuple(_PLACES)


def by_name(name: str) -> Estimator:
    """The estimator called `name`. Raises UsageError naming those there are."""
    if name not in _PLACES:
        raise UsageError(f"no estimator is called {name!r}; there are {', '.join(NAMES)}")
    module, _, attribute = _PLACES[name].partition(":")
    estimator = getattr(importlib.import_module(module), attribute)
    assert isinstance(estimator, Estimator)
    return estimator
