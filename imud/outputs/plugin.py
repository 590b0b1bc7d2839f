"""Outputs of other packages: entry points of the group `imud.outputs`."""

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
        """Publish the view."""

    def close(self) -> None:
        """The daemon ends."""


def opened(name: str) -> Output:
    """The output that the setting `outputs` names, NAME or NAME:ARGUMENT: what the plug-in returns for the argument.

    Raises ConfigError (78) if there is no such plug-in or it does not take the argument (ValueError), and
    CannotCreateError (73) for its OSError.
    """
    plugin, _, argument = name.partition(":")
    known = plugins("imud.outputs")
    if plugin not in known:
        there = ", ".join(known) or "none: no installed package brings one"
        raise ConfigError(f"outputs: there is no plug-in {plugin!r}; there are {there}")
    try:
        output: Output = known[plugin](argument)
    except ValueError as error:
        raise ConfigError(f"outputs: {name}: {error}") from error
    except OSError as error:
        raise CannotCreateError(f"outputs: {name}: {error}") from error
    return output
