"""Logs: state changes only, on stderr; readable on a terminal, with priorities under systemd."""

import contextlib
import logging
import os
import sys
from typing import Any, TextIO, cast

import structlog

_PRIORITY = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}


def _journal_line(_: Any, method: str, event: dict[str, Any]) -> str:
    message = event.pop("event")
    event.pop("level", None)
    event.pop("timestamp", None)
    fields = " ".join(f"{key}={value}" for key, value in event.items())
    return f"<{_PRIORITY.get(method, 6)}>{message}{' ' if fields else ''}{fields}"


class _Lossy:
    """A stream that may fail, its reader gone or its disk full: that costs lines of the log, not the daemon."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.write(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()


def configure(level: str = "info") -> None:
    """Set up structlog once, for the whole process."""
    processors: list[Any] = [structlog.processors.add_log_level]
    if os.environ.get("JOURNAL_STREAM"):
        processors.append(_journal_line)
    else:
        colours = sys.stderr.isatty() and not os.environ.get("NO_COLOR")
        processors += [
            structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False),
            structlog.dev.ConsoleRenderer(colors=colours, pad_event_to=0, sort_keys=False),
        ]
    structlog.configure(
        processors=processors,
        wrapper_class=structlog.make_filtering_bound_logger(getattr(logging, level.upper())),
        logger_factory=structlog.WriteLoggerFactory(cast(TextIO, _Lossy(sys.stderr))),
        cache_logger_on_first_use=True,
    )
