"""The contents of the sentences that the decoder uses, as typed values: `READERS` lists them."""

from collections.abc import Callable
from datetime import date
from functools import lru_cache
from typing import NamedTuple

from .sentences import RefusedError, Sentence, angle, calendar, integer, number, quotient, utc_ns

KNOTS, KMH = (1852, 3600), (10, 36)  # to m/s
SPEED_MAX = 4000.0  # knots or km/h
GGA_FIELDS = 12  # at least: up to the geoid's unit; the age of corrections and the station may be missing
UNKNOWN_HDOP = 99.0  # and above: the receiver has no figure
RANKING = (8, 7, 6, 1, 2, 3, 5, 4)  # qualities, the best last
WAAS, DIFFERENTIAL = 9, 2  # NovAtel's code for a differential fix, and the standard's
QUALITY_OF_MODE = {"A": 1, "D": 2, "P": 3, "R": 4, "F": 5, "E": 6, "M": 7, "S": 8, "": 1}


class GgaGns(NamedTuple):
    """GGA, GNS."""

    utc_ns: int | None
    quality: int  # 0: no fix, and the fields below mean nothing
    satellites: int | None
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    step_deg: float = 0.0  # of the last digit of the coarser of the two
    alt_msl_m: float | None = None
    geoid_sep_m: float | None = None
    hdop: float | None = None


class RmcGllGroup(NamedTuple):
    """RMC, GLL."""

    utc_ns: int | None
    date: date | None
    quality: int  # as GGA's, from status and mode
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    step_deg: float = 0.0  # of the last digit of the coarser of the two
    speed_mps: float | None = None
    course_deg: float | None = None


class Vtg(NamedTuple):
    """VTG."""

    speed_mps: float | None
    course_deg: float | None
    utc_ns: int | None = None  # it has none


class Gst(NamedTuple):
    """GST, 1 sigma."""

    utc_ns: int | None
    sigma_n_m: float | None
    sigma_e_m: float | None
    sigma_d_m: float | None


class Zda(NamedTuple):
    """ZDA."""

    utc_ns: int | None
    date: date | None


class GsaMode(NamedTuple):
    """GSA."""

    dimensions: int  # 1: no fix
    utc_ns: int | None = None  # it has none


Content = GgaGns | RmcGllGroup | Vtg | Gst | Zda | GsaMode


@lru_cache(maxsize=1)
def latlon(lat: str, ns: str, lon: str, ew: str) -> tuple[float, float, float]:
    """Latitude, longitude and `step_deg` of four fields; an empty position is rejected, not taken for 0, 0.

    The sentences of an epoch repeat them.
    """
    north = angle(lat, ns, 2, "NS", 90, "latitude")
    east = angle(lon, ew, 3, "EW", 180, "longitude")
    if north is None or east is None:
        raise RefusedError("position missing")
    digits = min(len(lat.partition(".")[2]), len(lon.partition(".")[2]))
    return north, east, 10.0**-digits / 60.0


def metres(text: str, unit: str, limit: float, reason: str) -> float | None:
    """A field with its unit."""
    if unit not in ("M", ""):
        raise RefusedError("unit")
    return number(text, -limit, limit, reason)


def gga(s: Sentence) -> GgaGns:
    """Time, position, quality, satellites, HDOP, altitude, geoid."""
    time, lat, ns, lon, ew, kind, count, dop, height, height_unit, geoid, geoid_unit = s.first(GGA_FIELDS)
    time_ns, quality = utc_ns(time), integer(kind, WAAS, "quality") or 0
    quality = DIFFERENTIAL if quality == WAAS else quality
    satellites = integer(count, 999, "satellites")
    if quality == 0:  # the position may be a dummy such as 8960.000000
        return GgaGns(time_ns, 0, satellites)
    if len(s.fields) < GGA_FIELDS:
        raise RefusedError("too short")
    heights = metres(height, height_unit, 1e6, "altitude"), metres(geoid, geoid_unit, 1e3, "geoid")
    return GgaGns(time_ns, quality, satellites, *latlon(lat, ns, lon, ew), *heights, hdop(dop))


def gns(s: Sentence) -> GgaGns:
    """Time, position, a mode letter for each satellite system, satellites, HDOP, altitude, geoid."""
    time, lat, ns, lon, ew, modes, count, dop, height, geoid = s.first(10)
    time_ns, satellites = utc_ns(time), integer(count, 999, "satellites")
    letters = set(modes) - {"N"}
    if not letters <= QUALITY_OF_MODE.keys():
        raise RefusedError("mode")
    if not letters:
        return GgaGns(time_ns, 0, satellites)
    quality = max((QUALITY_OF_MODE[letter] for letter in letters), key=RANKING.index)
    heights = number(height, -1e6, 1e6, "altitude"), number(geoid, -1e3, 1e3, "geoid")
    return GgaGns(time_ns, quality, satellites, *latlon(lat, ns, lon, ew), *heights, hdop(dop))


def hdop(text: str) -> float | None:
    """0 and 99.x mean that it is unknown."""
    value = number(text, 0.0, 1e4, "HDOP")
    return value if value and value < UNKNOWN_HDOP else None


def rmc(s: Sentence) -> RmcGllGroup:
    """Time, status, position, speed, course, date, mode."""
    time, status, lat, ns, lon, ew, knots, track, day, _, _, mode = s.first(12)
    time_ns = utc_ns(time)
    if status not in ("A", "V"):
        raise RefusedError("status")
    if status == "V" or mode == "N":
        return RmcGllGroup(time_ns, None, 0)
    if mode not in QUALITY_OF_MODE:
        raise RefusedError("mode")
    position = latlon(lat, ns, lon, ew)
    speed = speed_mps(knots, KNOTS)
    return RmcGllGroup(time_ns, _date_if_any(day), QUALITY_OF_MODE[mode], *position, speed, course(track))


def _date_if_any(text: str) -> date | None:
    """The date; None for what is none, such as 2208-1: week numbers roll over, which makes no position wrong."""
    try:
        return calendar(text)
    except RefusedError:
        return None


def gll(s: Sentence) -> RmcGllGroup:
    """Position, time, status, mode."""
    lat, ns, lon, ew, time, status, mode = s.first(7)
    time_ns = utc_ns(time)
    if status not in ("A", "V", "N"):  # N: V in some receivers
        raise RefusedError("status")
    if status != "A" or mode == "N":
        return RmcGllGroup(time_ns, None, 0)
    if mode not in QUALITY_OF_MODE:
        raise RefusedError("mode")
    return RmcGllGroup(time_ns, None, QUALITY_OF_MODE[mode], *latlon(lat, ns, lon, ew))


def vtg(s: Sentence) -> Vtg:
    """Course and speed. Before NMEA 2 there were no unit letters."""
    if len(s.fields) <= 4:
        track, _, knots, kmh = s.first(4)
        return Vtg(speed_mps(kmh, KMH, knots), course(track))
    track, true, _, magnetic, knots, knots_unit, kmh, kmh_unit, mode = s.first(9)
    if true not in ("T", "") or magnetic not in ("M", "") or knots_unit not in ("N", "") or kmh_unit not in ("K", ""):
        raise RefusedError("unit")
    speed = speed_mps(kmh, KMH, knots)
    if mode not in QUALITY_OF_MODE and mode != "N":
        raise RefusedError("mode")
    return Vtg(None, None) if mode == "N" else Vtg(speed, course(track))


def gst(s: Sentence) -> Gst:
    """Standard deviations of latitude, longitude, altitude."""
    time, _, _, _, _, *sigmas = s.first(8)
    north, east, down = (number(sigma, 0.0, 1e7, "sigma") for sigma in sigmas)
    return Gst(utc_ns(time), north, east, down)


def zda(s: Sentence) -> Zda:
    """Time and date."""
    time, day, month, year = s.first(4)
    if year and len(year) != 4:
        raise RefusedError("date")
    return Zda(utc_ns(time), calendar(day + month + year[2:]))


def gsa(s: Sentence) -> GsaMode:
    """The fix mode; `sky.py` reads the satellites."""
    if s.field(2) not in ("1", "2", "3"):
        raise RefusedError("dimensions")
    return GsaMode(int(s.field(2)))


def speed_mps(text: str, unit: tuple[int, int], knots: str = "") -> float | None:
    """A speed in `unit`, or else in knots."""
    if not text:
        return speed_mps(knots, KNOTS) if knots else None
    number(text, 0.0, SPEED_MAX, "speed")
    return quotient(text, *unit)


def course(text: str) -> float | None:
    """Degrees from true north, in [0, 360)."""
    value = number(text, 0.0, 360.0, "course")
    return None if value is None else value % 360.0


READERS: dict[str, Callable[[Sentence], Content]] = {
    "GGA": gga,
    "GNS": gns,
    "RMC": rmc,
    "GLL": gll,
    "VTG": vtg,
    "GST": gst,
    "ZDA": zda,
    "GSA": gsa,
}
