"""The figures of what a filter estimates beside its solution: one of each group, a panel for each kind."""

import numpy as np

from ...figures import Figure, Panel, Trace
from ...filter_state_names import STATES, FilterState
from .session import TIME, Session
from .settled import settled_range

UNITS = {"mps": "m/s", "": "ratio, no unit"}


def filter_states(session: Session) -> list[Figure]:
    """Those of which anything is known."""
    figures = []
    for group in dict.fromkeys(state.group for state in STATES):
        kinds = dict.fromkeys(state.kind for state in STATES if state.group == group)
        panels = [panel for kind in kinds for panel in _panels(session, kind)]
        if panels:
            figures.append(Figure(f"Estimated beside the solution ± σ: {group}", panels, columns=3))
    return figures


def _panels(session: Session, kind: str) -> list[Panel]:
    """One of each part."""
    panels = []
    for state in (state for state in STATES if state.kind == kind):
        if traces := _traces(session, state):
            unit = UNITS.get(state.shown_unit, state.shown_unit)
            panels.append(Panel(state.name.replace("_", " "), TIME, unit, traces, y_range=settled_range(traces)))
    return panels


def _traces(session: Session, state: FilterState) -> list[Trace]:
    """One of each run."""
    traces = []
    for run in session.states:
        y = run.columns.get(state.column)
        if y is not None and np.isfinite(y).any():
            traces.append(Trace(run.name, run.columns["t_s"], y, run.columns.get(f"s{state.column}")))
    return traces
