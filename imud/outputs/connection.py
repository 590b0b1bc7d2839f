"""One client's connection: its unsent bytes, its request quota, and when its next message is due. Never blocks.

Memory and work are bounded whatever the client does. A message is sent whole or dropped whole, so no line is ever torn.
While a message has unsent bytes, no other message is queued and no request is read, so a client that does not read its
answers is stopped by its own socket buffer. After a quota of reads and requests in one second, the server reads nothing
more until the next second.
"""

import contextlib
import select
import socket

from .addresses import is_from_this_machine
from .gpsd_dialogue import Policy, ReceiveBuffer, Request

_READ_MAX = 128  # bytes per event: two dozen requests at most, which bounds the work of one wake-up
_QUOTA = 100  # reads and requests per second
_SEND_BUFFER = 64 * 1024  # bytes in the kernel: a larger buffer would deliver outdated messages
SECOND_NS = 1_000_000_000
NEVER_NS = (1 << 63) - 1


class RateLimiter:
    """Allows one message per period and keeps the phase, so that the mean rate is right at any jitter."""

    def __init__(self, rate_hz: float) -> None:
        self.period_ns = round(SECOND_NS / rate_hz)
        self._next_ns = 0

    @property
    def due_ns(self) -> int:
        return self._next_ns - self.period_ns // 4

    def try_acquire(self, now_ns: int) -> bool:
        """True when a message is due; the next is then due a period later."""
        if now_ns < self.due_ns:
            return False
        late = now_ns - self._next_ns
        self._next_ns = (self._next_ns if late < self.period_ns else now_ns) + self.period_ns
        return True


class Connection:
    """A connected client. Methods that use the socket raise OSError when the peer is gone."""

    def __init__(self, sock: socket.socket, policy: Policy, now_ns: int) -> None:
        self.sock = sock
        self.set_policy(policy)
        self.receive_buffer = ReceiveBuffer()
        self.dropped = 0  # messages
        self.last_request_ns = now_ns
        self.has_requested = False
        self.stalled_ns: int | None = None  # since when the client has taken no unsent byte
        self.events = select.POLLIN
        self._unsent = b""
        self._quota = _QUOTA
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        if sock.family != socket.AF_UNIX:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    @property
    def trusted(self) -> bool:
        """Whether it may send commands: a client on this machine that has sent nothing but this protocol."""
        return is_from_this_machine(self.sock) and not self.receive_buffer.has_other_text

    def wanted_events(self) -> int:
        """The poll events: POLLOUT while bytes are unsent, POLLIN while the quota lasts."""
        if self._unsent:
            return select.POLLOUT
        return select.POLLIN if self._quota > 0 else 0

    def renew_quota(self) -> None:
        """Call once per second."""
        self._quota = _QUOTA

    def send_or_drop(self, data: bytes, now_ns: int) -> None:
        """Send the message now, or drop and count it while an older message has unsent bytes."""
        if self._unsent:
            self.dropped += 1
        else:
            self.write(data, now_ns)

    def write(self, data: bytes, now_ns: int) -> None:
        """Send; `flush` sends later what the socket does not take now."""
        self._unsent += data
        self.flush(now_ns)

    def flush(self, now_ns: int) -> None:
        try:
            sent = self.sock.send(self._unsent, socket.MSG_NOSIGNAL) if self._unsent else 0
        except (BlockingIOError, InterruptedError):
            sent = 0
        self._unsent = self._unsent[sent:]
        if not self._unsent:
            self.stalled_ns = None
        elif sent or self.stalled_ns is None:
            self.stalled_ns = now_ns

    def read(self) -> bool:
        """Receive bytes; False when the client has closed the connection."""
        if self.wanted_events() != select.POLLIN:
            return True
        try:
            data = self.sock.recv(_READ_MAX)
        except (BlockingIOError, InterruptedError):
            return True
        self._quota -= 1
        self.receive_buffer.feed(data)
        return bool(data)

    def next_request(self, now_ns: int) -> Request | None:
        """The next request, unless an earlier answer has unsent bytes."""
        if self._unsent or (request := self.receive_buffer.next_request()) is None:
            return None
        self._quota -= 1
        self.last_request_ns, self.has_requested = now_ns, True
        return request

    def set_policy(self, policy: Policy) -> None:
        """Apply a new policy at once."""
        self.policy = policy
        self.rate_limiter, self.sky_rate_limiter = RateLimiter(policy.rate_hz), RateLimiter(min(1.0, policy.rate_hz))
        self._without_sky = tuple(kind for kind in policy.classes if kind != "SKY")

    def due_classes(self, now_ns: int) -> tuple[str, ...]:
        """The classes to send now; the satellites change slowly and go out once per second."""
        if not self.rate_limiter.try_acquire(now_ns):
            return ()
        return self.policy.classes if self.sky_rate_limiter.try_acquire(now_ns) else self._without_sky

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.sock.close()
