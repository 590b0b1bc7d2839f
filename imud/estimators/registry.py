"""Which estimators there are. A new one is a module and a line here; it is imported when asked for."""

import importlib

from imud.errors import UsageError

from . import Estimator

# what the user calls it: the module, and the estimator in it
_WHERE = {
    "attitude": ("ahrs", "ESTIMATOR"),
    "navigation": ("ins", "ESTIMATOR"),
    "tilt": ("tilt", "ESTIMATOR"),
    "stationary": ("papers.stationary", "ESTIMATOR"),
    "suh-standard": ("papers.suh", "SUH_STANDARD"),
    "suh-adaptive": ("papers.suh", "SUH_ADAPTIVE"),
    "suh-two-step": ("papers.suh", "SUH_TWO_STEP"),
    "gps-track": ("papers.gps_track", "ESTIMATOR"),
    "ins9": ("papers.ins9", "ESTIMATOR"),
}
NAMES = tuple(_WHERE)


def by_name(name: str) -> Estimator:
    """The estimator called `name`. Raises UsageError naming those there are."""
    if name not in _WHERE:
        raise UsageError(f"no estimator is called {name!r}; there are {', '.join(NAMES)}")
    module, attribute = _WHERE[name]
    estimator = getattr(importlib.import_module(f"{__package__}.{module}"), attribute)
    assert isinstance(estimator, Estimator)
    return estimator
