"""A progress bar for long work, on a terminal; nothing in a pipe."""

import sys


class Progress:
    """A bar on stderr while it is a terminal; silent otherwise."""

    def __init__(self, total: int) -> None:
        self._total, self._shown = total, -1
        self._on = sys.stderr.isatty()

    def at(self, done: int) -> None:
        percent = 100 * done // max(self._total, 1)
        if self._on and percent != self._shown:
            self._shown = percent
            end = "\n" if percent == 100 else ""
            print(f"\r  {'#' * (percent // 3):<34}{percent:3d} %", end=end, file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Make room for a line of text; the bar comes back with the next `at`."""
        if self._on:
            self._shown = -1
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
