"""Log lines for changes in a running daemon: each change once, and only if it lasts."""

from collections.abc import Hashable, Iterable, Mapping
from typing import Any

from ..estimators.records import ATTITUDE_VALID, COASTING, HEADING_VALID, HEIGHT_VALID, POSITION_VALID, REJECTING

STATUS_LASTS_NS, FAULT_LASTS_NS = 1_000_000_000, 500_000_000  # a change must last so long to be logged
# each fix of a receiver that sends every 10 or 30 s ends COASTING for `coasting_s` (5 s by default): these are not back
_END_LASTS_NS: dict[Hashable, int] = {COASTING: 6_000_000_000}
_STATUS = (
    (ATTITUDE_VALID, "roll and pitch are valid", "roll and pitch are lost"),
    (HEADING_VALID, "heading is valid", "heading is lost"),
    (POSITION_VALID, "position is valid", "position is lost"),
    (HEIGHT_VALID, "height is valid", "height is lost"),
    (COASTING, "no fixes: coasting", "fixes are back"),
    (REJECTING, "the fixes contradict the estimate: rejecting them", "fixes and estimate agree again"),
)


LOGGED = sum(bit for bit, *_ in _STATUS)


class Debouncer:
    """A set whose changes count once they have lasted `lasting_ns`, or `end_lasting_ns` of a member that is removed."""

    def __init__(self, lasting_ns: int, end_lasting_ns: Mapping[Hashable, int] | None = None) -> None:
        self._lasting_ns, self._end_lasting_ns = lasting_ns, end_lasting_ns or {}
        self._reported: set[Hashable] = set()
        self._since_ns: dict[Hashable, int] = {}

    @property
    def is_settled(self) -> bool:
        """Whether nothing was different at the last update from what counts."""
        return not self._since_ns

    def update(self, members: Iterable[Hashable], now_ns: int) -> tuple[list[Any], list[Any]]:
        """The members that were added and those that were removed, given the present ones."""
        different = self._reported.symmetric_difference(members)
        if not different:
            self._since_ns.clear()
            return [], []
        self._since_ns = {member: self._since_ns.get(member, now_ns) for member in different}
        lasted = [member for member, since_ns in self._since_ns.items() if now_ns - since_ns >= self._least_ns(member)]
        added = [member for member in lasted if member not in self._reported]
        removed = [member for member in lasted if member in self._reported]
        self._reported.symmetric_difference_update(lasted)
        return added, removed

    def _least_ns(self, member: Hashable) -> int:
        is_end = member in self._reported
        return self._end_lasting_ns.get(member, self._lasting_ns) if is_end else self._lasting_ns


class ChangeLogger:
    """Writes changes to the log. One per daemon."""

    def __init__(self, log: Any) -> None:
        self._log = log
        self._status = Debouncer(STATUS_LASTS_NS, _END_LASTS_NS)
        self._faults: dict[str, Debouncer] = {}

    @property
    def is_settled(self) -> bool:
        """Whether no change waits to be logged."""
        return self._status.is_settled and all(each.is_settled for each in self._faults.values())

    def status(self, status: int, now_ns: int) -> int:
        """Log changes of the solution's status bits; returns those that were newly set."""
        added, removed = self._status.update([bit for bit, *_ in _STATUS if status & bit], now_ns)
        if not added and not removed:
            return 0
        for bit, set_text, cleared_text in _STATUS:
            if bit in added:
                self._log.info(set_text)
            if bit in removed:
                self._log.info(cleared_text)
        return sum(added)

    def faults(self, kind: str, faults: Iterable[str], now_ns: int) -> None:
        """Log the faults of a sensor that are new and those that have ended, given all present ones in words."""
        added, removed = self._faults.setdefault(kind, Debouncer(FAULT_LASTS_NS)).update(faults, now_ns)
        for text in added:
            self._log.warning(text)
        for text in removed:
            self._log.info(f"has ended: {text}")
