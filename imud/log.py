"""Logs: state changes only, on stderr; readable on a terminal, with priorities under systemd."""

import logging
import os
import sys
from typing import Any

import structlog

_PRIORITY = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}


def _journal_line(_: Any, method: str, event: dict[str, Any]) -> str:
    message = event.pop("event")
    event.pop("level", None)
    event.pop("timestamp", None)
    fields = " ".join(f"{key}={value}" for key, value in event.items())
    return f"<{_PRIORITY.get(method, 6)}>{message}{' ' if fields else ''}{fields}"


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
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=True,
    )
