"""All outputs together: who gets what, and when it is worth making. The settings say which of them exist."""

import contextlib
from collections.abc import Callable, Mapping

from drivers.fix import Fix
from imud.configuration.settings import Settings
from imud.process.contained import ContainedErrors

from .binary import BinaryOutputs
from .chrony import ChronyOutput
from .door import Poller
from .gpsd import GpsdServer
from .nmea import NmeaOutput
from .view import View


class Outputs:
    """Opened at once, closed at once. Never blocks; not thread-safe."""

    def __init__(
        self,
        settings: Settings,
        poller: Poller,
        batch: int,
        own: Mapping[str, Callable[[], str]],
        orders: Mapping[str, Callable[[bytes], str]],
        errors: ContainedErrors | None = None,
    ) -> None:
        """Open for at most `batch` solutions at a time; own, orders: see GpsdServer. Raises ImudError."""
        self._errors = errors or ContainedErrors()
        with contextlib.ExitStack() as stack:
            self.gpsd = stack.enter_context(
                contextlib.closing(GpsdServer(settings.gpsd, poller, own, orders, self._errors))
            )
            nmea = stack.enter_context(contextlib.closing(NmeaOutput(settings.nmea)))
            self.binary = stack.enter_context(contextlib.closing(BinaryOutputs(settings, poller, batch)))
            self._chrony = None
            if settings.chrony.shm_unit >= 0:
                chrony = ChronyOutput(settings.chrony.shm_unit, int(settings.chrony.shm_mode, 8))
                self._chrony = stack.enter_context(contextlib.closing(chrony))
            self._viewers = (self.gpsd, nmea)
            self._opened = stack.pop_all()

    def configure(self, settings: Settings) -> None:
        """Take over the hot keys of new settings."""
        self.gpsd.settings = settings.gpsd

    def on_event(self, fd: int, mask: int, now_ns: int) -> None:
        """Handle what poll said of a descriptor that may be one of ours."""
        if fd in self.gpsd:
            self.gpsd.on_event(fd, mask, now_ns)
        elif fd in self.binary.stream:
            try:
                self.binary.stream.on_event(fd)
            except Exception as error:
                self._errors.report("the connection of a stream client", error)
                self.binary.stream.disconnect(fd)

    def fixed(self, fix: Fix, latency_s: float) -> None:
        """Give the time of a fix that was taken `latency_s` before it came."""
        if self._chrony is not None:
            self._chrony.publish(fix, latency_s)

    @property
    def due_ns(self) -> int:
        """When the next view is worth making."""
        return min(viewer.due_ns for viewer in self._viewers)

    def show(self, make: Callable[[], View], now_ns: int) -> None:
        """Give the view that `make` makes to those whose message is due; without any, `make` is not called."""
        due = [viewer for viewer in self._viewers if now_ns >= viewer.due_ns]
        if due:
            view = make()
            for viewer in due:
                try:
                    viewer.publish(view, now_ns)
                except Exception as error:
                    self._errors.report(f"a message of {type(viewer).__name__}", error)

    def look_after(self, now_ns: int) -> None:
        """Call now and then: cuts off clients that are stuck."""
        with self._errors.contain("a look at the gpsd clients"):
            if (deadline := self.gpsd.next_deadline()) is not None and now_ns >= deadline:
                self.gpsd.tick(now_ns)
        with self._errors.contain("a look at the stream clients"):
            self.binary.look_after(now_ns)

    def close(self) -> None:
        self._opened.close()
