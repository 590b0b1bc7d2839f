"""Corrections of an RTK base for the receiver: whole RTCM frames, read from a TCP server or a file.

A file may be a FIFO or a terminal into which another program writes (`str2str`), or a plain one that grows.
"""

import contextlib
import os
import socket
import stat
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from imud.drivers.rtcm import RtcmFramer
from imud.drivers.transport.tcp import connect, skip_address

from ..errors import ConfigError
from ..process.log import get_logger

AT_ONCE = 1024  # bytes read in one call: a receiver's line has little room
STALE_NS = 30_000_000_000  # a source that is silent that long is opened anew, but for a file that stays the same
_NO_RTCM = "what it sends is no RTCM 3: a caster of NTRIP needs a program in between, such as str2str"
_FIRST_RETRY_NS, _LAST_RETRY_NS = 1_000_000_000, 30_000_000_000


def address_of(source: str) -> tuple[str, int] | None:
    """`HOST:PORT` or `[IPV6]:PORT`; None: a path. Raises ConfigError."""
    if "://" in source:
        raise ConfigError(f"gnss.rtcm: {source!r} is a URL: have a program such as str2str serve it at HOST:PORT")
    if "/" in source:
        return None
    host, _, port = source.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ConfigError(f"gnss.rtcm: {source!r} is neither HOST:PORT nor a path with a slash, such as ./base.rtcm")
    return host.strip("[]"), int(port)


class Corrections:
    """Reads the source a few times a second, without waiting. Not thread-safe; times are monotonic nanoseconds."""

    def __init__(self, source: str) -> None:
        """source: HOST:PORT, or a path (with a slash)."""
        self.counters = Counter[str](forwarded=0)
        self._source = source
        self._address = address_of(source)
        self._log = get_logger().bind(rtcm=source)
        self._framer = RtcmFramer(self.counters)
        self._fd = -1
        self._socket: socket.socket | None = None
        self._state, self._wanted = "waits for the receiver", False
        self._retry_ns, self._due_ns, self._last_ns = _FIRST_RETRY_NS, 0, 0
        self._frame_ns: int | None = None  # when the last frame came
        self._rest = b""  # of a frame of which the line has taken a part

    def forward(self, now_ns: int, write: Callable[[bytes], int] | None) -> None:
        """Give the receiver what has come. write: to it, and says how many bytes it took; None: there is no receiver.

        The source is opened when the first receiver streams, so that a file goes to it as a whole. Later frames that
        come while there is none, or no room on its line, are lost: old ones are of no use.
        """
        if write is None:
            self._rest = b""
            if not self._wanted:
                return
        self._wanted = True
        for frame in self.read(now_ns):
            if write is not None and self._send(frame, write):
                self.counters["forwarded"] += 1

    def _send(self, frame: bytes, write: Callable[[bytes], int]) -> bool:
        """Send a frame, after the rest of the one before; False: there was no room. No frame is cut short."""
        if self._rest:
            self._rest = self._rest[write(self._rest) :]
        taken = 0 if self._rest else write(frame)
        if taken:
            self._rest = frame[taken:]
        return taken > 0

    def read(self, now_ns: int) -> list[bytes]:
        """The frames that have come since the last call; opens the source if that is due."""
        if self._fd < 0 and (now_ns < self._due_ns or not self._open(now_ns)):
            return []
        try:
            data = os.read(self._fd, AT_ONCE)
            ended = not data and self._address is not None  # a file may grow, a FIFO may get a new writer
        except BlockingIOError:
            data, ended = b"", False
        except OSError as error:
            self._close_and_retry(error.strerror or "it failed", now_ns)
            return []
        frames = list(self._framer.feed(data))
        if frames:
            self._set_state("data of the base come")
            self._last_ns = self._frame_ns = now_ns
            self._retry_ns = _FIRST_RETRY_NS
            self.counters["frames"] += len(frames)
        elif ended or now_ns - self._last_ns > STALE_NS:
            why = "it ended the connection" if ended else "nothing comes"
            if self.counters["noise bytes"] and not self.counters["frames"]:
                why = _NO_RTCM
            if self._is_same_file():
                self._last_ns = now_ns
                self._set_state(f"no data of the base: {why}")
            else:
                self._close_and_retry(why, now_ns)
        return frames

    def properties(self, now_ns: int) -> dict[str, Any]:
        """What `imud status` shows."""
        age = None if self._frame_ns is None else (now_ns - self._frame_ns) * 1e-9
        return {"source": self._source, "state": self._state, "age_s": age, **self.counters}

    def close(self) -> None:
        """Close the source. May be called twice."""
        if self._socket is not None:
            self._socket.close()
        elif self._fd >= 0:
            os.close(self._fd)
        self._socket, self._fd = None, -1

    def _open(self, now_ns: int) -> bool:
        try:
            if self._address is None:
                self._fd = os.open(Path(self._source).expanduser(), os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
            else:
                self._socket = connect(*self._address)
                self._fd = self._socket.fileno()
        except OSError as error:
            self._close_and_retry(error.strerror or str(error), now_ns)
            return False
        self._last_ns = now_ns
        return True

    def _is_same_file(self) -> bool:
        """Whether the source is still the plain file that is open: opened anew, it would give old corrections again."""
        if self._address is not None:
            return False
        try:
            opened, there = os.fstat(self._fd), Path(self._source).expanduser().stat()
        except OSError:
            return False
        if not stat.S_ISREG(opened.st_mode) or not os.path.samestat(opened, there):
            return False
        return os.lseek(self._fd, 0, os.SEEK_CUR) <= opened.st_size  # else it was begun anew

    def _close_and_retry(self, why: str, now_ns: int) -> None:
        if self._socket is not None and self._address is not None and self._frame_ns != self._last_ns:
            skip_address(*self._address)  # no frame has come since it was opened
        with contextlib.suppress(OSError):
            self.close()
        self._set_state(f"no data of the base: {why}; trying again")
        self._due_ns = now_ns + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, _LAST_RETRY_NS)

    def _set_state(self, state: str) -> None:
        """Store the state; log it if it is new."""
        if state != self._state:
            self._state = state
            self._log.info(state)
