"""Log lines for changes in a running daemon: each change once, and only if it lasts."""

from collections.abc import Hashable, Iterable
from typing import Any

from ..estimators.records import ATTITUDE_VALID, COASTING, HEADING_VALID, HEIGHT_VALID, POSITION_VALID, REJECTING

STATUS_LASTS_NS, TROUBLE_LASTS_NS = 1_000_000_000, 500_000_000  # a change must last so long to be logged
_STATUS = (
    (ATTITUDE_VALID, "roll and pitch are valid", "roll and pitch are lost"),
    (HEADING_VALID, "heading is valid", "heading is lost"),
    (POSITION_VALID, "position is valid", "position is lost"),
    (HEIGHT_VALID, "height is valid", "height is lost"),
    (COASTING, "no fixes: coasting", "fixes are back"),
    (REJECTING, "the fixes contradict the estimate: rejecting them", "fixes and estimate agree again"),
)


class Changes:
    """Facts that are there or not; a change counts once it has lasted `lasting_ns`."""

    def __init__(self, lasting_ns: int) -> None:
        self._lasting_ns = lasting_ns
        self._told: set[Hashable] = set()
        self._since_ns: dict[Hashable, int] = {}

    def of(self, facts: Iterable[Hashable], now_ns: int) -> tuple[list[Any], list[Any]]:
        """Which facts came and which went, given all that hold now."""
        different = self._told.symmetric_difference(facts)
        if not different:
            self._since_ns.clear()
            return [], []
        self._since_ns = {fact: self._since_ns.get(fact, now_ns) for fact in different}
        lasted = [fact for fact, since_ns in self._since_ns.items() if now_ns - since_ns >= self._lasting_ns]
        came = [fact for fact in lasted if fact not in self._told]
        went = [fact for fact in lasted if fact in self._told]
        self._told.symmetric_difference_update(lasted)
        return came, went


class Announcer:
    """Writes changes to the log. One per daemon."""

    def __init__(self, log: Any) -> None:
        self._log = log
        self._status = Changes(STATUS_LASTS_NS)
        self._troubles: dict[str, Changes] = {}

    def status(self, status: int, now_ns: int) -> int:
        """Log changes of the solution's status bits; returns those that were newly set."""
        came, went = self._status.of([bit for bit, *_ in _STATUS if status & bit], now_ns)
        if not came and not went:
            return 0
        for bit, came_text, went_text in _STATUS:
            if bit in came:
                self._log.info(came_text)
            if bit in went:
                self._log.info(went_text)
        return sum(came)

    def troubles(self, kind: str, troubles: Iterable[str], now_ns: int) -> None:
        """Log what is newly wrong with a sensor and what no longer is, given its present troubles in words."""
        came, went = self._troubles.setdefault(kind, Changes(TROUBLE_LASTS_NS)).of(troubles, now_ns)
        for text in came:
            self._log.warning(text)
        for text in went:
            self._log.info(f"no longer: {text}")
