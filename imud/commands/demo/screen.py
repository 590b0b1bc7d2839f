"""What the demo shows: a table while it runs, the errors at its end."""

import math
import sys
from typing import Any

from .comparison import Comparison

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
_UNITS = {"roll": "deg", "pitch": "deg", "heading": "deg", "position": "m, horizontal", "velocity": "m/s"}


def _screen(est: dict[str, Any], truth: dict[str, float], elapsed_s: float) -> str:
    """The live table."""
    lines = [f"{elapsed_s:7.1f} s   {est.get('state', '')}", f"{'':10}{'truth':>14}{'estimate':>14}{'±1σ':>10}"]
    for name, key, sigma, decimals, unit in _ROWS:
        value, spread = f"{est[key]:.{decimals}f}" if key in est else "-", f"{est[sigma]:.2f}" if sigma in est else "-"
        lines.append(f"{name:10}{truth[key]:14.{decimals}f}{value:>14}{spread:>10}  {unit}")
    return "\n".join(lines)


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
            errors = {name: error for name, error in comparison.errors.items() if math.isfinite(error.last)}
            now = ", ".join(f"{name} {e.last:+.2f} {_UNITS[name].split(',')[0]}" for name, e in errors.items())
            shown = f": error {now}" if now else ""
            print(f"{elapsed_s:6.1f} s  {est.get('state', '')}{shown}", flush=True)


def summary(comparison: Comparison, estimates: int, elapsed_s: float) -> str:
    lines = [
        f"\n{estimates} estimates in {elapsed_s:.1f} s. RMS error against the truth, while claimed valid:",
        f"  {'':10}{'error':>9}{'claimed 1σ':>12}",
    ]
    for name, errors in comparison.errors.items():
        known = f"{errors.rms:9.3f}{errors.claimed_rms:12.3f}  {_UNITS[name]}" if errors.count else f"{'-':>9}{'-':>12}"
        lines.append(f"  {name:10}{known}")
    return "\n".join(lines)
