"""The life of a port as one table: its states, and which event leads from one to another.

`imud/README.md` shows the table; `Port` (ports.py) follows it.
"""

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType


class PortState(Enum):
    """What a port does. The value says it in words."""

    WAITING = "closed, waits for its next attempt"
    PROBING = "open, finds out which device answers"
    CONFIGURING = "open, sets the device up"
    STREAMING = "open, the device streams"
    RELEASED = "closed, a spare receiver or at the end of its recording; no attempt until its retry is scheduled"


class PortEvent(Enum):
    """What happens to a port."""

    OPENED = "the line was opened"
    IDENTIFIED = "the device was identified"
    CONFIGURED = "the device was set up and streams"
    FAILED = "the attempt failed: absent, in use, silent, unknown or unsuitable"
    LOST = "the connection ended: unplugged, silent, at a wrong rate, or a defect of imud"
    RELEASED = "the device is not wanted now"


TRANSITIONS: Mapping[PortState, Mapping[PortEvent, PortState]] = MappingProxyType(
    {
        PortState.WAITING: {
            PortEvent.OPENED: PortState.PROBING,
            PortEvent.FAILED: PortState.WAITING,
            PortEvent.LOST: PortState.WAITING,
        },
        PortState.PROBING: {
            PortEvent.IDENTIFIED: PortState.CONFIGURING,
            PortEvent.FAILED: PortState.WAITING,
            PortEvent.LOST: PortState.WAITING,
        },
        PortState.CONFIGURING: {
            PortEvent.CONFIGURED: PortState.STREAMING,
            PortEvent.FAILED: PortState.WAITING,
            PortEvent.LOST: PortState.WAITING,
        },
        PortState.STREAMING: {
            PortEvent.FAILED: PortState.WAITING,
            PortEvent.LOST: PortState.WAITING,
            PortEvent.RELEASED: PortState.RELEASED,
        },
        PortState.RELEASED: {
            PortEvent.OPENED: PortState.PROBING,
            PortEvent.FAILED: PortState.WAITING,
            PortEvent.LOST: PortState.WAITING,
        },
    }
)


def next_state(state: PortState, event: PortEvent) -> PortState:
    """Raises ValueError for an event that cannot happen in this state."""
    following = TRANSITIONS[state].get(event)
    if following is None:
        raise ValueError(f"a port in state {state.name} cannot have the event {event.name}")
    return following


def table() -> str:
    """TRANSITIONS as a table in Markdown: a row for each state, a column for each event."""
    rows = [["state", *(event.name for event in PortEvent)], ["---"] * (1 + len(PortEvent))]
    for state, following in TRANSITIONS.items():
        rows.append([f"`{state.name}`", *(f"`{following[e].name}`" if e in following else "" for e in PortEvent)])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
