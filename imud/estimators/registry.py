"""Which estimators there are. A new one is a module and a line here, or a plug-in; it is imported when asked for."""

import importlib

from imud.drivers.plugins import plugins

from ..errors import UsageError
from . import Estimator

# what the user calls it: the module, and the estimator in it
_WHERE = {
    "attitude": ("ahrs", "ESTIMATOR"),
    "navigation": ("ins", "ESTIMATOR"),
    "riss": ("riss", "ESTIMATOR"),
    "tilt": ("tilt", "ESTIMATOR"),
    "stationary": ("papers.stationary", "ESTIMATOR"),
    "suh-standard": ("papers.suh", "SUH_STANDARD"),
    "suh-adaptive": ("papers.suh", "SUH_ADAPTIVE"),
    "suh-two-step": ("papers.suh", "SUH_TWO_STEP"),
    "gps-track": ("papers.gps_track", "ESTIMATOR"),
    "ins9": ("papers.ins9", "ESTIMATOR"),
}
NAMES = tuple(_WHERE)  # of ours


def by_name(name: str) -> Estimator:
    """The estimator called `name`. Raises UsageError naming those there are."""
    if name in _WHERE:
        module, attribute = _WHERE[name]
        estimator = getattr(importlib.import_module(f"{__package__}.{module}"), attribute)
    elif name in (others := plugins("imud.estimators")):
        estimator = others[name]
    else:
        raise UsageError(f"no estimator is called {name!r}; there are {', '.join([*NAMES, *others])}")
    assert isinstance(estimator, Estimator)
    return estimator
