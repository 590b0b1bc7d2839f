"""Figures as plain values, and as one self-contained HTML page drawn by plotly (the extra `imud[plots]`)."""

import importlib
import importlib.util
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

COLOURS = ("#0b6fa4", "#d1495b", "#3a7d44", "#8a5a9e", "#b07d12")
MOST_POINTS = 4000  # of a curve: a page of some MB, not hundreds
ROW_PX = 340

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """A curve. sigma: its computed standard deviation, drawn as a band of +-sigma about `about` (default: y)."""

    name: str
    x: Floats
    y: Floats
    sigma: Floats | None = None
    about: Floats | None = None
    style: str = "lines"  # lines, markers, bars


@dataclass(frozen=True)
class Panel:
    """One pair of axes. equal: one metre is as long on both; logarithmic: both axes are."""

    title: str
    x: str  # with unit
    y: str
    traces: Sequence[Trace]
    equal: bool = False
    logarithmic: bool = False


@dataclass(frozen=True)
class Figure:
    """Panels side by side, `columns` in a row."""

    title: str
    panels: Sequence[Panel]
    columns: int = 2


def available() -> bool:
    """Is plotly installed?"""
    return importlib.util.find_spec("plotly") is not None


def plotly_js() -> str:
    """plotly's browser library, out of its Python package: no page needs the network."""
    offline: Any = importlib.import_module("plotly.offline")
    return str(offline.get_plotlyjs())


def _thin(trace: Trace) -> slice:
    return slice(None, None, max(1, math.ceil(len(trace.x) / MOST_POINTS)))


def _band(trace: Trace, colour: str) -> list[dict[str, Any]]:
    """+-sigma as two thin lines with the space between them tinted."""
    if trace.sigma is None:
        return []
    take = _thin(trace)
    middle = (trace.y if trace.about is None else trace.about)[take]
    line = {"color": colour, "width": 0.7, "dash": "dot"}
    shared = {"x": trace.x[take], "mode": "lines", "line": line, "legendgroup": trace.name, "hoverinfo": "skip"}
    fill = {"fill": "tonexty", "fillcolor": f"rgba{(*(int(colour[i : i + 2], 16) for i in (1, 3, 5)), 0.15)}"}
    return [
        {**shared, "y": middle - trace.sigma[take], "showlegend": False},
        {**shared, "y": middle + trace.sigma[take], "name": f"±σ {trace.name}", "showlegend": True, **fill},
    ]


def _curve(go: Any, trace: Trace, colour: str) -> Any:
    take = _thin(trace)
    x, y = trace.x[take], trace.y[take]
    if trace.style == "bars":
        return go.Bar(x=x, y=y, name=trace.name, legendgroup=trace.name, marker_color=colour, opacity=0.6)
    line, marker = {"color": colour, "width": 1.2}, {"color": colour, "size": 4}
    return go.Scatter(x=x, y=y, name=trace.name, mode=trace.style, line=line, marker=marker, legendgroup=trace.name)


def _fill(go: Any, figure: Any, panel: Panel, row: int, column: int) -> None:
    for k, trace in enumerate(panel.traces):
        colour = COLOURS[k % len(COLOURS)]
        for band in _band(trace, colour):
            figure.add_trace(go.Scatter(**band), row=row, col=column)
        figure.add_trace(_curve(go, trace, colour), row=row, col=column)
    figure.update_xaxes(title_text=panel.x, row=row, col=column)
    figure.update_yaxes(title_text=panel.y, row=row, col=column)
    if panel.logarithmic:
        figure.update_xaxes(type="log", row=row, col=column)
        figure.update_yaxes(type="log", row=row, col=column)
    if panel.equal:
        axis = next(figure.select_xaxes(row=row, col=column)).plotly_name.replace("axis", "")
        figure.update_yaxes(scaleanchor=axis, scaleratio=1, row=row, col=column)


def _name_once(drawn: Any) -> None:
    """In the legend one entry for a curve that stands in several panels."""
    seen = set()
    for curve in drawn.data:
        what = curve.name, curve.marker.color or curve.line.color
        curve.showlegend = bool(curve.name) and curve.showlegend is not False and what not in seen
        seen.add(what)


def _draw(figure: Figure) -> Any:
    go: Any = importlib.import_module("plotly.graph_objects")
    subplots: Any = importlib.import_module("plotly.subplots")
    rows = math.ceil(len(figure.panels) / figure.columns)
    drawn = subplots.make_subplots(
        rows, figure.columns, subplot_titles=[p.title for p in figure.panels], vertical_spacing=min(0.3 / rows, 0.12)
    )
    for k, panel in enumerate(figure.panels):
        _fill(go, drawn, panel, k // figure.columns + 1, k % figure.columns + 1)
    _name_once(drawn)
    drawn.update_layout(
        title=figure.title, template="plotly_white", height=ROW_PX * rows + 120, bargap=0.02,
        legend={"groupclick": "togglegroup", "font": {"size": 10}},
    )  # fmt: skip
    return drawn


def write(title: str, text: str, figures: Sequence[Figure], path: Path) -> None:
    """A text and figures as one HTML file that needs nothing else. Raises OSError."""
    shown = text.replace("&", "&amp;").replace("<", "&lt;")
    drawn = [_draw(figure).to_html(full_html=False, include_plotlyjs=k == 0) for k, figure in enumerate(figures)]
    head = f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title></head>'
    said = f'<pre style="white-space:pre-wrap">{shown}</pre>'
    body = f'<body style="font-family:sans-serif;margin:1.5em">{said}{"".join(drawn)}</body></html>'
    path.write_text(head + body, encoding="utf-8")
