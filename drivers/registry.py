"""Finds the drivers: every sub-package with a module `driver` that holds a `DRIVER`, and those of plug-ins.

A new sensor is a new folder here, or a package of its own.
"""

import importlib
from functools import cache
from pathlib import Path

from .driver import AnyDriver
from .plugins import plugins


@cache
def drivers() -> tuple[AnyDriver, ...]:
    """All drivers, by name."""
    package = importlib.import_module(__package__)
    folders = {file.parent.name for folder in package.__path__ for file in Path(folder).glob("*/driver.py")}
    found = [importlib.import_module(f"{__package__}.{folder}.driver").DRIVER for folder in sorted(folders)]
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
