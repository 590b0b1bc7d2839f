"""Exceptions that end one client, request, file or device, and not the daemon: counted, and each kind is logged once.

Such an exception is a defect of imud. Its traceback goes to the log the first time, so that it can be reported; the
count is part of `imud status`.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from ..errors import ImudError
from .log import get_logger

_KINDS_MAX = 100  # that are remembered, and so logged
_ROOT = Path(__file__).parents[2]


class ContainedErrors:
    """One per daemon. Not thread-safe."""

    def __init__(self) -> None:
        self.count = 0
        self.last = ""
        self._log = get_logger()
        self._logged: set[str] = set()

    @contextlib.contextmanager
    def contain(self, what: str) -> Iterator[None]:
        """Within the block an exception ends the block only, and is reported. An ImudError is meant, and goes on."""
        try:
            yield
        except ImudError:
            raise
        except Exception as error:
            self.report(what, error)

    def report(self, what: str, error: Exception) -> None:
        """Count an exception that ended `what`; log it unless the same line has raised the same type before."""
        code, line = _place(error)
        file = Path(code)
        place = f"{file.relative_to(_ROOT) if file.is_relative_to(_ROOT) else file.name}:{line}"
        kind = f"{type(error).__name__} in {place}"
        self.count += 1
        self.last = f"{what}: {kind}: {error}"
        if kind not in self._logged and len(self._logged) < _KINDS_MAX:
            self._logged.add(kind)
            self._log.error(
                f"a defect of imud ended {what}; please report it: {kind}: {error}", traceback=_traceback(error)
            )


def _place(error: Exception) -> tuple[str, int]:
    """The file and the line that raised it."""
    raised = error.__traceback__
    assert raised is not None
    while raised.tb_next is not None:
        raised = raised.tb_next
    return raised.tb_frame.f_code.co_filename, raised.tb_lineno


def _traceback(error: Exception) -> str:
    """Its traceback; empty if that cannot be made for lack of what the error itself lacked: descriptors, memory."""
    try:
        import traceback  # which a daemon without a defect does not need

        return "".join(traceback.format_exception(error))
    except (ImportError, OSError, MemoryError):
        return ""
