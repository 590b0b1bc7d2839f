"""The contents of the sentences that the decoder uses, as typed values: `READERS` lists them."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import date

from .sentences import RefusedError, Sentence, angle, calendar, integer, number, quotient, utc_ns

KNOTS, KMH = (1852, 3600), (10, 36)  # to m/s
SPEED_MAX = 4000.0  # knots or km/h
GGA_FIELDS = 12  # at least: up to the geoid's unit; the age of corrections and the station may be missing
UNKNOWN_HDOP = 99.0  # and above: the receiver has no figure
RANKING = (8, 7, 6, 1, 2, 3, 5, 4)  # qualities, the best last
WAAS, DIFFERENTIAL = 9, 2  # NovAtel's code for a differential fix, and the standard's
QUALITY_OF_MODE = {"A": 1, "D": 2, "P": 3, "R": 4, "F": 5, "E": 6, "M": 7, "S": 8, "": 1}


@dataclass(frozen=True)
class GgaGns:
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


@dataclass(frozen=True)
class RmcGllGroup:
    """RMC, GLL."""

    utc_ns: int | None
    date: date | None
    quality: int  # as GGA's, from status and mode
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    step_deg: float = 0.0  # of the last digit of the coarser of the two
    speed_mps: float | None = None
    course_deg: float | None = None


@dataclass(frozen=True)
class Vtg:
    """VTG."""

    speed_mps: float | None
    course_deg: float | None
    utc_ns: int | None = None  # it has none


@dataclass(frozen=True)
class Gst:
    """GST, 1 sigma."""

    utc_ns: int | None
    sigma_n_m: float | None
    sigma_e_m: float | None
    sigma_d_m: float | None


@dataclass(frozen=True)
class Zda:
    """ZDA."""

    utc_ns: int | None
    date: date | None


@dataclass(frozen=True)
class GsaMode:
    """GSA."""

    dimensions: int  # 1: no fix
    utc_ns: int | None = None  # it has none


Content = GgaGns | RmcGllGroup | Vtg | Gst | Zda | GsaMode


def latlon(s: Sentence, first: int) -> tuple[float, float, float]:
    """Latitude, longitude and `step_deg` of four fields; an empty position is rejected, not taken for 0, 0."""
    lat = angle(s.field(first), s.field(first + 1), 2, "NS", 90, "latitude")
    lon = angle(s.field(first + 2), s.field(first + 3), 3, "EW", 180, "longitude")
    if lat is None or lon is None:
        raise RefusedError("position missing")
    digits = min(len(s.field(i).partition(".")[2]) for i in (first, first + 2))
    return lat, lon, 10.0**-digits / 60.0


def metres(s: Sentence, i: int, limit: float, reason: str) -> float | None:
    """Field i, with its unit in the next one."""
    if s.field(i + 1) not in ("M", ""):
        raise RefusedError("unit")
    return number(s.field(i), -limit, limit, reason)


def gga(s: Sentence) -> GgaGns:
    """Time, position, quality, satellites, HDOP, altitude, geoid."""
    time_ns, quality = utc_ns(s.field(1)), integer(s.field(6), WAAS, "quality") or 0
    quality = DIFFERENTIAL if quality == WAAS else quality
    satellites = integer(s.field(7), 999, "satellites")
    if quality == 0:  # the position may be a dummy such as 8960.000000
        return GgaGns(time_ns, 0, satellites)
    if len(s.fields) < GGA_FIELDS:
        raise RefusedError("too short")
    height, geoid = metres(s, 9, 1e6, "altitude"), metres(s, 11, 1e3, "geoid")
    return GgaGns(time_ns, quality, satellites, *latlon(s, 2), height, geoid, hdop(s))


def gns(s: Sentence) -> GgaGns:
    """Time, position, a mode letter for each satellite system, satellites, HDOP, altitude, geoid."""
    time_ns, satellites = utc_ns(s.field(1)), integer(s.field(7), 999, "satellites")
    letters = set(s.field(6)) - {"N"}
    if not letters <= QUALITY_OF_MODE.keys():
        raise RefusedError("mode")
    if not letters:
        return GgaGns(time_ns, 0, satellites)
    quality = max((QUALITY_OF_MODE[letter] for letter in letters), key=RANKING.index)
    height, geoid = number(s.field(9), -1e6, 1e6, "altitude"), number(s.field(10), -1e3, 1e3, "geoid")
    return GgaGns(time_ns, quality, satellites, *latlon(s, 2), height, geoid, hdop(s))


def hdop(s: Sentence) -> float | None:
    """Field 8 of GGA and GNS; 0 and 99.x mean that it is unknown."""
    value = number(s.field(8), 0.0, 1e4, "HDOP")
    return value if value and value < UNKNOWN_HDOP else None


def rmc(s: Sentence) -> RmcGllGroup:
    """Time, status, position, speed, course, date, mode."""
    time_ns, mode = utc_ns(s.field(1)), s.field(12)
    if s.field(2) not in ("A", "V"):
        raise RefusedError("status")
    if s.field(2) == "V" or mode == "N":
        return RmcGllGroup(time_ns, None, 0)
    if mode not in QUALITY_OF_MODE:
        raise RefusedError("mode")
    position = latlon(s, 3)
    speed = speed_mps(s.field(7), KNOTS)
    return RmcGllGroup(time_ns, calendar(s.field(9)), QUALITY_OF_MODE[mode], *position, speed, course(s.field(8)))


def gll(s: Sentence) -> RmcGllGroup:
    """Position, time, status, mode."""
    time_ns, mode = utc_ns(s.field(5)), s.field(7)
    if s.field(6) not in ("A", "V", "N"):  # N: V in some receivers
        raise RefusedError("status")
    if s.field(6) != "A" or mode == "N":
        return RmcGllGroup(time_ns, None, 0)
    if mode not in QUALITY_OF_MODE:
        raise RefusedError("mode")
    return RmcGllGroup(time_ns, None, QUALITY_OF_MODE[mode], *latlon(s, 1))


def vtg(s: Sentence) -> Vtg:
    """Course and speed. Before NMEA 2 there were no unit letters."""
    if len(s.fields) <= 4:
        return Vtg(speed_mps(s.field(4), KMH, s.field(3)), course(s.field(1)))
    if any(s.field(2 * i) not in (unit, "") for i, unit in enumerate("TMNK", start=1)):
        raise RefusedError("unit")
    speed, mode = speed_mps(s.field(7), KMH, s.field(5)), s.field(9)
    if mode not in (*QUALITY_OF_MODE, "N"):
        raise RefusedError("mode")
    return Vtg(None, None) if mode == "N" else Vtg(speed, course(s.field(1)))


def gst(s: Sentence) -> Gst:
    """Standard deviations of latitude, longitude, altitude."""
    sigma = [number(s.field(i), 0.0, 1e7, "sigma") for i in (6, 7, 8)]
    return Gst(utc_ns(s.field(1)), *sigma)


def zda(s: Sentence) -> Zda:
    """Time and date."""
    day, month, year = s.field(2), s.field(3), s.field(4)
    if year and len(year) != 4:
        raise RefusedError("date")
    return Zda(utc_ns(s.field(1)), calendar(day + month + year[2:]))


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
