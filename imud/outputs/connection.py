"""One client's connection: what is still to be sent, what it may ask, and when its next message is due. Never blocks.

Memory and work are bounded whatever the peer does. A message is either taken whole or dropped whole, so that no line is
ever torn. While one is still going out nothing else is queued and no request is read, so a peer that does not read its
answers is stopped by its own socket buffer. After a number of reads and requests in one second, no more is read until
the next.
"""

import contextlib
import select
import socket

from .gpsd_dialogue import Inbox, Policy, Request
from .listen import is_own

_READ_MAX = 128  # bytes per event: two dozen requests at most, which bounds the work of one wake-up
_ALLOWANCE = 100  # reads and requests per second
_SEND_BUFFER = 64 * 1024  # bytes in the kernel: what is older is no longer news
SECOND_NS = 1_000_000_000
NEVER_NS = (1 << 63) - 1


class Pace:
    """Lets one message through per period and keeps its phase, so that the mean rate is right at any jitter."""

    def __init__(self, rate_hz: float) -> None:
        self.period_ns = round(SECOND_NS / rate_hz)
        self._next_ns = 0

    @property
    def due_ns(self) -> int:
        return self._next_ns - self.period_ns // 4

    def take(self, now_ns: int) -> bool:
        """True when it is time; then the next is due a period later."""
        if now_ns < self.due_ns:
            return False
        late = now_ns - self._next_ns
        self._next_ns = (self._next_ns if late < self.period_ns else now_ns) + self.period_ns
        return True


class Connection:
    """A connected client. Methods that use the socket raise OSError when the peer is gone."""

    def __init__(self, sock: socket.socket, policy: Policy, now_ns: int) -> None:
        self.sock = sock
        self.watch(policy)
        self.inbox = Inbox()
        self.dropped = 0  # messages
        self.asked_ns = now_ns  # when it last asked for something
        self.ever_asked = False
        self.stuck_ns: int | None = None  # since when nothing of what is owed has gone out
        self.events = select.POLLIN
        self._owed = b""
        self._allowance = _ALLOWANCE
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        if sock.family != socket.AF_UNIX:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    @property
    def trusted(self) -> bool:
        """Whether it may have something done: a client on this machine that has spoken nothing but this protocol."""
        return is_own(self.sock) and not self.inbox.has_strange_text

    def wanted_events(self) -> int:
        """What to wait for: room to write while something is owed, requests while some are allowed."""
        if self._owed:
            return select.POLLOUT
        return select.POLLIN if self._allowance > 0 else 0

    def renew_allowance(self) -> None:
        """Once per second."""
        self._allowance = _ALLOWANCE

    def offer(self, data: bytes, now_ns: int) -> None:
        """Send now, or drop and count it if something older is still going out."""
        if self._owed:
            self.dropped += 1
        else:
            self.write(data, now_ns)

    def write(self, data: bytes, now_ns: int) -> None:
        """Send; what the socket does not take is owed and goes out by `flush`."""
        self._owed += data
        self.flush(now_ns)

    def flush(self, now_ns: int) -> None:
        try:
            sent = self.sock.send(self._owed, socket.MSG_NOSIGNAL) if self._owed else 0
        except (BlockingIOError, InterruptedError):
            sent = 0
        self._owed = self._owed[sent:]
        if not self._owed:
            self.stuck_ns = None
        elif sent or self.stuck_ns is None:
            self.stuck_ns = now_ns

    def read(self) -> bool:
        """Take what has come in; False when the peer has closed."""
        if self.wanted_events() != select.POLLIN:
            return True
        try:
            data = self.sock.recv(_READ_MAX)
        except (BlockingIOError, InterruptedError):
            return True
        self._allowance -= 1
        self.inbox.feed(data)
        return bool(data)

    def next_request(self, now_ns: int) -> Request | None:
        """The next request, unless an earlier answer is still going out."""
        if self._owed or (request := self.inbox.take()) is None:
            return None
        self._allowance -= 1
        self.asked_ns, self.ever_asked = now_ns, True
        return request

    def watch(self, policy: Policy) -> None:
        """Follow a new policy, at once."""
        self.policy = policy
        self.pace, self.sky_pace = Pace(policy.rate_hz), Pace(min(1.0, policy.rate_hz))
        self._without_sky = tuple(kind for kind in policy.classes if kind != "SKY")

    def due(self, now_ns: int) -> tuple[str, ...]:
        """The classes to send now; the satellites change slowly and go out once per second."""
        if not self.pace.take(now_ns):
            return ()
        return self.policy.classes if self.sky_pace.take(now_ns) else self._without_sky

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.sock.close()
