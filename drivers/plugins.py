"""Plug-ins: what other packages add to imud, found by the entry points that they declare.

    [project.entry-points."imud.drivers"]
    example = "imud_example.driver:DRIVER"

The groups are `imud.drivers`, `imud.estimators` and `imud.outputs`; `docs/plugin` is a package with one of each. Where
no installed package declares any, the search reads each package's list of entry points, and no more.
"""

import contextlib
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import Any


@cache
def _declares_any() -> bool:
    """Whether an installed package declares a plug-in: importlib.metadata takes 7 MB, and far longer, for that."""
    for path in (path for folder in sys.path for path in Path(folder).glob("*-info/entry_points.txt")):
        with contextlib.suppress(OSError):  # another user's, or just being removed
            if b"[imud." in path.read_bytes():
                return True
    return False


@cache
def plugins(group: str) -> dict[str, Any]:
    """The plug-ins of a group: their objects, by name. One that cannot be imported is left out, with a warning.

    >>> plugins("imud.nothing")
    {}
    """
    found: dict[str, Any] = {}
    if _declares_any():
        from importlib.metadata import entry_points

        for point in entry_points(group=group):
            try:
                found[point.name] = point.load()
            except Exception as error:  # another package's code
                warnings.warn(f"the plug-in {point.name} ({point.value}) is left out: {error!r}", stacklevel=2)
    return found
