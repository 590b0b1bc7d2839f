"""NMEA sentences in the style of the San Jose FV-M11: six decimals of minutes, three of metres and knots, talker GP.

Source: the receiver's power-up log (gpsd's regression test mtk-3301), whose lines the tests reproduce.
"""

import time
from dataclasses import dataclass

from .fixes import Fix

GEOID_SEPARATION_M = 36.7  # of Tokyo; the receiver knows one from its table
_KNOT = 1852.0 / 3600.0  # m/s
_NO_POSITION = "8960.000000,N,00000.000000,E"
# PRN, elevation, azimuth in deg, signal to noise in dB: the first eight are used
SKY = [
    (21, 62, 41, 45),
    (28, 55, 200, 47),
    (8, 43, 310, 44),
    (25, 38, 95, 42),
    (7, 31, 251, 40),
    (10, 25, 142, 41),
    (27, 19, 30, 38),
    (15, 14, 283, 36),
    (3, 9, 172, 31),
]
_CHANNELS = 32


@dataclass(frozen=True)
class Epoch:
    """What the receiver reports at one time. fix None: it knows no position; valid: the position may be used."""

    utc: float  # s since 1970, of the receiver's clock
    fix: Fix | None
    valid: bool

    @property
    def time(self) -> str:
        """hhmmss.sss"""
        milliseconds = round(self.utc * 1000.0)
        return time.strftime("%H%M%S", time.gmtime(milliseconds // 1000)) + f".{milliseconds % 1000:03d}"

    @property
    def date(self) -> str:
        """ddmmyy"""
        return time.strftime("%d%m%y", time.gmtime(round(self.utc * 1000.0) // 1000))

    @property
    def position(self) -> str:
        """Latitude, hemisphere, longitude, hemisphere."""
        if self.fix is None:
            return _NO_POSITION
        return f"{_angle(self.fix.lat_deg, 2, 'NS')},{_angle(self.fix.lon_deg, 3, 'EW')}"

    @property
    def speed(self) -> float | None:
        """m/s"""
        return 0.0 if self.fix is None else self.fix.speed_mps

    @property
    def course(self) -> str:
        return _number(0.0 if self.fix is None else self.fix.course_deg, 2)

    @property
    def mode(self) -> str:
        return "A" if self.valid else "N"


def with_checksum(body: str) -> bytes:
    """The sentence with dollar, checksum and line end."""
    checksum = 0
    for byte in body.encode("ascii"):
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode("ascii")


def gga(e: Epoch) -> list[str]:
    satellites, height = (e.fix.satellites, e.fix.height_m) if e.fix else (0, 150.0)
    separation = GEOID_SEPARATION_M if e.fix else 13.0
    hdop = f"{e.fix.hdop:.2f}" if e.fix and e.valid else ""
    altitude = f"{height - separation:.3f},M,{separation:.3f},M"
    return [f"GPGGA,{e.time},{e.position},{e.valid:d},{satellites},{hdop},{altitude},,"]


def rmc(e: Epoch) -> list[str]:
    speed = _number(e.speed, 3, _KNOT)
    return [f"GPRMC,{e.time},{'A' if e.valid else 'V'},{e.position},{speed},{e.course},{e.date},,,{e.mode}"]


def vtg(e: Epoch) -> list[str]:
    return [f"GPVTG,{e.course},T,,M,{_number(e.speed, 3, _KNOT)},N,{_number(e.speed, 3, 1.0 / 3.6)},K,{e.mode}"]


def hdt(e: Epoch) -> list[str]:
    """Of a receiver with two antennas."""
    return [f"GPHDT,{e.fix.heading_deg:.2f},T"] if e.fix and e.fix.heading_deg is not None else []


def gsa(e: Epoch) -> list[str]:
    if e.fix is None or not e.valid:
        return ["GPGSA,A,1" + "," * 15]
    used = [f"{prn:02d}" for prn, *_ in SKY[: e.fix.satellites]]
    hdop = e.fix.hdop
    return [f"GPGSA,A,3,{','.join(used + [''] * (12 - len(used)))},{1.8 * hdop:.2f},{hdop:.2f},{1.5 * hdop:.2f}"]


def gsv(e: Epoch) -> list[str]:
    seen = [
        f"{prn:02d},{up:02d},{round_:03d},{snr}" if e.valid else f"{prn:02d},,,{snr}" for prn, up, round_, snr in SKY
    ]
    groups = [seen[i : i + 4] for i in range(0, len(seen), 4)]
    return [f"GPGSV,{len(groups)},{i},{len(seen):02d},{','.join(group)}" for i, group in enumerate(groups, 1)]


def channels(_: Epoch) -> list[str]:
    """The maker's own: satellite, signal and state of every channel, 205 characters."""
    tracked = {prn: f"{prn:02d}{snr:02d}2" for prn, _, _, snr in SKY}
    searched = [f"{prn:02d}001" for prn in range(1, _CHANNELS + 1) if prn not in tracked]
    return ["PMTKCHN," + ",".join([*tracked.values(), *searched])]


def _angle(deg: float, width: int, hemispheres: str) -> str:
    degrees, millionths = divmod(round(abs(deg) * 60e6), 60_000_000)
    return f"{degrees:0{width}d}{millionths // 1_000_000:02d}.{millionths % 1_000_000:06d},{hemispheres[deg < 0]}"


def _number(value: float | None, decimals: int, unit: float = 1.0) -> str:
    return "" if value is None else f"{value / unit:.{decimals}f}"
