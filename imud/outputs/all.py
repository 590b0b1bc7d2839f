"""All outputs together: opened by the settings, and the time when the next view is due."""

import contextlib
from collections.abc import Callable, Mapping
from typing import TypeVar

from imud.drivers.fix import Fix

from ..configuration.settings import Chrony, Settings
from ..process.contained import ContainedErrors
from ..process.log import get_logger
from .binary import BinaryOutputs
from .chrony import ChronyOutput
from .gpsd import GpsdServer
from .listeners import Poller
from .nmea import NmeaOutput
from .plugin import Output, opened
from .view import View

_Output = TypeVar("_Output", GpsdServer, NmeaOutput, BinaryOutputs, ChronyOutput, Output)


class Outputs:
    """Opened at once, closed at once. Never blocks; not thread-safe."""

    def __init__(
        self,
        settings: Settings,
        poller: Poller,
        batch: int,
        queries: Mapping[str, Callable[[], str]],
        commands: Mapping[str, Callable[[bytes], str]],
        errors: ContainedErrors | None = None,
    ) -> None:
        """Open for at most `batch` solutions at a time; queries, commands: see ExtensionRequests. Raises ImudError."""
        self._errors = errors or ContainedErrors()
        with contextlib.ExitStack() as stack:

            def closing(output: _Output) -> _Output:
                return stack.enter_context(contextlib.closing(output))

            self.gpsd = closing(GpsdServer(settings.gpsd, poller, queries, commands, self._errors))
            self.binary = closing(BinaryOutputs(settings, poller, batch))
            self._chrony = closing(_open_chrony(settings.chrony)) if settings.chrony.shm_unit >= 0 else None
            self._view_outputs: tuple[Output, ...] = (
                self.gpsd,
                closing(NmeaOutput(settings.nmea)),
                *(closing(opened(name)) for name in settings.outputs),
            )
            self._opened = stack.pop_all()

    def configure(self, settings: Settings) -> None:
        """Apply the hot keys of new settings."""
        self.gpsd.settings = settings.gpsd

    def on_event(self, fd: int, mask: int, now_ns: int) -> None:
        """Handle a poll event of a descriptor that may belong to an output."""
        if fd in self.gpsd:
            self.gpsd.on_event(fd, mask, now_ns)
        elif fd in self.binary.stream:
            try:
                self.binary.stream.on_event(fd)
            except Exception as error:
                self._errors.report("the connection of a stream client", error)
                self.binary.stream.disconnect(fd)

    def publish_fix(self, fix: Fix, latency_s: float) -> None:
        """Publish the time of a fix; its epoch is `latency_s` before its arrival."""
        if self._chrony is not None:
            self._chrony.publish(fix, latency_s)

    @property
    def due_ns(self) -> int:
        """When the next view is due."""
        return min(output.due_ns for output in self._view_outputs)

    def publish(self, make: Callable[[], View], now_ns: int) -> None:
        """Publish the view that `make` returns to the outputs that are due; `make` is called only if one is due."""
        due = [output for output in self._view_outputs if now_ns >= output.due_ns]
        if due:
            view = make()
            for output in due:
                try:
                    output.publish(view, now_ns)
                except Exception as error:
                    self._errors.report(f"a message of {type(output).__name__}", error)

    def tick(self, now_ns: int) -> None:
        """Call several times per second: disconnects clients that timed out."""
        with self._errors.contain("the check of the gpsd clients"):
            self.gpsd.tick(now_ns)
        with self._errors.contain("the check of the stream clients"):
            self.binary.tick(now_ns)

    def close(self) -> None:
        self._opened.close()


def _open_chrony(settings: Chrony) -> ChronyOutput:
    chrony = ChronyOutput(settings.shm_unit, int(settings.shm_mode, 8))
    if chrony.is_open_to_all:
        get_logger().warning(
            f"chrony: the segment of unit {settings.shm_unit} was there already, and every user of this machine may "
            "write to it and set the clock: `refclock SHM ...:perm=0660` in chrony.conf"
        )
    return chrony
