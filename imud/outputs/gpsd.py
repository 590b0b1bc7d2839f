"""A server for gpsd's clients inside the daemon's event loop: it never waits, and starts no thread.

The loop polls; for each descriptor that is `in` the server it calls `on_event`, with every new solution `publish`, and
it wakes up by `next_deadline` to call `tick`. All times are monotonic nanoseconds, one for all events of a wake-up: the
work of one wake-up is limited by it, so that a flood of connections or requests delays the sensors by little and is
served in the following ones. A slow, stalled or hostile client loses its own messages.
"""

import contextlib
import select
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from imud.configuration.settings import Gpsd
from imud.process.contained import ContainedErrors

from .connection import NEVER_NS, SECOND_NS, Connection
from .door import Door, Poller, TurnedAwayError
from .gpsd_dialogue import (
    NO_DESCRIPTORS,
    NOT_HTTP,
    TOO_MANY,
    Answer,
    Policy,
    Request,
    answer,
    device_object,
    error_object,
    version_object,
)
from .gpsd_json import Report
from .gpsd_objects import line
from .gpsd_own import FRESH_NS, OwnRequests
from .listen import addresses_of
from .nmea_sentences import sentences
from .view import Device, View

_EVENTS_PER_WAKEUP = 4
_STUCK_NS = 60 * SECOND_NS  # nothing read by the client
_SILENT_NS = 60 * SECOND_NS  # nothing asked since connecting; as gpsd
_POLLING_NS = 900 * SECOND_NS  # nothing asked, and not watching either; as gpsd


@dataclass(slots=True)
class Counters:
    """Since the start."""

    connections: int = 0
    refused: int = 0  # too many clients, or no descriptor left for another
    requests: int = 0
    errors: int = 0  # requests answered with ERROR
    dropped: int = 0  # messages that slow clients lost
    expelled: int = 0  # clients cut off: stuck, silent, or sending rubbish


class GpsdServer:
    """gpsd's JSON protocol on the addresses of `settings.listen`, separated by commas."""

    def __init__(
        self,
        settings: Gpsd,
        poller: Poller,
        own: Mapping[str, Callable[[], str]] | None = None,
        orders: Mapping[str, Callable[[bytes], str]] | None = None,
        errors: ContainedErrors | None = None,
    ) -> None:
        """Open. own: requests that are no gpsd's, and who makes the objects that answer them; orders: those that have
        something done by their argument, which trusted clients may.

        Raises ConfigError (78), AddressInUseError or CannotCreateError (73), PermissionDeniedError (77).
        """
        self.counters = Counters()
        self.settings = settings
        self._errors = errors or ContainedErrors()
        self._own = OwnRequests(own or {}, orders or {})
        self._poller = poller
        self._door = Door(addresses_of(settings), poller, line(error_object(NO_DESCRIPTORS)))
        self._clients: dict[int, Connection] = {}
        self._view = View()
        self._report: Report | None = None
        self._sentences = b""  # the view as NMEA, once somebody wants it
        self._due_ns = NEVER_NS  # earliest time that a client wants a message
        self._tick_ns = 0
        self._published_ns = -FRESH_NS
        self._wakeup_ns, self._events_left = -1, 0

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where it listens, with real port numbers."""
        return self._door.addresses

    @property
    def clients(self) -> int:
        return len(self._clients)

    def __contains__(self, fd: int) -> bool:
        return fd in self._clients or fd in self._door

    def next_deadline(self) -> int | None:
        """When `tick` wants to be called at the latest; None while there is nothing to look after."""
        return self._tick_ns if self._clients else None

    def close(self) -> None:
        """End all connections and stop listening."""
        for client in list(self._clients.values()):
            self._remove(client)
        self._door.close()

    @property
    def due_ns(self) -> int:
        """When a view is worth making: some client's message is due, or the one kept for ?POLL is old."""
        return min(self._due_ns, self._published_ns + FRESH_NS)

    def publish(self, view: View, now_ns: int) -> None:
        """Give the newest view; clients whose next message is due get it."""
        if view.devices != self._view.devices:
            self._announce(self._view.devices, view.devices, now_ns)
        self._view, self._report, self._sentences, self._published_ns = view, None, b"", now_ns
        self.tick(now_ns)
        if now_ns < self._due_ns:
            return
        for client in [c for c in self._clients.values() if c.policy.streaming]:
            try:
                if kinds := client.due(now_ns):
                    self._offer(client, self._said(client.policy, kinds), now_ns)
            except Exception as error:
                self._errors.report("the connection of a gpsd client", error)
                self._expel(client)
        self._reschedule()

    def _said(self, policy: Policy, kinds: tuple[str, ...]) -> bytes:
        """The newest view as this client wants it: as JSON, as NMEA, or both."""
        data = self._reported().lines(kinds) if policy.json else b""
        if policy.nmea:
            self._sentences = self._sentences or sentences(self._view)
            data += self._sentences
        return data

    def on_event(self, fd: int, mask: int, now_ns: int) -> None:
        """Handle what poll said of one of our descriptors; beyond the limit of this wake-up, poll says it again."""
        self.tick(now_ns)
        if now_ns != self._wakeup_ns:
            self._wakeup_ns, self._events_left = now_ns, _EVENTS_PER_WAKEUP
        self._events_left -= 1
        if self._events_left < 0:
            return
        try:
            if fd in self._door:
                self._accept(fd, now_ns)
            elif client := self._clients.get(fd):
                self._converse(client, mask, now_ns)
        except Exception as error:
            self._errors.report("the connection of a gpsd client", error)
            if client := self._clients.get(fd):
                self._expel(client)
            else:
                self._door.pause(fd)

    def tick(self, now_ns: int) -> None:
        """Once per second: cut off who is stuck or silent, let those go on who asked too much."""
        if now_ns < self._tick_ns:
            return
        self._tick_ns = now_ns + SECOND_NS
        self._door.tick()
        for client in list(self._clients.values()):
            client.renew_allowance()
            if self._has_overstayed(client, now_ns):
                self._expel(client)
            else:
                self._settle(client)

    def _has_overstayed(self, client: Connection, now_ns: int) -> bool:
        if client.stuck_ns is not None and now_ns - client.stuck_ns > _STUCK_NS:
            return True
        patience = _POLLING_NS if client.ever_asked else _SILENT_NS
        return not client.policy.enable and now_ns - client.asked_ns > patience

    def _accept(self, fd: int, now_ns: int) -> None:
        try:
            sock = self._door.let_in(fd)
        except TurnedAwayError:
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
        except OSError:  # gone already
            sock.close()
            return
        self.counters.connections += 1
        self._clients[sock.fileno()] = client
        self._poller.register(sock.fileno(), client.events)
        self._send(client, line(version_object()), now_ns)

    def _converse(self, client: Connection, mask: int, now_ns: int) -> None:
        """Write what is owed, read what has come, answer what is complete."""
        try:
            if mask & (select.POLLHUP | select.POLLERR):
                raise ConnectionResetError
            client.flush(now_ns)
            if mask & select.POLLIN and not client.read():
                raise ConnectionResetError
            while request := client.next_request(now_ns):
                client.write(self._answer(client, request, now_ns), now_ns)
        except OSError:
            self._remove(client)
            return
        refusal = "request too long" if client.inbox.overlong else NOT_HTTP if client.inbox.is_http else None
        if refusal:
            self._send(client, line(error_object(refusal)), now_ns)
            self._expel(client)
        else:
            self._settle(client)

    def _answer(self, client: Connection, request: Request, now_ns: int) -> bytes:
        try:
            answered = self._own.answer(request, client, now_ns)
            answered = answered or answer(request, client.policy, self._reported())
        except Exception as error:
            self._errors.report(f"the request {request.command[:20]}", error)
            answered = Answer((error_object("internal error"),), client.policy, refused=True)
        self.counters.requests += 1
        self.counters.errors += answered.refused
        if answered.policy is not client.policy:
            client.watch(answered.policy)
            self._reschedule()
        return line(*answered.objects)

    def _announce(self, before: tuple[Device, ...], after: tuple[Device, ...], now_ns: int) -> None:
        """Tell those who watch which devices went and which came."""
        gone = [device_object(device, active=False) for device in before if device not in after]
        came = [device_object(device) for device in after if device not in before]
        for client in [c for c in self._clients.values() if c.policy.enable and c.policy.json]:
            self._offer(client, line(*gone, *came), now_ns)

    def _reported(self) -> Report:
        if self._report is None:
            self._report = Report(self._view)
        return self._report

    def _reschedule(self) -> None:
        self._due_ns = min((c.pace.due_ns for c in self._clients.values() if c.policy.streaming), default=NEVER_NS)

    def _offer(self, client: Connection, data: bytes, now_ns: int) -> None:
        before = client.dropped
        try:
            client.offer(data, now_ns)
        except OSError:
            self._remove(client)
            return
        self.counters.dropped += client.dropped - before
        self._settle(client)

    def _send(self, client: Connection, data: bytes, now_ns: int) -> None:
        try:
            client.write(data, now_ns)
        except OSError:
            self._remove(client)
        else:
            self._settle(client)

    def _settle(self, client: Connection) -> None:
        """Wait for what the client is waiting for."""
        events = client.wanted_events()
        if events != client.events:
            client.events = events
            self._poller.modify(client.sock.fileno(), events)

    def _expel(self, client: Connection) -> None:
        if client.sock.fileno() not in self._clients:  # gone already
            return
        self.counters.expelled += 1
        self._remove(client)

    def _remove(self, client: Connection) -> None:
        fd = client.sock.fileno()
        if self._clients.pop(fd, None) is not None:
            self._poller.unregister(fd)
            client.close()
