"""What the filter has found beside its solution, in words: for the status screen and the live page.

Only what differs from zero by more than its sigma explains: the rest, and all else, is in JSON and Prometheus.
"""

import math
from collections.abc import Mapping
from typing import Any

from ...filter_state_names import STATES

_LATE = "time_offset_s"
_LABELS = {  # by kind
    "time_offset": "fixes late by",
    "velocity_time_offset": "their velocity by another",
    "gnss_bias": "receiver off by",
    "gnss_velocity_bias": "its velocity by",
    "gnss_lever_arm": "antenna at",
    "mount": "pitch, yaw of the vehicle",
    "nhc_lever_arm": "ahead of its axle by",
}
_UNITS = {"s": " s", "m": " m", "mps": " m/s", "deg": "°", "": ""}
_NOTABLE = 2.0  # sigmas from zero


def notable_states(found: Mapping[str, Any]) -> dict[str, str]:
    """Values and sigma by label; found: numbers by the names of states.csv."""
    if early := found.get(_LATE, 0.0) < 0.0:
        found = {**found, _LATE: -found[_LATE]}
    labels = {**_LABELS, "time_offset": "fixes early by"} if early else _LABELS
    texts = {label: _state(found, kind) for kind, label in labels.items()}
    return {label: text for label, text in texts.items() if text}


def _state(found: Mapping[str, Any], kind: str) -> str:
    """All parts of a kind with the largest of their sigmas, to two digits of that; empty: they may be zero."""
    known = [state for state in STATES if state.kind == kind and f"s{state.column}" in found]
    if not any(abs(found[state.column]) > _NOTABLE * found[f"s{state.column}"] for state in known):
        return ""
    sigma = max(found[f"s{state.column}"] for state in known)
    decimals = max(1 - math.floor(math.log10(max(sigma, 1e-6))), 0)
    values = " ".join(f"{found[state.column]:+.{decimals}f}" for state in known)
    return f"{values} ±{sigma:.{decimals}f}{_UNITS[known[0].shown_unit]}"
