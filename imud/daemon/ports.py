"""One port, from absent to streaming and back again: the state machine of `port_states.py`, which never waits.

A port that is not there is looked for twice a second; one without a usable device, and a server on the network, is
tried again at growing intervals. Every change is logged once. What the bytes of a device that streams mean is not known
here.
"""

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from imud.drivers.detect import search
from imud.drivers.dialogue import Dialogue
from imud.drivers.driver import AnyDriver, GnssConfigured, Identity, ImuConfigured, Options, Request, Unsupported
from imud.drivers.errors import (
    NotSerialError,
    PortAbsentError,
    PortBusyError,
    PortDeniedError,
    PortError,
    PortLostError,
    PortSupportError,
)
from imud.drivers.findings import Finding, UnrecognisedData
from imud.drivers.registry import by_name
from imud.drivers.transport.dialogue_runner import DialogueRunner
from imud.drivers.transport.line import KnownDevice, Line, check_port, open_line
from imud.drivers.transport.portspec import PortSpec

from ..errors import DeviceAbsentError, ImudError, InputOutputError, PermissionDeniedError
from ..process.log import get_logger
from .port_states import PortEvent, PortState, next_state

Configured = ImuConfigured | GnssConfigured

_FIRST_RETRY_S, _LAST_RETRY_S = 0.25, 4.0
_ABSENT_RETRY_S = 0.5  # does not grow: with a loose plug a long interval may miss every moment of contact
_UNTRIED = "not tried yet"
# not later: another program may close the port, or udev set its permissions
_FATAL_AT_START: dict[type[PortError], type[ImudError]] = {
    PortDeniedError: PermissionDeniedError,
    PortBusyError: InputOutputError,
    NotSerialError: InputOutputError,
    PortSupportError: DeviceAbsentError,
}


def failure(error: PortError) -> ImudError:
    """The exception for a command that does not wait for a port."""
    absent = isinstance(error, PortAbsentError)
    kind = _FATAL_AT_START.get(type(error), DeviceAbsentError if absent else InputOutputError)
    return kind(str(error))


class PortOwner(Protocol):
    """Owns the ports and polls their descriptors; is notified when a device begins, fails or ceases to stream."""

    def watch(self, port: "Port", fd: int) -> None: ...
    def unwatch(self, fd: int) -> None: ...
    def connected(self, port: "Port", driver: AnyDriver, configured: Configured) -> None: ...
    def not_connected(self, port: "Port") -> None: ...
    def disconnected(self, port: "Port") -> None: ...


class Port:
    """A port and what is known of the device on it."""

    def __init__(self, spec: PortSpec, options: Options, owner: PortOwner, wait: bool) -> None:
        """wait: for a device that is absent at the start."""
        self.spec, self.options = spec, options
        self.state = PortState.WAITING
        self.configured: Configured | None = None
        self.deadline_s = 0.0  # when `on_time` is to be called
        self.description = self._logged = _UNTRIED  # of the state, in words
        self.connects = 0
        self.has_failed = False  # an attempt or a connection here
        self._owner, self._wait = owner, wait
        self._log = get_logger().bind(port=spec.path)
        self._line: Line | None = None
        self._dialogue: DialogueRunner[Any] | None = None
        self._line_warning = ""
        self._is_patient = True  # has not listened longer since it was plugged in
        self._last_baud = 0  # at which a device was found here; 0: none yet
        self._on_result: Callable[[Any], None] = lambda result: None
        self._retry_s = _FIRST_RETRY_S

    def check(self) -> None:
        """Check that the port is there, before anything that takes long. Raises ImudError as `on_time`."""
        try:
            check_port(self.spec)
        except PortError as error:
            if type(error) in _FATAL_AT_START or not self._wait:
                raise failure(error) from error

    @property
    def is_undecided(self) -> bool:
        """Whether it is not known yet, or being found out, which device is there."""
        return self.description == _UNTRIED or self.state in (PortState.PROBING, PortState.CONFIGURING)

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
        """Do what is due: open the port, end the wait for an answer, request a sample."""
        if now_s < self.deadline_s:
            return
        if self._line is None:
            self._open()
        elif self._dialogue is not None:
            self._advance(self._dialogue.on_deadline)
        elif isinstance(self.configured, ImuConfigured) and self.configured.request is not None:
            self._request_sample(self.configured.request, now_s)

    def on_event(self) -> None:
        """Give the dialogue the bytes that have come. The owner reads a port that streams."""
        if self._dialogue is not None:
            self._advance(self._dialogue.on_readable)

    def forward(self, data: bytes) -> int:
        """Write data of another source, as corrections, to the device that streams; returns how many bytes it took."""
        if self._line is None or self.options.readonly or self.spec.server is not None:
            return 0
        try:
            return self._line.write(data)
        except PortLostError as error:
            self.lost(str(error))
            return 0

    def log_line_warning(self) -> None:
        """Log the line's warning, once."""
        warning = self._line.warning if self._line else ""
        if warning and warning != self._line_warning:
            self._log.warning(warning)
        self._line_warning = warning

    def lost(self, why: str) -> None:
        """The stream ended: close, and begin again."""
        self._close(PortEvent.LOST)
        self._retry_s = _FIRST_RETRY_S
        self._schedule_attempt(why, warn=True)

    def release(self, why: str) -> None:
        """Close the device, which is not wanted, until `schedule_retry`."""
        self._close(PortEvent.RELEASED)
        self.deadline_s = math.inf
        self._describe(why, warn=True)

    def schedule_retry(self, at_s: float) -> None:
        """Try a closed port again at that time; infinite: never."""
        if self._line is None:
            self.deadline_s = at_s

    def notice_absence(self) -> None:
        """Of a released device: if it was unplugged, look for what is plugged in next. Call it now and then."""
        if self.state is PortState.RELEASED and self.spec.server is None:
            try:
                check_port(self.spec)
            except PortAbsentError:
                self.schedule_retry(0.0)
            except PortError:
                pass

    def reject(self, why: str) -> None:
        """Close an unsuitable device, and try again later: another may be there then."""
        self._close(PortEvent.FAILED)
        self._retry_s = _LAST_RETRY_S
        self._schedule_attempt(why, warn=True)

    def close(self) -> None:
        """Close the device; the port is not used any more."""
        if self._line is not None:
            self._close(PortEvent.LOST)

    def _open(self) -> None:
        try:
            self._line = open_line(self.spec)
        except PortError as error:
            fatal = _FATAL_AT_START.get(type(error))
            if fatal and self.description == _UNTRIED:
                raise fatal(str(error)) from error
            self._fail(str(error))
            if isinstance(error, PortAbsentError) and self.spec.server is None:
                self.deadline_s = time.monotonic() + _ABSENT_RETRY_S
                self._retry_s, self._is_patient = _FIRST_RETRY_S, True
            return
        self._enter(PortEvent.OPENED)
        self._owner.watch(self, self._line.fd)
        if isinstance(self._line, KnownDevice):
            self._enter(PortEvent.IDENTIFIED)
            self._on_configured(by_name(self._line.configured.identity.driver), self._line.configured)
            return
        if self.description == _UNTRIED:
            self._describe("looking for a device")
        dialogue = search(self.spec, self.options.readonly, self._last_baud, self._is_patient)
        self._run_dialogue(dialogue, self._on_identified)

    def _enter(self, event: PortEvent) -> None:
        self.state = next_state(self.state, event)

    def _run_dialogue(self, dialogue: Dialogue[Any], on_result: Callable[[Any], None]) -> None:
        assert self._line is not None
        self._on_result = on_result
        self._dialogue = DialogueRunner(self._line, dialogue)
        self._advance(self._dialogue.start)

    def _advance(self, act: Callable[[], None]) -> None:
        """Continue the dialogue; a lost line ends it, the result of a finished one is handled."""
        runner = self._dialogue
        assert runner is not None
        try:
            act()
        except PortError as error:
            self._fail(str(error))
            return
        self.deadline_s = runner.deadline_s
        if runner.finished:
            self._dialogue = None
            self._on_result(runner.result)

    def _on_identified(self, found: Identity | Unsupported | Finding) -> None:
        if isinstance(found, UnrecognisedData) and found.is_sparse:
            self._is_patient = False
        if not isinstance(found, Identity):
            self._fail(str(found), found.summary if isinstance(found, UnrecognisedData) else "")
            return
        driver = by_name(found.driver)
        self._enter(PortEvent.IDENTIFIED)
        self._run_dialogue(driver.configure(found, self.options), lambda result: self._on_configured(driver, result))

    def _on_configured(self, driver: AnyDriver, configured: Configured | Unsupported | None) -> None:
        if configured is None:
            hint = " by itself, and its port is readonly" if self.options.readonly else ""
            self._fail(f"found a device of the driver {driver.name}, but it does not start to stream{hint}")
            return
        if isinstance(configured, Unsupported):
            self._fail(str(configured))
            return
        self._enter(PortEvent.CONFIGURED)
        self.configured = configured
        self._last_baud = configured.identity.baud
        self.connects += 1
        self._retry_s, self._is_patient = _FIRST_RETRY_S, True
        polled = isinstance(configured, ImuConfigured) and configured.request is not None
        self.deadline_s = time.monotonic() if polled else math.inf
        for warning in configured.warnings:
            self._log.warning(warning)
        if driver.kind == "imu" and self.options.polled and not (polled or configured.identity.spi):
            self._log.warning("this sensor cannot be polled: it sends its samples by itself")
        self._owner.connected(self, driver, configured)
        if self.state is PortState.STREAMING:
            self.description = self._logged = "streaming"

    def _request_sample(self, request: Request, now_s: float) -> None:
        """Request a sample. The times of requests are fixed from the start; those missed are skipped."""
        assert self._line is not None
        period_s = request.period_ns * 1e-9
        self.deadline_s += period_s * (1 + math.floor((now_s - self.deadline_s) / period_s))
        try:
            self._line.write(request.command)
        except PortError as error:
            self.lost(str(error))

    def _fail(self, why: str, same_as: str = "") -> None:
        """End an attempt that has not made a device stream."""
        self._close(PortEvent.FAILED)
        if not self._wait and not self.connects:
            raise DeviceAbsentError(why)
        self._schedule_attempt(why, same_as=same_as)
        self._owner.not_connected(self)

    def _schedule_attempt(self, why: str, warn: bool = False, same_as: str = "") -> None:
        self.has_failed = True
        self._describe(f"{why}; trying again", warn, same_as)
        self.deadline_s = time.monotonic() + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, _LAST_RETRY_S)

    def _describe(self, description: str, warn: bool = False, same_as: str = "") -> None:
        """Log a change, once. same_as: what two descriptions have in common that count as one; default: all of it."""
        before, self.description, self._logged = self._logged, description, same_as or description
        if self._logged != before:
            (self._log.warning if warn else self._log.info)(description)

    def _close(self, event: PortEvent) -> None:
        self._enter(event)
        self._dialogue = None
        if self._line is not None:
            self._owner.unwatch(self._line.fd)
            self._line.close()
            self._line = None
        if self.configured is not None:
            self.configured = None
            self._owner.disconnected(self)
