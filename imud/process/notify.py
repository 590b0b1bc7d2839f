"""Reports to the service manager by sd_notify's datagrams. Does nothing where there is no service manager.

Source: sd_notify(3). The socket is named by NOTIFY_SOCKET; a leading @ means the abstract namespace.
"""

import contextlib
import os
import socket

_NEVER_NS = (1 << 63) - 1


class Notifier:
    """The connection to the service manager. One per process; close it, or let the process end."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        mine = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        microseconds = int(os.environ.get("WATCHDOG_USEC", "0") or "0") if mine else 0
        self._ping_ns = microseconds * 1000 // 3
        self._due_ns = 0
        self._status = ""

    @property
    def due_ns(self) -> int:
        """When `alive` has something to do."""
        return self._due_ns if self._ping_ns else _NEVER_NS

    def send(self, *assignments: str) -> None:
        """Send, for example, "READY=1", "STATUS=waiting". Never blocks, never raises."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto("\n".join(assignments).encode(), self._address)  # it may be another socket by now

    def alive(self, now_ns: int) -> None:
        """Feed the watchdog, if there is one; as often as it needs, however often this is called."""
        if self._ping_ns and now_ns >= self._due_ns:
            self._due_ns = now_ns + self._ping_ns
            self.send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """What the service is doing, for `systemctl status`; sent when it changes."""
        if text != self._status:
            self._status = text
            self.send(f"STATUS={text}")
