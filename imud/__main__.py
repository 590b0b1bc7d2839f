"""Where the process begins. Signals are handled before anything is loaded, so that it ends properly at any moment.

Until the command begins there is nothing to tidy up and a signal just ends the process; later it interrupts the
command, which tidies up. While numba compiles a kernel it ends the process, too: LLVM, interrupted, may crash.
"""

import os
import signal
import sys
from types import FrameType
from typing import NoReturn

_SERVICES = ("run", "sim", "record", "web")  # run until SIGTERM ends them, which is no failure
_SELDOM_USED = (
    *("ipaddress", "selectors", "tokenize", "linecache"),  # which urllib.parse, socket, inspect, traceback import
    *("inspect", "ast", "tomllib"),  # which dataclasses and numpy import; which we need for a file of settings
    *("msgspec.inspect", "structlog.stdlib", "logging"),  # which msgspec and structlog import
    *("numpy._core._add_newdocs", "numpy._core._add_newdocs_scalars"),  # docstrings, which numpy imports
)
_INTERRUPTED, _TERMINATED = 130, 143
_AGAIN_S = 0.05


def _ended(arguments: list[str]) -> int:
    """Exit code after SIGTERM."""
    return 0 if not arguments or arguments[0].startswith("-") or arguments[0] in _SERVICES else _TERMINATED


def _compiles() -> bool:
    """Whether numba is at work in this thread."""
    lock = getattr(sys.modules.get("numba.core.compiler_lock"), "global_compiler_lock", None)  # or half imported
    return lock is not None and lock.is_locked()


def main() -> int:
    """The `imud` command; returns the process's exit code (see `imud.errors`)."""
    terminated = _ended(sys.argv[1:])

    def end(number: int, frame: FrameType | None) -> NoReturn:
        def ignored(what: "sys.UnraisableHookArgs") -> None:
            """Of objects that the signal leaves half made, which cannot be deleted properly; or of the signal itself,
            which came while one was deleted, or in a callback from C: then it comes again.
            """
            if isinstance(what.exc_value, SystemExit | KeyboardInterrupt):
                signal.signal(signal.SIGALRM, lambda _, frame: end(number, frame))
                signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)

        if _compiles():
            os._exit(_INTERRUPTED if number == signal.SIGINT else terminated)
        sys.unraisablehook = ignored
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(terminated)

    signal.signal(signal.SIGTERM, lambda number, frame: os._exit(terminated))
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(_INTERRUPTED))
    from .late_imports import imported_late

    with imported_late(*_SELDOM_USED):
        from . import commands

        signal.signal(signal.SIGTERM, end)
        signal.signal(signal.SIGINT, end)
        return commands.main()


if __name__ == "__main__":
    sys.exit(main())
