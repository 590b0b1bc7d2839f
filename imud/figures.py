"""Figures as plain values, and as one self-contained HTML page drawn by plotly (the extra `imud[plots]`).

The page has what plotly's browser library draws from, as JSON. Its Python objects would check each value, and take
longer for that than a report of an hour does for all else.
"""

import base64
import html
import importlib.util
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .math.arrays import Floats

COLOURS = ("#1f83bd", "#d1495b", "#3f8f4d", "#9a68b0", "#b07d12")  # contrast of 3 with white and with BACK_DARK
MOST_POINTS = 4000  # of a curve: a page of some MB, not hundreds
PANEL_PX = 340
PAGE_REM = 84
CONFIG = {"responsive": True, "displayModeBar": False}
BACK_DARK = "#12171c"


def _template(back: str, ink: str, grid: str) -> dict[str, Any]:
    """What all figures of a page share, in plotly's layout."""
    axis = {
        **{"gridcolor": grid, "linecolor": grid, "zerolinecolor": grid, "zerolinewidth": 2},
        **{"automargin": True, "ticks": "", "title": {"standoff": 15}},
    }
    return {
        "layout": {
            **{"font": {"color": ink}, "paper_bgcolor": back, "plot_bgcolor": back, "hovermode": "closest"},
            **{"hoverlabel": {"align": "left"}, "height": PANEL_PX, "bargap": 0.02, "xaxis": axis, "yaxis": axis},
        }
    }


TEMPLATES = _template("white", "#2a3f5f", "#ebf0f8"), _template(BACK_DARK, "#c9d4df", "#2b353f")  # light, dark
SCRIPT = (  # the figures follow the scheme that the browser asks for, also when it changes
    'const dark=matchMedia("(prefers-color-scheme: dark)"),template=()=>templates[+dark.matches],'
    "draw=(at,curves,own)=>Plotly.newPlot(at,curves,{...own,template:template()},config);"
    'dark.addEventListener("change",()=>document.querySelectorAll(".plotly-graph-div").forEach('
    "at=>Plotly.relayout(at,{template:template()})));"
)
STYLE = (
    ":root{color-scheme:light dark;--back:#fff;--ink:#1b2530;--line:#d5dce3}"
    f"@media(prefers-color-scheme:dark){{:root{{--back:{BACK_DARK};--ink:#e6ebf0;--line:#34404b}}}}"
    "html{overflow-y:scroll;background:var(--back)}"  # the width is known before there is more than a screen can show
    f"body{{font:15px/1.45 system-ui,sans-serif;color:var(--ink);max-width:{PAGE_REM}rem;margin:0 auto;padding:.6rem}}"
    "h1{font-size:1.3rem}"
    "h2{font-size:1.05rem;margin:1.4rem 0 .2rem;border-top:1px solid var(--line);padding-top:.6rem}"
    "pre{font:inherit;white-space:pre-wrap;overflow-wrap:anywhere}.grid{display:grid;gap:.3rem}.grid>div{min-width:0}"
    ".table{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums}th{text-align:left}"
    "th,td{padding:.1rem .8rem .1rem 0;vertical-align:top;border-bottom:1px solid var(--line);white-space:pre-wrap}"
    f".plotly-graph-div{{height:{PANEL_PX}px}}"
)


@dataclass(frozen=True)
class Trace:
    """A curve. sigma: its computed standard deviation, drawn as a band of +-sigma about `about` (default: y).

    colour: which of the colours (default: the curve's own); dashed: as what is compared with.
    """

    name: str
    x: Floats
    y: Floats
    sigma: Floats | None = None
    about: Floats | None = None
    style: str = "lines"  # lines, markers, bars
    colour: int | None = None
    dashed: bool = False


@dataclass(frozen=True)
class Panel:
    """One pair of axes. equal: one metre is as long on both; logarithmic: both axes are.

    rungs: words that stand at 0, 1, … instead of numbers on y. y_range: of the axis (default: of all that is drawn).
    """

    title: str
    x: str  # with unit
    y: str
    traces: Sequence[Trace]
    equal: bool = False
    logarithmic: bool = False
    rungs: Sequence[str] = ()
    y_range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Figure:
    """Panels side by side, `columns` in a row."""

    title: str
    panels: Sequence[Panel]
    columns: int = 2


def available() -> bool:
    """Is plotly installed?"""
    return importlib.util.find_spec("plotly") is not None


def plotly_js() -> bytes:
    """plotly's browser library, out of its Python package: no page needs the network."""
    spec = importlib.util.find_spec("plotly")
    assert spec is not None and spec.origin is not None
    return (Path(spec.origin).parent / "package_data/plotly.min.js").read_bytes()


def kept(y: Floats, most: int = MOST_POINTS) -> NDArray[np.int64]:
    """Indices of the points to draw: all of them, or the least and the greatest of each of `most` / 2 equal parts.

    So no spike is lost. Of a part in which nothing is known one point stands for the gap.
    """
    n = len(y)
    if n <= most:
        return np.arange(n)
    size = math.ceil(n / (most // 2))
    padded = np.full(math.ceil(n / size) * size, np.nan)
    padded[:n] = y
    parts = padded.reshape(-1, size)
    first = size * np.arange(len(parts))
    least, greatest = (np.where(np.isnan(parts), side * np.inf, parts) for side in (1.0, -1.0))
    return np.unique(np.concatenate([first + least.argmin(axis=1), first + greatest.argmax(axis=1)]))


def _single(values: Floats) -> dict[str, str]:
    """In single precision, enough for a screen, as plotly reads arrays in JSON."""
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}


def _outline(x: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """The closed outline of what lies between low and high, one for each stretch in which they are known."""
    known = np.isfinite(low) & np.isfinite(high)
    ends = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    xs, ys = [np.empty(0)], [np.empty(0)]
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        forth, back = slice(start, stop), slice(stop - 1, start - 1 if start else None, -1)
        xs += [x[forth], x[back], np.array([np.nan])]
        ys += [high[forth], low[back], np.array([np.nan])]
    return np.concatenate(xs), np.concatenate(ys)


def _band(trace: Trace, colour: str) -> list[dict[str, Any]]:
    """+-sigma as a tinted space."""
    if trace.sigma is None:
        return []
    take = kept(trace.y)
    middle = (trace.y if trace.about is None else trace.about)[take]
    x, y = _outline(trace.x[take], middle - trace.sigma[take], middle + trace.sigma[take])
    tint = f"rgba{(*(int(colour[i : i + 2], 16) for i in (1, 3, 5)), 0.18)}"
    line = {"color": colour, "width": 0.5}
    points = {"type": "scatter", "x": _single(x), "y": _single(y), "mode": "lines", "line": line}
    shared = {"fill": "toself", "fillcolor": tint, "hoverinfo": "skip"}
    return [{**points, "name": f"±σ {trace.name}", "legendgroup": trace.name, **shared}]


def _curve(trace: Trace, colour: str) -> dict[str, Any]:
    take = kept(trace.y)
    points = {"x": _single(trace.x[take]), "y": _single(trace.y[take])}
    named = {"name": trace.name, "legendgroup": trace.name, "showlegend": bool(trace.name)}
    if trace.style == "bars":
        return {"type": "bar", **points, **named, "marker": {"color": colour}, "opacity": 0.6}
    line = {"color": colour, "width": 1.2, "dash": "dash" if trace.dashed else "solid"}
    marker = {"color": colour, "size": 4}
    return {"type": "scatter", **points, **named, "mode": trace.style, "line": line, "marker": marker}


def _curves(panel: Panel) -> list[dict[str, Any]]:
    """plotly's traces: each curve above its band."""
    curves = []
    for k, trace in enumerate(panel.traces):
        colour = COLOURS[(k if trace.colour is None else trace.colour) % len(COLOURS)]
        curves += [*_band(trace, colour), _curve(trace, colour)]
    return curves


def _axes(panel: Panel) -> dict[str, dict[str, Any]]:
    """Of plotly's layout."""
    kind = {"type": "log"} if panel.logarithmic else {}
    x: dict[str, Any] = {"title": {"text": panel.x}, **kind}
    y: dict[str, Any] = {"title": {"text": panel.y}, **kind}
    if panel.rungs:
        y |= {"tickvals": list(range(len(panel.rungs))), "ticktext": list(panel.rungs)}
        y |= {"range": [-0.5, len(panel.rungs) - 0.5]}
    if panel.y_range:
        y |= {"range": panel.y_range}
    if panel.equal:
        y |= {"scaleanchor": "x", "scaleratio": 1}
    return {"xaxis": x, "yaxis": y}


def _layout(panel: Panel) -> dict[str, Any]:
    several = sum(bool(trace.name) for trace in panel.traces) > 1 and not panel.rungs
    top_px = 60 if several else 34
    return {
        "title": {"text": panel.title, "font": {"size": 14}, "x": 0.02, "y": 0.98},
        "margin": {"l": 50, "r": 10, "t": top_px, "b": 40},
        "showlegend": several,
        "legend": {
            **{"groupclick": "togglegroup", "font": {"size": 10}, "orientation": "h"},
            **{"x": 0, "y": 1, "yanchor": "bottom"},
        },
        **_axes(panel),
    }


def _json(value: Any) -> str:
    """Inside of a script, which "<" might end."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def _drawn(panel: Panel) -> str:
    """A place for the panel, and the call that draws it there."""
    call = f"draw(document.currentScript.previousSibling,{_json(_curves(panel))},{_json(_layout(panel))})"
    return f'<div><div class="plotly-graph-div"></div><script>{call}</script></div>'


def _html(figure: Figure) -> str:
    """Panels in as many columns as the screen has room for, at most the figure's."""
    least = f"minmax(min(100%, {PAGE_REM // figure.columns - 4}rem), 1fr)"
    panels = "".join(map(_drawn, figure.panels))
    grid = f'<div class="grid" style="grid-template-columns:repeat(auto-fill, {least})">{panels}</div>'
    return f"<section><h2>{html.escape(figure.title)}</h2>{grid}</section>"


def _table(rows: Sequence[Sequence[str]]) -> str:
    """The first row is the head."""
    head, *body = (
        "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)
        for row, tag in zip(rows, ["th", *["td"] * len(rows)], strict=False)
    )
    lines = "".join(f"<tr>{row}</tr>" for row in body)
    return f'<div class="table"><table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table></div>'


def write(title: str, text: str, figures: Sequence[Figure], path: Path, table: Sequence[Sequence[str]] = ()) -> None:
    """A text, a table and figures as one HTML file that needs nothing else. Raises OSError."""
    constants = f"const templates={_json(TEMPLATES)},config={_json(CONFIG)};"
    head = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width, initial-scale=1"><title>{html.escape(title)}</title><style>{STYLE}</style>'
        "<script>"
    )
    body = f"<h1>{html.escape(title)}</h1><pre>{html.escape(text)}</pre>{_table(table) if table else ''}"
    page = (
        f"</script><script>{constants}{SCRIPT}</script></head><body>{body}{''.join(map(_html, figures))}</body></html>"
    )
    with path.open("wb") as file:  # the library is 5 MB: as bytes it need not be decoded
        file.write(head.encode(errors="replace"))  # the name of a file may be no UTF-8
        file.write(plotly_js())
        file.write(page.encode(errors="replace"))
