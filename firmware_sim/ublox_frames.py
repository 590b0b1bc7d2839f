"""UBX frames and the navigation messages of a u-blox receiver, from the interface description's tables.

Source: u-blox F9 HPG 1.32 interface description, UBX-22008968, 3.2 (frames), 3.15 (NAV), 3.17 (SEC).
"""

import struct
import time
from dataclasses import dataclass

from .fixes import Fix
from .sentences import GEOID_SEPARATION_M, SKY

GPS_EPOCH, LEAP_S, WEEK_MS = 315964800.0, 18.0, 604_800_000
_SYNC = b"\xb5\x62"
_UNKNOWN = 0xFFFFFFFF
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Report:
    """What the receiver says at one epoch. fix None: it knows no position. Levels: 0 unknown, 1 none, then worse."""

    utc: float  # s since 1970
    fix: Fix | None
    jamming: int = 1
    spoofing: int = 1
    heading_deg: float | None = None  # of the baseline from a second antenna

    @property
    def itow(self) -> int:
        """GPS time of week, ms."""
        return round((self.utc - GPS_EPOCH + LEAP_S) * 1e3) % WEEK_MS


def frame(group: int, number: int, payload: bytes = b"") -> bytes:
    """A frame with its checksum."""
    body = struct.pack("<BBH", group, number, len(payload)) + payload
    a = b = 0
    for byte in body:
        a = a + byte & 0xFF
        b = b + a & 0xFF
    return _SYNC + body + bytes((a, b))


def _position(fix: Fix) -> Triple:
    """1 sigma north, east, down, m."""
    return fix.sigma_m or (5.0, 5.0, 10.0)


def _velocity(fix: Fix) -> tuple[Triple, Triple]:
    """Velocity NED and its 1 sigma, m/s."""
    if fix.velocity_mps is None:
        raise ValueError("a u-blox receiver reports a velocity in three dimensions")
    return fix.velocity_mps, fix.velocity_sigma_mps or (0.1, 0.1, 0.2)


def _root(*sigmas: float) -> float:
    return float(sum(sigma**2 for sigma in sigmas) ** 0.5)


def pvt(r: Report) -> bytes:
    """NAV-PVT."""
    whole = round(r.utc)
    utc, nano = time.gmtime(whole), round((r.utc - whole) * 1e9)
    clock = struct.pack("<IHBBBBBBIi", r.itow, *utc[:6], 0x07, 25, nano)
    if r.fix is None:
        return frame(
            0x01, 0x07, clock + bytes(4) + struct.pack("<4i2I", 0, 0, 0, -17000, _UNKNOWN, _UNKNOWN) + bytes(44)
        )
    (n, e, d), sigma_v = _velocity(r.fix)
    sigma, height = _position(r.fix), r.fix.height_m
    angles = round(r.fix.lon_deg * 1e7), round(r.fix.lat_deg * 1e7)
    heights = round(height * 1e3), round((height - GEOID_SEPARATION_M) * 1e3)
    accuracy = round(_root(*sigma[:2]) * 1e3), round(sigma[2] * 1e3)
    speeds = [round(v * 1e3) for v in (n, e, d, r.fix.speed_mps or 0.0)]
    course = round((r.fix.course_deg or 0.0) * 1e5)
    payload = clock + struct.pack("<BBBB", 3, 0x01, 0xE0, r.fix.satellites)
    payload += struct.pack("<4i2I", *angles, *heights, *accuracy)
    payload += struct.pack("<5i2IHH", *speeds, course, round(_root(*sigma_v) * 1e3), 200000, round(180 * r.fix.hdop), 0)
    return frame(0x01, 0x07, payload + struct.pack("<IihH", 0, 0, 0, 0))


def covariance(r: Report) -> bytes:
    """NAV-COV: independent errors."""
    if r.fix is None:
        return frame(0x01, 0x36, struct.pack("<IBBB9x12f", r.itow, 0, 0, 0, *[0.0] * 12))
    rows = [
        value for n, e, d in (_position(r.fix), _velocity(r.fix)[1]) for value in (n * n, 0.0, 0.0, e * e, 0.0, d * d)
    ]
    return frame(0x01, 0x36, struct.pack("<IBBB9x12f", r.itow, 0, 1, 1, *rows))


def dop(r: Report) -> bytes:
    """NAV-DOP."""
    hdop = r.fix.hdop if r.fix else 99.99
    values = [min(9999, round(100 * hdop * factor)) for factor in (2.1, 1.8, 1.1, 1.5, 1.0, 0.7, 0.7)]
    return frame(0x01, 0x04, struct.pack("<I7H", r.itow, *values))


def time_utc(r: Report) -> bytes:
    """NAV-TIMEUTC."""
    whole = round(r.utc)
    return frame(
        0x01, 0x21, struct.pack("<IIiHBBBBBB", r.itow, 25, round((r.utc - whole) * 1e9), *time.gmtime(whole)[:6], 0x37)
    )


def status(r: Report) -> bytes:
    """NAV-STATUS."""
    return frame(
        0x01,
        0x03,
        struct.pack("<IBBBBII", r.itow, 3 if r.fix else 0, 0x0D if r.fix else 0x0C, 0, r.spoofing << 3, 2500, 9000),
    )


def relative(r: Report) -> bytes:
    """NAV-RELPOSNED of a moving base one metre away; without a heading: not valid."""
    known = r.heading_deg is not None
    head = struct.pack("<BBHI6i", 1, 0, 0, r.itow, 0, 0, 0, 100 if known else 0, round((r.heading_deg or 0.0) * 1e5), 0)
    sigmas = struct.pack("<4b4II", 0, 0, 0, 0, 100, 100, 100, 100, 60000 if known else 0) + bytes(4)
    return frame(0x01, 0x3C, head + sigmas + struct.pack("<I", 0x137 if known else 0x01))


def satellites(r: Report) -> bytes:
    """NAV-SAT: GPS alone."""
    rows = b""
    for k, (prn, up, around, signal) in enumerate(SKY):
        used = r.fix is not None and k < r.fix.satellites
        rows += struct.pack("<BBBbhhI", 0, prn, signal, up, around, 0, 0x100 | 0x08 * used | 7)
    return frame(0x01, 0x35, struct.pack("<IBBH", r.itow, 1, len(SKY), 0) + rows)


def end(r: Report) -> bytes:
    """NAV-EOE."""
    return frame(0x01, 0x61, struct.pack("<I", r.itow))


def security(r: Report) -> bytes:
    """SEC-SIG, version 2."""
    return frame(0x27, 0x09, bytes((2, 1 | r.jamming << 1 | 1 << 3 | r.spoofing << 4, 0, 0)))


def hardware(r: Report) -> bytes:
    """MON-HW."""
    payload = bytearray(60)
    payload[22] = r.jamming << 2
    return frame(0x0A, 0x09, bytes(payload))
