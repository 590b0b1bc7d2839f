"""Finds the drivers: every sub-package with a module `driver` that holds a `DRIVER`, and those of plug-ins.

A new sensor is a new folder here, or a package of its own.
"""

import importlib
import importlib.util
import pkgutil
from functools import cache

from .driver import AnyDriver
from .plugins import plugins


@cache
def drivers() -> tuple[AnyDriver, ...]:
    """All drivers, by name."""
    package = importlib.import_module(__package__)
    found = []
    for folder in pkgutil.iter_modules(package.__path__, f"{__package__}."):
        module = f"{folder.name}.driver"
        if folder.ispkg and importlib.util.find_spec(module):
            found.append(importlib.import_module(module).DRIVER)
    own = {driver.name for driver in found}
    found += [driver for driver in plugins("imud.drivers").values() if driver.name not in own]
    return tuple(sorted(found, key=lambda driver: str(driver.name)))


def is_ours(driver: AnyDriver) -> bool:
    """Whether it is one of this package, and no plug-in's."""
    return type(driver).__module__.startswith(f"{__package__}.")


def names() -> tuple[str, ...]:
    """What a user may write as a driver."""
    return tuple(driver.name for driver in drivers())


def by_name(name: str) -> AnyDriver:
    """The driver called `name`. Raises KeyError with the names there are."""
    for driver in drivers():
        if driver.name == name:
            return driver
    raise KeyError(f"no driver {name!r}; there are: {', '.join(names())}")
