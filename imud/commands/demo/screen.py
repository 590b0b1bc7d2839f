"""What the demo shows: a table while it runs, the errors at its end."""

import math
import sys
from typing import Any

from .comparison import UNITS, Comparison

_FRAME_S = 0.2
_ROWS = (
    ("roll", "roll_deg", "sroll_deg", 2, "deg"),
    ("pitch", "pitch_deg", "spitch_deg", 2, "deg"),
    ("heading", "yaw_deg", "syaw_deg", 2, "deg"),
    ("north", "vn_mps", "svn_mps", 2, "m/s"),
    ("east", "ve_mps", "sve_mps", 2, "m/s"),
    ("down", "vd_mps", "svd_mps", 2, "m/s"),
    ("latitude", "lat_deg", "sn_m", 6, "deg, σ in m"),
    ("longitude", "lon_deg", "se_m", 6, "deg, σ in m"),
)
_MAGNITUDES = ("position", "velocity")  # the length of the error: it has no sign
_COLUMN = 14
_ALWAYS = {"attitude", "heading", "position", "height"}  # words of the state that the columns show


def _screen(est: dict[str, Any], truth: dict[str, float], elapsed_s: float) -> str:
    """The live table."""
    lines = [f"{elapsed_s:7.1f} s   {est.get('state', '')}", f"{'':10}{'truth':>14}{'estimate':>14}{'±1σ':>10}"]
    for name, key, sigma, decimals, unit in _ROWS:
        known = key in est and sigma in est and _is_valid(name, est.get("state", ""))
        value, spread = (f"{est[key]:.{decimals}f}", f"{est[sigma]:.2f}") if known else ("-", "-")
        lines.append(f"{name:10}{truth[key]:14.{decimals}f}{value:>14}{spread:>10}  {unit}")
    return "\n".join(lines)


def _is_valid(name: str, state: str) -> bool:
    """Whether an angle counts for what its row says; the other rows are absent until they do."""
    return "heading" in state if name == "heading" else name not in ("roll", "pitch") or "aligning" not in state


def head() -> str:
    """Above the lines of errors."""
    columns = "".join(f"{f'{name}, {unit}':>{_COLUMN}}" for name, unit in UNITS.items())
    return f"error ±1σ{columns[1:]}"


def line(est: dict[str, Any], comparison: Comparison, elapsed_s: float) -> str:
    """The errors now and the sigmas claimed for them; `-` is not known."""
    columns = ""
    for name, errors in comparison.errors.items():
        sign = "" if name in _MAGNITUDES else "+"
        known = math.isfinite(errors.last)
        columns += f"{f'{errors.last:{sign}.2f} ±{errors.last_claimed:.2f}' if known else '-':>{_COLUMN}}"
    others = [word for word in est.get("state", "").split(",") if word not in _ALWAYS]
    return f"{elapsed_s:6.1f} s{columns}  {', '.join(others)}".rstrip()


class Display:
    """The table, redrawn in place on a terminal; one line per second elsewhere."""

    def __init__(self) -> None:
        self._terminal = sys.stdout.isatty()
        self._due = 0.0
        self._drawn = 0

    def show(self, est: dict[str, Any], truth: dict[str, float], comparison: Comparison, elapsed_s: float) -> None:
        if elapsed_s < self._due:
            return
        self._due = elapsed_s + (_FRAME_S if self._terminal else 1.0)
        if self._terminal:
            text = _screen(est, truth, elapsed_s)
            print(f"\x1b[{self._drawn}A" * bool(self._drawn) + text.replace("\n", "\x1b[K\n") + "\x1b[K", flush=True)
            self._drawn = text.count("\n") + 1
        else:
            new = line(est, comparison, elapsed_s)
            print(new if self._drawn else f"{head()}\n{new}", flush=True)
            self._drawn += 1


def summary(comparison: Comparison, estimates: int, elapsed_s: float) -> str:
    """The errors at the end, and of all the time while the estimates were valid."""
    lines = [
        f"\n{estimates} estimates in {elapsed_s:.1f} s. Errors against the truth while valid, beside the claimed 1σ:",
        f"  {'':10}{'RMS':>9}{'claimed':>10}{'at the end':>13}{'claimed':>10}",
    ]
    for name, errors in comparison.errors.items():
        known = (errors.rms, errors.claimed_rms, errors.last, errors.last_claimed)
        cells = (f"{value:.3f}" if math.isfinite(value) else "-" for value in known)
        lines.append(f"  {name:10}{{:>9}}{{:>10}}{{:>13}}{{:>10}}  {UNITS[name]}".format(*cells))
    return "\n".join(lines)
