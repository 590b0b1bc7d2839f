"""Fixes of a file that the settings forbid: what is said of them, and an error if no other is left."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from ..configuration.settings import Gnss
from ..errors import BadDataError
from ..math.arrays import Records
from ..sensors.gnss import refusals


def warn_of_refused(path: Path, refused: Counter[str], total: int, warn: Callable[[str], object]) -> None:
    """refused: reasons, of `total` fixes. Raises BadDataError if none is left."""
    reasons = ", ".join(f"{why} ({count} times)" for why, count in refused.items())
    if refused and refused.total() == total:
        raise BadDataError(f"{path}: none of its fixes is used: {reasons}")
    if refused:
        warn(f"{refused.total()} of {total} fixes are not used: {reasons}")


def without_refused(path: Path, fixes: Records, settings: Gnss, warn: Callable[[str], object]) -> Records:
    """The fixes (array of FIX) that the settings allow. Raises BadDataError if they forbid all."""
    why = refusals(fixes, settings)
    warn_of_refused(path, Counter(str(w) for w in why if w), len(fixes), warn)
    return fixes[[w is None for w in why]]
