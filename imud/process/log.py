"""Logs: state changes only, on stderr; readable on a terminal, with priorities and fields in systemd's journal.

Source: systemd.io/JOURNAL_NATIVE_PROTOCOL, systemd.exec(5) on JOURNAL_STREAM, sd-daemon(3) on the prefixes.
"""

import contextlib
import os
import re
import socket
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, TextIO

LogSink = Callable[[str, str, dict[str, Any]], None]  # level, text, facts of each line

JOURNAL = "/run/systemd/journal/socket"
_PRIORITY = {"debug": 7, "info": 6, "warning": 4, "error": 3}
_COLOURS = {"debug": 34, "info": 32, "warning": 33, "error": 31}
_QUOTED = set(" =\"'")  # a text with one of these is shown in quotes


def _sentence(text: str, facts: Mapping[str, Any]) -> str:
    return " ".join([text, *(f"{name}={fact}" for name, fact in facts.items())])


def _coloured(code: int, text: str) -> str:
    return f"\33[{code}m{text}\33[0m"


def _plain(code: int, text: str) -> str:
    return text


def _is_plain(fact: Any) -> bool:
    return isinstance(fact, str) and fact.isprintable() and not _QUOTED & set(fact)


def _for_people(level: str, text: str, facts: Mapping[str, Any], paint: Callable[[int, str], str]) -> str:
    shown = ((name, fact if _is_plain(fact) else repr(fact)) for name, fact in facts.items())
    head = [paint(2, time.strftime("%H:%M:%S")), f"[{paint(_COLOURS[level], f'{level:<9}')}]", paint(1, text)]
    return " ".join([*head, *(f"{paint(36, name)}={paint(35, fact)}" for name, fact in shown)])


def _as_json(level: str, text: str, facts: Mapping[str, Any]) -> str:
    import json  # which most daemons do not need

    now_ns = time.time_ns()
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(now_ns // 10**9)) + f".{now_ns // 1000 % 10**6:06}Z"
    return json.dumps({**facts, "event": text, "level": level, "timestamp": stamp}, default=repr)


def datagram(priority: int, text: str, facts: Mapping[str, Any]) -> bytes:
    """A line for the journal: its text and each fact as a field of its own, besides the whole as MESSAGE."""
    named = {**facts, "event": text}
    own = {"MESSAGE": _sentence(text, facts), "PRIORITY": priority, "SYSLOG_IDENTIFIER": "imud"}
    fields = {re.sub(r"\W", "_", key, flags=re.ASCII).strip("_").upper(): value for key, value in named.items()}
    return b"".join(_field(name, str(value)) for name, value in {**fields, **own}.items() if name)


def _field(name: str, value: str) -> bytes:
    data = value.encode(errors="replace")
    if b"\n" in data:
        return name.encode() + b"\n" + len(data).to_bytes(8, "little") + data + b"\n"
    return b"%s=%s\n" % (name.encode(), data)


class Journal:
    """systemd's journal."""

    def __init__(self, path: str) -> None:
        """Raises OSError where there is no journal."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            self._socket.connect(path)
        except OSError:
            self._socket.close()
            raise

    def send(self, level: str, text: str, facts: Mapping[str, Any]) -> bool:
        """Whether it took the line."""
        try:
            self._socket.send(datagram(_PRIORITY[level], text, facts))
        except OSError:
            return False
        return True


def _is_journalled() -> bool:
    """Whether our own stderr goes to the journal, not only that of the process that started us."""
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


class Logger:
    """Writes lines with the facts that it is bound to. A line that cannot be written is lost, and does no harm."""

    def __init__(self, facts: Mapping[str, Any] | None = None) -> None:
        self._facts = dict(facts or {})

    def bind(self, **facts: Any) -> "Logger":
        """One whose lines have these facts, too."""
        return Logger({**self._facts, **facts})

    def debug(self, text: str, **facts: Any) -> None:
        _log("debug", text, {**self._facts, **facts})

    def info(self, text: str, **facts: Any) -> None:
        _log("info", text, {**self._facts, **facts})

    def warning(self, text: str, **facts: Any) -> None:
        _log("warning", text, {**self._facts, **facts})

    def error(self, text: str, **facts: Any) -> None:
        _log("error", text, {**self._facts, **facts})


def get_logger() -> Logger:
    """One without facts."""
    return Logger()


class _Output:
    """Where lines go, in this process."""

    def __init__(self, level: str, sink: LogSink | None, form: str, stream: TextIO) -> None:
        self._priority, self._sink, self._form, self._stream = _PRIORITY[level], sink, form, stream
        self._paint = _coloured if stream.isatty() and not os.environ.get("NO_COLOR") else _plain
        self._journal = None
        self._journalled = form == "text" and _is_journalled()
        if self._journalled:
            with contextlib.suppress(OSError):
                self._journal = Journal(JOURNAL)

    def write(self, level: str, text: str, facts: dict[str, Any]) -> None:
        if _PRIORITY[level] > self._priority:
            return
        if self._sink is not None:
            self._sink(level, text, facts)
        if self._journal is None or not self._journal.send(level, text, facts):
            with contextlib.suppress(OSError, ValueError):  # the reader is gone, the disk full
                self._stream.write(self._line(level, text, facts) + "\n")
                self._stream.flush()

    def _line(self, level: str, text: str, facts: dict[str, Any]) -> str:
        if self._form == "json":
            return _as_json(level, text, facts)
        if self._journalled:
            return f"<{_PRIORITY[level]}>{_sentence(text, facts)}"
        return _for_people(level, text, facts, self._paint)


_output: _Output | None = None


def _log(level: str, text: str, facts: dict[str, Any]) -> None:
    if _output is None:
        configure()
    assert _output is not None
    _output.write(level, text, facts)


def configure(level: str = "info", sink: LogSink | None = None, form: str = "text") -> None:
    """Say where lines go, for the whole process; `sink` is called with every one, too.

    form: "text" for people and systemd's journal, or "json": one object a line, with UTC time stamps (ISO 8601).
    """
    global _output  # noqa: PLW0603
    _output = _Output(level, sink, form, sys.stderr)
