"""The fix mode of a receiver that reports it more rarely than positions."""

from .content import GsaMode

DIMENSIONS_LAST = 30  # epochs without a GSA after which the last one no longer counts


class GsaHistory:
    """The fix mode by the newest GSA. A receiver may send one for each satellite system, and none in most epochs."""

    def __init__(self) -> None:
        self._dimensions: int | None = None
        self._complete = True  # something else came since, so the next GSA is of another epoch
        self._age = 0

    def add(self, gsa: GsaMode) -> None:
        """One GSA."""
        best = max(gsa.dimensions, 1 if self._complete or self._dimensions is None else self._dimensions)
        self._dimensions = best if best > 1 else None
        self._complete, self._age = False, 0

    def end_group(self) -> None:
        """Another kind of sentence came: the next GSA is of another epoch."""
        self._complete = True

    def dimensions_for_fix(self) -> int | None:
        """The fix mode for a new fix; None: no GSA came lately. Call once for each fix."""
        self._age += 1
        return self._dimensions if self._age <= DIMENSIONS_LAST else None
