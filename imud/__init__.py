"""Inertial sensors on Linux: attitude, velocity and position, as a daemon (`imud --port …`) and as a library.

    import imud
    solution = imud.attitude(t, gyro, accel)

The library is in `imud.api`; its names are imported at their first use, so that commands start at once.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import AttitudeFilter, Innovations, NavigationFilter, Recording, Solution, attitude, navigate, read

__version__ = "0.2.0"
__all__ = [
    "AttitudeFilter",
    "Innovations",
    "NavigationFilter",
    "Recording",
    "Solution",
    "attitude",
    "navigate",
    "read",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'imud' has no attribute {name!r}")
    return getattr(importlib.import_module(".api", __name__), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
