"""Outputs of other packages: entry points of the group `imud.outputs`."""

from collections.abc import Callable
from typing import Protocol

from imud.drivers.plugins import plugins

from ..errors import CannotCreateError, ConfigError
from .view import View


class Output(Protocol):
    """The interface. An output must never block; an exception is logged, and ends that message only."""

    @property
    def due_ns(self) -> int:
        """Monotonic time when it wants the next view."""

    def publish(self, view: View, now_ns: int) -> None:
        """Publish the view. Before anything streams it has no solution: status 0, NaN."""

    def close(self) -> None:
        """The daemon ends."""


def installed(name: str) -> Callable[[str], Output]:
    """What makes the output that the setting `outputs` names, NAME or NAME:ARGUMENT. Raises ConfigError (78)."""
    plugin = name.partition(":")[0]
    known = plugins("imud.outputs")
    if plugin not in known:
        there = ", ".join(known) or "none: no installed package brings one"
        raise ConfigError(f"outputs: there is no plug-in {plugin!r}; there are {there}")
    make: Callable[[str], Output] = known[plugin]
    return make


def opened(name: str) -> Output:
    """What the plug-in of `installed` returns for the argument.

    Raises ConfigError (78) also if it does not take the argument (ValueError), and CannotCreateError (73) for its
    OSError.
    """
    make = installed(name)
    try:
        output = make(name.partition(":")[2])
    except ValueError as error:
        raise ConfigError(f"outputs: {name}: {error}") from error
    except OSError as error:
        raise CannotCreateError(f"outputs: {name}: {error}") from error
    return output
