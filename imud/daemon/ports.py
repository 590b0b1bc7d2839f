"""One port, from absent to streaming and back again: a state machine that never waits.

Absent, silent and unknown devices are tried again with growing patience; every change is logged once. A port knows
when a device streams, not what the bytes mean.
"""

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from drivers.detect import search
from drivers.dialogue import Dialogue
from drivers.driver import AnyDriver, GnssConfigured, Identity, ImuConfigured, Options, Request, Unsupported
from drivers.errors import (
    NotSerialError,
    PortAbsentError,
    PortBusyError,
    PortDeniedError,
    PortError,
    PortSupportError,
)
from drivers.findings import Chatter, Finding
from drivers.registry import by_name
from drivers.transport.conversation import Conversation
from drivers.transport.line import Known, Line, look, open_line
from drivers.transport.portspec import PortSpec

from ..errors import DeviceAbsentError, ImudError, InputOutputError, PermissionDeniedError
from ..process.log import get_logger

Configured = ImuConfigured | GnssConfigured

_FIRST_RETRY_S, _LAST_RETRY_S = 0.25, 4.0
_UNTRIED = "not tried yet"
_FATAL: dict[type[PortError], type[ImudError]] = {  # at the start; later the device may be given back, or just appear
    PortDeniedError: PermissionDeniedError,
    PortBusyError: InputOutputError,
    NotSerialError: InputOutputError,
    PortSupportError: DeviceAbsentError,
}


def failure(error: PortError) -> ImudError:
    """The exception for a command that does not wait for a port."""
    absent = isinstance(error, PortAbsentError)
    kind = _FATAL.get(type(error), DeviceAbsentError if absent else InputOutputError)
    return kind(str(error))


class Host(Protocol):
    """Who owns the port: is told of streams, and has the poll object."""

    def watch(self, port: "Port", fd: int) -> None: ...
    def unwatch(self, fd: int) -> None: ...
    def connected(self, port: "Port", driver: AnyDriver, configured: Configured) -> None: ...
    def disconnected(self, port: "Port") -> None: ...


class Port:
    """A port and what is known of the device on it."""

    def __init__(self, spec: PortSpec, options: Options, host: Host, patient: bool) -> None:
        self.spec, self.options = spec, options
        self.configured: Configured | None = None
        self.deadline_s = 0.0  # when `on_time` wants to be called
        self.story = self._gist = _UNTRIED
        self.connects = 0
        self._host, self._patient = host, patient
        self._log = get_logger().bind(port=spec.path)
        self._line: Line | None = None
        self._talk: Conversation[Any] | None = None
        self._complaint = ""
        self._last_baud = 0  # at which a device was found here; 0: none yet
        self._then: Callable[[Any], None] = lambda result: None
        self._retry_s = _FIRST_RETRY_S

    def look(self) -> None:
        """See whether the port is there, before anything that takes long. Raises ImudError as `on_time`."""
        try:
            look(self.spec)
        except PortError as error:
            if type(error) in _FATAL or not self._patient:
                raise failure(error) from error

    @property
    def fd(self) -> int:
        """The open descriptor; -1 while there is none."""
        return self._line.fd if self._line else -1

    @property
    def line(self) -> Line:
        """The open line; while it streams."""
        assert self._line is not None
        return self._line

    def on_time(self, now_s: float) -> None:
        """Do what is due: try again, or end a listening."""
        if now_s < self.deadline_s:
            return
        if self._line is None:
            self._open()
        elif self._talk is not None:
            self._guard(self._talk.on_deadline)
        elif isinstance(self.configured, ImuConfigured) and self.configured.request is not None:
            self._ask(self.configured.request, now_s)

    def on_event(self) -> None:
        """Bytes for the dialogue. (A streaming port is read by its owner.)"""
        if self._talk is not None:
            self._guard(self._talk.on_readable)

    def pass_on(self) -> None:
        """Log the line's complaint, once."""
        complaint = self._line.complaint if self._line else ""
        if complaint and complaint != self._complaint:
            self._log.warning(complaint)
        self._complaint = complaint

    def lost(self, why: str) -> None:
        """The stream ended: close, and begin again."""
        self._close()
        self._retry_s = _FIRST_RETRY_S
        self._wait(why, warn=True)

    def retire(self, why: str) -> None:
        """Let go of a device that is not wanted, until `wake`."""
        self._close()
        self.deadline_s = float("inf")
        self._tell(why, warn=True)

    def wake(self, at_s: float) -> None:
        """Try a retired port again at that time; infinite: never."""
        if self._line is None:
            self.deadline_s = at_s

    def refuse(self, why: str) -> None:
        """Let go of an unsuitable device; another may be there later."""
        self._close()
        self._retry_s = _LAST_RETRY_S
        self._wait(why, warn=True)

    def close(self) -> None:
        """Let go of the device."""
        self._close()

    def _open(self) -> None:
        try:
            self._line = open_line(self.spec)
        except PortError as error:
            fatal = _FATAL.get(type(error))
            if fatal and self.story == _UNTRIED:
                raise fatal(str(error)) from error
            self._fail(str(error))
            return
        self._host.watch(self, self._line.fd)
        if isinstance(self._line, Known):
            self._streams(by_name(self._line.configured.identity.driver), self._line.configured)
            return
        if self.story == _UNTRIED:
            self._tell("looking for a device")
        self._converse(search(self.spec, self.options.readonly, self._last_baud), self._detected)

    def _converse(self, dialogue: Dialogue[Any], then: Callable[[Any], None]) -> None:
        assert self._line is not None
        self._then = then
        self._talk = Conversation(self._line, dialogue)
        self._guard(self._talk.start)

    def _guard(self, act: Callable[[], None]) -> None:
        """Let the dialogue go on; a lost line ends it, a finished one leads to the next step."""
        talk = self._talk
        assert talk is not None
        try:
            act()
        except PortError as error:
            self._fail(str(error))
            return
        self.deadline_s = talk.deadline_s
        if talk.finished:
            self._talk = None
            self._then(talk.result)

    def _detected(self, found: Identity | Unsupported | Finding) -> None:
        if not isinstance(found, Identity):
            self._fail(str(found), found.gist if isinstance(found, Chatter) else "")
            return
        driver = by_name(found.driver)
        self._converse(driver.configure(found, self.options), lambda result: self._streams(driver, result))

    def _streams(self, driver: AnyDriver, configured: Configured | Unsupported | None) -> None:
        if configured is None:
            hint = " by itself, and its port is readonly" if self.options.readonly else ""
            self._fail(f"found a device of the driver {driver.name}, but it does not start to stream{hint}")
            return
        if isinstance(configured, Unsupported):
            self._fail(str(configured))
            return
        self.configured = configured
        self._last_baud = configured.identity.baud
        self.connects += 1
        self._retry_s = _FIRST_RETRY_S
        asked = isinstance(configured, ImuConfigured) and configured.request is not None
        self.deadline_s = time.monotonic() if asked else float("inf")
        for warning in configured.warnings:
            self._log.warning(warning)
        if driver.kind == "imu" and self.options.polled and not (asked or configured.identity.spi):
            self._log.warning("this sensor cannot be asked for its samples: it sends them by itself")
        self._host.connected(self, driver, configured)
        if self.configured is not None:
            self.story = self._gist = "streaming"

    def _ask(self, request: Request, now_s: float) -> None:
        """Ask for a sample. The times to ask are fixed from the start; those that a late wake-up missed are skipped."""
        assert self._line is not None
        period_s = request.period_ns * 1e-9
        self.deadline_s += period_s * (1 + math.floor((now_s - self.deadline_s) / period_s))
        try:
            self._line.write(request.command)
        except PortError as error:
            self.lost(str(error))

    def _fail(self, why: str, gist: str = "") -> None:
        """This attempt brought no stream."""
        if not self._patient and not self.connects:
            self._close()
            raise DeviceAbsentError(why)
        self._close()
        self._wait(why, gist=gist)

    def _wait(self, why: str, warn: bool = False, gist: str = "") -> None:
        self._tell(f"{why}; trying again", warn, gist)
        self.deadline_s = time.monotonic() + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, _LAST_RETRY_S)

    def _tell(self, story: str, warn: bool = False, gist: str = "") -> None:
        """Log a change, once. gist: the part that must differ for it to count as one; default: the whole story."""
        before, self.story, self._gist = self._gist, story, gist or story
        if self._gist != before:
            (self._log.warning if warn else self._log.info)(story)

    def _close(self) -> None:
        self._talk = None
        if self._line is not None:
            self._host.unwatch(self._line.fd)
            self._line.close()
            self._line = None
        if self.configured is not None:
            self.configured = None
            self._host.disconnected(self)
