"""A server for gpsd's clients inside the daemon's event loop: it never waits, and starts no thread.

The loop polls; for each descriptor that is `in` the server it calls `on_event`, when a view is due `publish`, and
several times per second `tick`. All times are monotonic nanoseconds, one for all events of a wake-up: the
work of one wake-up is limited by it, so that a flood of connections or requests delays the sensors by little and is
served in the following ones. A slow, stalled or hostile client loses its own messages.
"""

import contextlib
import select
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ..configuration.settings import Gpsd
from ..process.contained import ContainedErrors
from .addresses import addresses_of
from .connection import NEVER_NS, SECOND_NS, Connection
from .gpsd_dialogue import (
    NOT_HTTP,
    Answer,
    Policy,
    Request,
    answer,
    device_object,
    error_object,
    version_object,
)
from .gpsd_extensions import FRESH_NS, ExtensionRequests
from .gpsd_json import Report
from .gpsd_objects import line
from .listeners import NO_DESCRIPTORS, TOO_MANY, Listeners, Poller, RejectedError
from .nmea_sentences import sentences
from .view import Device, View

_EVENTS_PER_WAKEUP = 4
_STALL_TIMEOUT_NS = 60 * SECOND_NS  # the client reads nothing
_FIRST_REQUEST_TIMEOUT_NS = 60 * SECOND_NS  # the client has sent no request since it connected; as gpsd
_IDLE_TIMEOUT_NS = 900 * SECOND_NS  # the client sends no request and watches nothing; as gpsd


@dataclass(slots=True)
class Counters:
    """Since the start."""

    connections: int = 0
    refused: int = 0  # connections rejected: too many clients, or no file descriptor free
    requests: int = 0
    errors: int = 0  # requests answered with ERROR
    dropped: int = 0  # messages that slow clients lost
    expelled: int = 0  # clients that the server disconnected: they stalled, sent nothing, or sent no valid request


class GpsdServer:
    """gpsd's JSON protocol on the addresses of `settings.listen`, separated by commas."""

    def __init__(
        self,
        settings: Gpsd,
        poller: Poller,
        queries: Mapping[str, Callable[[], str]] | None = None,
        commands: Mapping[str, Callable[[bytes], str]] | None = None,
        errors: ContainedErrors | None = None,
    ) -> None:
        """Open. queries, commands: the requests that gpsd does not have; see ExtensionRequests.

        Raises ConfigError (78), AddressInUseError or CannotCreateError (73), PermissionDeniedError (77).
        """
        self.counters = Counters()
        self.settings = settings
        self._errors = errors or ContainedErrors()
        self._extensions = ExtensionRequests(queries or {}, commands or {})
        self._poller = poller
        self._listeners = Listeners(addresses_of(settings), poller, line(error_object(NO_DESCRIPTORS)))
        self._clients: dict[int, Connection] = {}
        self._view = View()
        self._report: Report | None = None
        self._sentences = b""  # the view as NMEA; empty until a client watches NMEA
        self._due_ns = NEVER_NS  # earliest time that a client wants a message
        self._wanted_ns = NEVER_NS  # when a newer view was wanted for an answer
        self._tick_ns = 0
        self._published_ns = -FRESH_NS
        self._wakeup_ns, self._events_left = -1, 0

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where it listens, with real port numbers."""
        return self._listeners.addresses

    @property
    def clients(self) -> int:
        return len(self._clients)

    def __contains__(self, fd: int) -> bool:
        return fd in self._clients or fd in self._listeners

    def close(self) -> None:
        """End all connections and stop listening."""
        for client in list(self._clients.values()):
            self._close_connection(client)
        self._listeners.close()

    @property
    def due_ns(self) -> int:
        """When the next view is due: a client's message is due, or the view that answers a request is outdated."""
        return min(self._due_ns, self._wanted_ns) if self._clients else NEVER_NS

    def want_newest(self, now_ns: int) -> None:
        """Have a view due at once if the last one is outdated. Call it before `on_event`: a client may ask for it."""
        if now_ns - self._published_ns >= FRESH_NS:
            self._wanted_ns = now_ns

    def announce(self, devices: tuple[Device, ...], now_ns: int) -> None:
        """Have a view due at once if clients do not know yet that these are the devices."""
        if self._clients and devices != self._view.devices:
            self._wanted_ns = now_ns

    def publish(self, view: View, now_ns: int) -> None:
        """Take the newest view and send it to the clients whose next message is due."""
        if view.devices != self._view.devices:
            self._publish_device_changes(self._view.devices, view.devices, now_ns)
        self._view, self._report, self._sentences = view, None, b""
        self._published_ns, self._wanted_ns = now_ns, NEVER_NS
        self.tick(now_ns)
        if now_ns < self._due_ns:
            return
        for client in [c for c in self._clients.values() if c.policy.streaming]:
            try:
                if kinds := client.due_classes(now_ns):
                    self._send_or_drop(client, self._encode(client.policy, kinds), now_ns)
            except Exception as error:
                self._errors.report("the connection of a gpsd client", error)
                self._disconnect(client)
        self._reschedule()

    def _encode(self, policy: Policy, kinds: tuple[str, ...]) -> bytes:
        """The newest view in the format that the client watches: JSON, NMEA, or both."""
        data = self._newest_report().lines(kinds) if policy.json else b""
        if policy.sends_nmea:
            self._sentences = self._sentences or sentences(self._view)
            data += self._sentences
        return data

    def on_event(self, fd: int, mask: int, now_ns: int) -> None:
        """Handle a poll event; beyond the limit of this wake-up, poll reports the same event again."""
        self.tick(now_ns)
        if now_ns != self._wakeup_ns:
            self._wakeup_ns, self._events_left = now_ns, _EVENTS_PER_WAKEUP
        self._events_left -= 1
        if self._events_left < 0:
            return
        try:
            if fd in self._listeners:
                self._accept(fd, now_ns)
            elif client := self._clients.get(fd):
                self._serve(client, mask, now_ns)
        except Exception as error:
            self._errors.report("the connection of a gpsd client", error)
            if client := self._clients.get(fd):
                self._disconnect(client)
            else:
                self._listeners.pause(fd)

    def tick(self, now_ns: int) -> None:
        """Once per second: disconnect clients that timed out, renew the quotas of all others; listen again."""
        if now_ns < self._tick_ns:
            return
        self._tick_ns = now_ns + SECOND_NS
        self._listeners.tick()
        for client in list(self._clients.values()):
            client.renew_quota()
            if self._has_timed_out(client, now_ns):
                self._disconnect(client)
            else:
                self._update_events(client)

    def _has_timed_out(self, client: Connection, now_ns: int) -> bool:
        if client.stalled_ns is not None and now_ns - client.stalled_ns > _STALL_TIMEOUT_NS:
            return True
        timeout_ns = _IDLE_TIMEOUT_NS if client.has_requested else _FIRST_REQUEST_TIMEOUT_NS
        return not client.policy.enable and now_ns - client.last_request_ns > timeout_ns

    def _accept(self, fd: int, now_ns: int) -> None:
        try:
            sock = self._listeners.accept(fd)
        except RejectedError:
            self.counters.refused += 1
            return
        if sock is None:
            return
        if len(self._clients) >= self.settings.max_clients:
            self.counters.refused += 1
            with sock, contextlib.suppress(OSError):
                sock.send(line(error_object(TOO_MANY)), socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
            return
        try:
            client = Connection(sock, Policy(rate_hz=self.settings.rate_hz), now_ns)
        except OSError:  # the client has closed the connection already
            sock.close()
            return
        self.counters.connections += 1
        self._clients[sock.fileno()] = client
        self._poller.register(sock.fileno(), client.events)
        self._send(client, line(version_object()), now_ns)

    def _serve(self, client: Connection, mask: int, now_ns: int) -> None:
        """Send unsent bytes, receive, answer each complete request."""
        try:
            if mask & (select.POLLHUP | select.POLLERR):
                raise ConnectionResetError
            client.flush(now_ns)
            if mask & select.POLLIN and not client.read():
                raise ConnectionResetError
            while request := client.next_request(now_ns):
                client.write(self._answer(client, request, now_ns), now_ns)
        except OSError:
            self._close_connection(client)
            return
        received = client.receive_buffer
        if error_text := "request too long" if received.too_long else NOT_HTTP if received.is_http else "":
            self._send(client, line(error_object(error_text)), now_ns)
            self._disconnect(client)
        else:
            self._update_events(client)

    def _answer(self, client: Connection, request: Request, now_ns: int) -> bytes:
        try:
            reply = self._extensions.answer(request, client, now_ns)
            reply = reply or answer(request, client.policy, self._newest_report())
        except Exception as error:
            self._errors.report(f"the request {request.command[:20]}", error)
            reply = Answer((error_object("internal error"),), client.policy, refused=True)
        self.counters.requests += 1
        self.counters.errors += reply.refused
        if reply.policy is not client.policy:
            client.set_policy(reply.policy)
            self._reschedule()
        return line(*reply.objects)

    def _publish_device_changes(self, before: tuple[Device, ...], after: tuple[Device, ...], now_ns: int) -> None:
        """Send the devices that were removed and those that were added to the clients that watch."""
        removed = [device_object(device, active=False) for device in before if device not in after]
        added = [device_object(device) for device in after if device not in before]
        for client in [c for c in self._clients.values() if c.policy.enable and c.policy.json]:
            self._send_or_drop(client, line(*removed, *added), now_ns)

    def _newest_report(self) -> Report:
        if self._report is None:
            self._report = Report(self._view)
        return self._report

    def _reschedule(self) -> None:
        streaming = (client for client in self._clients.values() if client.policy.streaming)
        self._due_ns = min((client.rate_limiter.due_ns for client in streaming), default=NEVER_NS)

    def _send_or_drop(self, client: Connection, data: bytes, now_ns: int) -> None:
        before = client.dropped
        try:
            client.send_or_drop(data, now_ns)
        except OSError:
            self._close_connection(client)
            return
        self.counters.dropped += client.dropped - before
        self._update_events(client)

    def _send(self, client: Connection, data: bytes, now_ns: int) -> None:
        try:
            client.write(data, now_ns)
        except OSError:
            self._close_connection(client)
        else:
            self._update_events(client)

    def _update_events(self, client: Connection) -> None:
        """Have poll report the events that this connection waits for."""
        events = client.wanted_events()
        if events != client.events:
            client.events = events
            self._poller.modify(client.sock.fileno(), events)

    def _disconnect(self, client: Connection) -> None:
        if client.sock.fileno() not in self._clients:  # closed already
            return
        self.counters.expelled += 1
        self._close_connection(client)

    def _close_connection(self, client: Connection) -> None:
        fd = client.sock.fileno()
        if self._clients.pop(fd, None) is not None:
            self._poller.unregister(fd)
            client.close()
