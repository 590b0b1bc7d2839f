"""Logs: state changes only, on stderr; readable on a terminal, with priorities and fields in systemd's journal.

Source: systemd.io/JOURNAL_NATIVE_PROTOCOL, systemd.exec(5) on JOURNAL_STREAM, sd-daemon(3) on the prefixes.
"""

import contextlib
import os
import re
import socket
import stat
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TextIO, cast

from ..late_imports import hidden, imported_late

# structlog uses asyncio in coroutines only, and rich, where it is installed, for tracebacks: 6 MB and 40 ms each
with imported_late("asyncio"), hidden("rich", "colorama"):
    import structlog


get_logger = structlog.get_logger

JOURNAL = "/run/systemd/journal/socket"
_PRIORITY = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def _sentence(event: Mapping[str, Any]) -> str:
    """One line for people: the event and its values."""
    fields = (f"{key}={value}" for key, value in event.items() if key not in ("event", "level", "timestamp"))
    return " ".join([str(event["event"]), *fields])


def _escaped(_: Any, _method: str, event: dict[str, Any]) -> dict[str, Any]:
    """With control characters as text: what a device says must not steer the terminal."""
    return {k: _CONTROL.sub(lambda c: repr(c[0])[1:-1], v) if isinstance(v, str) else v for k, v in event.items()}


def _prefixed(_: Any, method: str, event: Mapping[str, Any]) -> str:
    return f"<{_PRIORITY.get(method, 6)}>{_sentence(event)}"


def datagram(priority: int, event: Mapping[str, Any]) -> bytes:
    """The event for the journal: each of its values as a field of its own, besides the whole as MESSAGE."""
    own = {"MESSAGE": _sentence(event), "PRIORITY": priority, "SYSLOG_IDENTIFIER": "imud"}
    fields = {re.sub(r"\W", "_", key, flags=re.ASCII).strip("_").upper(): value for key, value in event.items()}
    return b"".join(_field(name, str(value)) for name, value in {**fields, **own}.items() if name)


def _field(name: str, value: str) -> bytes:
    data = value.encode(errors="replace")
    if b"\n" in data:
        return name.encode() + b"\n" + len(data).to_bytes(8, "little") + data + b"\n"
    return b"%s=%s\n" % (name.encode(), data)


class Journal:
    """The last structlog processor under systemd's journal; events that it cannot send are passed on."""

    def __init__(self, path: str) -> None:
        """Raises OSError where there is no journal."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            self._socket.connect(path)
        except OSError:
            self._socket.close()
            raise

    def __call__(self, _: Any, method: str, event: Any) -> Any:
        """Send, and end the event's way."""
        try:
            self._socket.send(datagram(_PRIORITY.get(method, 6), event))
        except OSError:
            return event
        raise structlog.DropEvent


def _is_journalled() -> bool:
    """Whether our own stderr goes to the journal, not only that of the process that started us."""
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


class _Lossy:
    """A stream whose failure (reader gone, disk full) costs lines of the log, but does not end the daemon.

    Nor does a reader that stalls stop it: a terminal after Ctrl-S or behind a lost connection, a pipe that is full, the
    journal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._send: Callable[[bytes], int] | None = None  # to the same terminal, pipe or socket, without waiting
        self._torn = False  # its last line has no end
        with contextlib.suppress(OSError, ValueError):
            fd = stream.fileno()
            mode = os.fstat(fd).st_mode  # not O_NONBLOCK on stderr itself: others have it, too
            if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
                flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
                self._send = partial(os.write, os.open(f"/proc/self/fd/{fd}", flags))
            elif stat.S_ISSOCK(mode):  # the journal's
                duplicate = socket.socket(fileno=os.dup(fd))
                self._send = lambda data: duplicate.send(data, socket.MSG_DONTWAIT)

    def write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            if self._send is None:
                self._stream.write(text)
                return
            data = b"\n" * self._torn + text.encode(self._stream.encoding, "backslashreplace")
            self._torn = self._send(data) < len(data)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()


LogSink = Callable[[str, str, dict[str, Any]], None]  # level, text, facts of each line


def _forward_to(sink: LogSink) -> Any:
    def forward(_: Any, method: str, event: dict[str, Any]) -> dict[str, Any]:
        sink(method, event["event"], {name: fact for name, fact in event.items() if name not in ("event", "level")})
        return event

    return forward


def configure(level: str = "info", sink: LogSink | None = None, form: str = "text") -> None:
    """Set up structlog once, for the whole process; `sink` is called with every line, too.

    form: "text" for people and systemd's journal, or "json": one object a line, with UTC time stamps (ISO 8601).
    """
    processors: list[Any] = [structlog.processors.add_log_level]
    if sink is not None:
        processors.append(_forward_to(sink))
    if form == "json":
        processors += [structlog.processors.TimeStamper(fmt="iso", utc=True), structlog.processors.JSONRenderer()]
    elif _is_journalled():
        with contextlib.suppress(OSError):
            processors.append(Journal(JOURNAL))
        processors.append(_prefixed)
    else:
        colours = sys.stderr.isatty() and not os.environ.get("NO_COLOR")
        processors += [
            _escaped,
            structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False),
            structlog.dev.ConsoleRenderer(colors=colours, pad_event_to=0, sort_keys=False),
        ]
    structlog.configure(
        processors=processors,
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.WriteLoggerFactory(cast(TextIO, _Lossy(sys.stderr))),
        cache_logger_on_first_use=True,
    )
