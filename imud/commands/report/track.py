"""The track on a plane and its height: estimates with their ellipses, and fixes."""

import math
from collections.abc import Callable

import numpy as np

from ...compile.jit import interpreted
from ...figures import Figure, Panel, Trace
from ...math.arrays import Floats
from ...math.earth import radii
from .session import TIME, Fixes, Session

RADIUS_95 = math.sqrt(-2.0 * math.log(0.05))  # of a plane normal distribution, in sigmas
ELLIPSES = 40  # along the track


def _origin(session: Session) -> tuple[float, float] | None:
    """Latitude and longitude in degrees of the first position known."""
    for e in session.estimates:
        known = np.flatnonzero(np.isfinite(e.columns["lat_deg"]))
        if len(known):
            return float(e.columns["lat_deg"][known[0]]), float(e.columns["lon_deg"][known[0]])
    for fixes in session.fixes:
        if len(fixes.rows):
            return math.degrees(fixes.rows["lat"][0]), math.degrees(fixes.rows["lon"][0])
    return None


def _grid(lat_deg: float, lon_deg: float) -> Callable[[Floats, Floats], tuple[Floats, Floats]]:
    """From degrees to metres (north, east) of the plane that touches the ellipsoid there."""
    lat = math.radians(lat_deg)
    meridian, normal = interpreted(radii)(lat)

    def metres(lats: Floats, lons: Floats) -> tuple[Floats, Floats]:
        turned = np.mod(lons - lon_deg + 180.0, 360.0) - 180.0
        return np.radians(lats - lat_deg) * meridian, np.radians(turned) * normal * math.cos(lat)

    return metres


def _ellipses(north: Floats, east: Floats, sn: Floats, se: Floats) -> tuple[Floats, Floats]:
    """Outlines (north, east) of the 95 % ellipses about some of the points, with axes along north and east."""
    known = np.flatnonzero(np.isfinite(north) & np.isfinite(sn))
    chosen = known[:: max(1, len(known) // ELLIPSES)]
    turn = np.append(np.linspace(0.0, 2.0 * np.pi, 37), np.nan)
    n = north[chosen, None] + RADIUS_95 * sn[chosen, None] * np.cos(turn)
    e = east[chosen, None] + RADIUS_95 * se[chosen, None] * np.sin(turn)
    return n.ravel(), e.ravel()


def track(session: Session) -> Figure | None:
    """Plan in metres about the first position known, and heights; None: no position is."""
    origin = _origin(session)
    if origin is None:
        return None
    metres = _grid(*origin)
    plan, ellipses, heights = [], [], []
    for e in session.estimates:
        c = e.columns
        if not np.isfinite(c["lat_deg"]).any():
            continue
        north, east = metres(c["lat_deg"], c["lon_deg"])
        plan.append(Trace(e.name, east, north))
        n, e95 = _ellipses(north, east, c["sn_m"], c["se_m"])
        ellipses.append(Trace(f"{e.name}: 95 % ellipses", e95, n))
        heights.append(Trace(e.name, c["t_s"], c["height_m"], c["sd_m"]))
    for fixes in session.fixes:
        north, east = metres(np.degrees(fixes.rows["lat"]), np.degrees(fixes.rows["lon"]))
        plan.append(Trace(f"{fixes.name}: fixes", east, north, style="markers"))
        heights.append(Trace(f"{fixes.name}: fixes", epochs(fixes), fixes.rows["height"], style="markers"))
    return Figure(
        f"Track about {origin[0]:.6f}°, {origin[1]:.6f}°",
        [
            Panel("Plan", "east, m", "north, m", [*plan, *ellipses], equal=True),
            Panel("Height", TIME, "m above the ellipsoid", heights),
        ],
    )


def epochs(fixes: Fixes) -> Floats:
    """Their times on the session's axis, s."""
    return np.asarray(fixes.rows["t_ns"] * 1e-9)
