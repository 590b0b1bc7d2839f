"""The contents of the UBX messages that the decoder uses, as typed values in SI units; `READERS` lists them.

Source: u-blox F9 HPG 1.32 interface description, 3.15 (NAV) and 3.17 (SEC); u-blox M8 receiver description, 32.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date, datetime, timedelta

from ..fix import Satellite, Sky

Kind = tuple[int, int]
NAV_STATUS, NAV_DOP, NAV_PVT, NAV_TIMEUTC = (0x01, 0x03), (0x01, 0x04), (0x01, 0x07), (0x01, 0x21)
NAV_SAT, NAV_COV, NAV_RELPOSNED, NAV_EOE = (0x01, 0x35), (0x01, 0x36), (0x01, 0x3C), (0x01, 0x61)
SEC_SIG, MON_HW, MON_VER = (0x27, 0x09), (0x0A, 0x09), (0x0A, 0x04)

NO_FIX, DEAD_RECKONING, TWO_D, THREE_D, COMBINED = range(5)  # fixType; 5 is time alone
DATE_VALID, TIME_VALID, RESOLVED = 1, 2, 4
UTC_VALID = 4
FIX_OK, DIFFERENTIAL = 1, 2
CARRIER_FLOAT, CARRIER_FIXED = 1, 2
POSITION_INVALID = 1
RELATIVE_VALID, MOVING_BASE, BASELINE_HEADING_VALID = 1 << 2, 1 << 5, 1 << 8
QUALITY_OF_CARRIER = {CARRIER_FIXED: 4, CARRIER_FLOAT: 5}
SBAS, GLONASS, SYSTEMS = 1, 6, (0, 1, 2, 3, 5, 6)  # as in `Satellite`; 4 is IMES
SBAS_OFFSET, GLONASS_OFFSET = -87, 64  # to NMEA's numbers
HORIZON_DEG = 90
UNKNOWN_DOP = 99.99


class RefusedError(ValueError):
    """A message that cannot be used; the text is the reason under which it is counted."""


Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Pvt:
    """NAV-PVT: position, velocity, time."""

    time: datetime | None  # UTC to the microsecond; None: not known yet
    quality: int  # as in `Fix`; 0: no fix
    dimensions: int
    satellites: int
    lat_deg: float
    lon_deg: float
    height_m: float
    alt_msl_m: float
    horizontal_sigma_m: float
    vertical_sigma_m: float
    velocity_mps: Triple  # NED
    speed_mps: float
    course_deg: float
    speed_sigma_mps: float
    pdop: float | None


@dataclass(frozen=True)
class Covariance:
    """NAV-COV: 1 sigma of position (m) and velocity (m/s), NED; None: not valid."""

    position: Triple | None = None
    velocity: Triple | None = None


@dataclass(frozen=True)
class Dop:
    """NAV-DOP."""

    hdop: float | None = None
    vdop: float | None = None


@dataclass(frozen=True)
class Utc:
    """NAV-TIMEUTC; None: not known yet."""

    time: datetime | None = None


@dataclass(frozen=True)
class Baseline:
    """NAV-RELPOSNED: true heading from the moving base's antenna to this one; None: not known."""

    heading_deg: float | None = None
    heading_sigma_deg: float | None = None


@dataclass(frozen=True)
class Interference:
    """NAV-STATUS, SEC-SIG, MON-HW: levels as in `ReceiverStatus`; None: not reported here."""

    jamming: int | None = None
    spoofing: int | None = None


Content = Pvt | Covariance | Dop | Utc | Baseline | Interference | Sky | None

_PVT = struct.Struct("<IHBBBBBBIiBBBBiiiiIIiiiiiIIHH")
_SAT = struct.Struct("<BBBbhhI")


def pvt(p: bytes) -> Pvt:
    """Position, velocity, time."""
    values = _PVT.unpack_from(p)
    year, month, day, hour, minute, second, valid, _, nano = values[1:10]
    fix_type, flags, _, satellites, lon, lat, height, alt_msl, horizontal, vertical = values[10:20]
    north, east, down, speed, course, speed_sigma, _, pdop, flags3 = values[20:]
    known = valid & (DATE_VALID | TIME_VALID | RESOLVED) == DATE_VALID | TIME_VALID | RESOLVED
    quality = 0 if flags3 & POSITION_INVALID or not flags & FIX_OK else _quality(fix_type, flags)
    if quality and (abs(lat) > 90 * 10**7 or abs(lon) > 180 * 10**7):
        raise RefusedError("NAV-PVT position")
    return Pvt(
        time=_time(year, month, day, hour, minute, second, nano) if known else None,
        quality=quality,
        dimensions=2 if fix_type == TWO_D else 3,
        satellites=satellites,
        lat_deg=lat / 1e7,
        lon_deg=lon / 1e7,
        height_m=height / 1e3,
        alt_msl_m=alt_msl / 1e3,
        horizontal_sigma_m=horizontal / 1e3,
        vertical_sigma_m=vertical / 1e3,
        velocity_mps=(north / 1e3, east / 1e3, down / 1e3),
        speed_mps=abs(speed) / 1e3,
        course_deg=course / 1e5 % 360.0,
        speed_sigma_mps=speed_sigma / 1e3,
        pdop=_dop(pdop),
    )


def _quality(fix_type: int, flags: int) -> int:
    """As NMEA's GGA."""
    if fix_type == DEAD_RECKONING:
        return 6
    if fix_type not in (TWO_D, THREE_D, COMBINED):
        return 0
    return QUALITY_OF_CARRIER.get(flags >> 6, 2 if flags & DIFFERENTIAL else 1)


def _time(year: int, month: int, day: int, hour: int, minute: int, second: int, nano: int) -> datetime:
    """`nano` may be negative; a leap second is counted into the next minute."""
    try:
        whole = datetime(year, month, day, hour, minute)
    except ValueError:
        raise RefusedError("time") from None
    return whole + timedelta(seconds=second, microseconds=round(nano / 1e3))


def covariance(p: bytes) -> Covariance:
    """The diagonals. (The filter takes the errors along north, east and down as independent.)"""
    values = struct.unpack_from("<12f", p, 16)
    return Covariance(_sigmas(p[5], values[0:6]), _sigmas(p[6], values[6:12]))


def _sigmas(valid: int, matrix: tuple[float, ...]) -> Triple | None:
    """1 sigma NED from NN, NE, ND, EE, ED, DD."""
    north, east, down = matrix[0], matrix[3], matrix[5]
    if not valid or not all(math.isfinite(variance) and variance > 0.0 for variance in (north, east, down)):
        return None
    return math.sqrt(north), math.sqrt(east), math.sqrt(down)


def dop(p: bytes) -> Dop:
    """Dilutions of precision."""
    _, _, _, vertical, horizontal = struct.unpack_from("<5H", p, 4)
    return Dop(_dop(horizontal), _dop(vertical))


def _dop(hundredths: int) -> float | None:
    return hundredths / 100.0 if 0 < hundredths < round(100 * UNKNOWN_DOP) else None


def time_utc(p: bytes) -> Utc:
    """UTC."""
    nano, year, month, day, hour, minute, second, valid = struct.unpack_from("<iHBBBBBB", p, 8)
    return Utc(_time(year, month, day, hour, minute, second, nano) if valid & UTC_VALID else None)


def relative(p: bytes) -> Baseline:
    """The heading of a baseline on the vehicle: of a base that moves, with whole ambiguities."""
    (heading,), (sigma, _, flags) = struct.unpack_from("<i", p, 24), struct.unpack_from("<III", p, 52)
    needed = FIX_OK | RELATIVE_VALID | MOVING_BASE | BASELINE_HEADING_VALID
    if flags & needed != needed or flags >> 3 & 3 != CARRIER_FIXED or not sigma:
        return Baseline()
    return Baseline(heading / 1e5 % 360.0, sigma / 1e5)


def status(p: bytes) -> Interference:
    """Spoofing."""
    return Interference(spoofing=_level(p[7] >> 3 & 3))


def security(p: bytes) -> Interference:
    """Jamming and spoofing, in two versions."""
    if p[0] == 1 and len(p) >= 12:
        return Interference(_level(p[4] >> 1 & 3), _level(p[8] >> 1 & 7))
    if p[0] == 2:
        return Interference(_level(p[1] >> 1 & 3), _level(p[1] >> 4 & 7))
    raise RefusedError("SEC-SIG version")


def hardware(p: bytes) -> Interference:
    """Jamming, as M8 and older report it."""
    return Interference(jamming=_level(p[22] >> 2 & 3))


def _level(state: int) -> int | None:
    """0: unknown; 1: none; then warning and worst."""
    return min(state, 3) - 1 if state else None


def sky(p: bytes) -> Sky:
    """The satellites, in NMEA's numbers."""
    rows = [_SAT.unpack_from(p, at) for at in range(8, min(len(p), 8 + 12 * p[5]) - 11, 12)]
    return Sky(tuple(_satellite(*row) for row in rows if row[0] in SYSTEMS))


def _satellite(system: int, number: int, signal: int, up: int, azimuth: int, _: int, flags: int) -> Satellite:
    offset = {SBAS: SBAS_OFFSET, GLONASS: GLONASS_OFFSET}.get(system, 0)
    known = -HORIZON_DEG <= up <= HORIZON_DEG and 0 <= azimuth <= 360 and flags >> 8 & 7  # else without an orbit
    return Satellite(
        system, number + offset, up if known else None, azimuth if known else None, signal or None, bool(flags & 8)
    )


READERS: dict[Kind, tuple[int, Callable[[bytes], Content]]] = {  # the payload's least length, and its reader
    NAV_PVT: (84, pvt),
    NAV_COV: (64, covariance),
    NAV_DOP: (18, dop),
    NAV_TIMEUTC: (20, time_utc),
    NAV_RELPOSNED: (64, relative),
    NAV_STATUS: (16, status),
    NAV_SAT: (8, sky),
    NAV_EOE: (4, lambda _: None),
    SEC_SIG: (4, security),
    MON_HW: (23, hardware),
}


def content(kind: Kind, payload: bytes) -> Content:
    """The contents of a message that `READERS` has. Raises RefusedError."""
    least, read = READERS[kind]
    if len(payload) < least:
        raise RefusedError("too short")
    return read(payload)


def week_ms(kind: Kind, payload: bytes) -> int | None:
    """GPS time of week of the epoch of a navigation message (iTOW); None: it belongs to no epoch."""
    if kind[0] != NAV_PVT[0]:
        return None
    return int.from_bytes(payload[4:8] if kind == NAV_RELPOSNED else payload[:4], "little")


def day_and_seconds(time: datetime) -> tuple[date, float]:
    """Date, and seconds of that day."""
    return time.date(), (time - datetime(time.year, time.month, time.day)).total_seconds()
