"""Finds the drivers: every sub-package with a module `driver` that holds a `DRIVER` of its name, and those of plug-ins.

A new sensor is a new folder here, or a package of its own. A driver is imported when it is asked for: all of them, when
a device is to be found, so that a start does not wait for that.
"""

import importlib
import warnings
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from .plugins import plugins

if TYPE_CHECKING:
    from .driver import AnyDriver


@cache
def _folders() -> frozenset[str]:
    """Of the drivers of this package: their names."""
    package = importlib.import_module(__package__)
    return frozenset(file.parent.name for folder in package.__path__ for file in Path(folder).glob("*/driver.py"))


@cache
def plugged_in() -> dict[str, "AnyDriver"]:
    """The drivers of plug-ins, by name; with a warning of one that is a `NativeProtocol` by half, and so none."""
    found = {driver.name: driver for driver in plugins("imud.drivers").values() if driver.name not in _folders()}
    for name, driver in found.items():
        lacks = [one for one in ("also_speaks", "sends_fixes") if not hasattr(driver, one)]
        if len(lacks) == 1:
            warnings.warn(
                f"the driver {name} of a plug-in lacks {lacks[0]}, and so is treated as one whose devices speak one "
                "protocol: it queries every silent line, and the driver of the other protocol may be used for its "
                "devices; add what imud.drivers.driver.NativeProtocol has",
                stacklevel=2,
            )
    return found


@cache
def names() -> tuple[str, ...]:
    """What a user may write as a driver."""
    return tuple(sorted((*_folders(), *plugged_in())))


def by_name(name: str) -> "AnyDriver":
    """The driver called `name`. Raises KeyError with the names there are."""
    if name not in names():
        raise KeyError(f"no driver {name!r}; there are: {', '.join(names())}")
    if name in plugged_in():
        return plugged_in()[name]
    found: AnyDriver = importlib.import_module(f"{__package__}.{name}.driver").DRIVER
    return found


@cache
def drivers() -> tuple["AnyDriver", ...]:
    """All drivers, by name."""
    return tuple(map(by_name, names()))
