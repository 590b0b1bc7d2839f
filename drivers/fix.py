"""The position fix as a receiver reports it: degrees, metres, seconds; None: not reported."""

from datetime import date
from typing import NamedTuple

_EPOCH, _DAY_S = date(1970, 1, 1).toordinal(), 86_400


class Fix(NamedTuple):
    """One epoch of a receiver that had a solution."""

    arrival_ns: int  # monotonic, of the epoch's first byte
    utc_s: float | None  # seconds of the UTC day
    date: date | None
    lat_deg: float  # WGS-84
    lon_deg: float
    alt_msl_m: float | None
    geoid_sep_m: float | None  # geoid above the ellipsoid
    quality: (
        int  # as NMEA GGA: 1 GPS, 2 differential, 3 PPS, 4 RTK, 5 float RTK, 6 dead reckoning, 7 manual, 8 simulator
    )
    satellites: int | None  # in use
    hdop: float | None
    speed_mps: float | None  # over ground
    course_deg: float | None  # over ground, from true north
    step_deg: float = 0.0  # latitude and longitude are rounded to it; 0: to less than matters
    sigma_n_m: float | None = None
    sigma_e_m: float | None = None
    sigma_d_m: float | None = None
    dimensions: int | None = None  # 2: the receiver holds the height and solves for the rest; 3; None: not reported
    velocity_mps: tuple[float, float, float | None] | None = None  # NED
    velocity_sigma_mps: tuple[float, float, float] | None = None
    heading_deg: float | None = None  # true, of the baseline of two antennas on the vehicle
    heading_sigma_deg: float | None = None
    spoofed: bool = False  # the receiver has several indications that the signals are forged

    def utc_ns(self, near_ns: int) -> int | None:
        """Unix time by the receiver's own clock. near_ns: about when; without a date it is the nearest day."""
        if self.utc_s is None:
            return None
        day = self.date.toordinal() - _EPOCH if self.date else round((near_ns * 1e-9 - self.utc_s) / _DAY_S)
        return day * _DAY_S * 1_000_000_000 + round(self.utc_s * 1e9)

    @property
    def height_m(self) -> float | None:
        """Height above the ellipsoid."""
        if self.alt_msl_m is None or self.geoid_sep_m is None:
            return None
        return self.alt_msl_m + self.geoid_sep_m


class Reading(NamedTuple):
    """What a receiver, or another sensor that speaks its protocol, reports beside fixes.

    source: `heading` (deg from true north), `speed` (over ground, along the vehicle, m/s, below zero astern),
    `water speed` (the same through the water), `pressure` (of the air, Pa).
    """

    source: str
    arrival_ns: int  # monotonic, of its message
    utc_s: float | None  # seconds of the UTC day; None: its time is not known
    value: float
    sigma: float | None = None  # in the same unit; None: not known


class Satellite(NamedTuple):
    """A satellite in view. None: the receiver did not report it."""

    system: int  # 0 GPS, 1 SBAS, 2 Galileo, 3 BeiDou, 5 QZSS, 6 GLONASS
    number: int  # in the receiver's numbering
    elevation_deg: int | None
    azimuth_deg: int | None
    signal_dbhz: int | None
    used: bool


class Sky(NamedTuple):
    """The receiver's last report of the satellites."""

    satellites: tuple[Satellite, ...] = ()
    pdop: float | None = None
    vdop: float | None = None
    arrival_ns: int | None = None  # monotonic, of the last list of satellites; None: not known
    dops_arrival_ns: int | None = None  # the same of the dilutions; None: they are those of the last fix


class ReceiverStatus(NamedTuple):
    """The receiver's last report of itself, also without a fix."""

    quality: int = 0  # as in `Fix`; 0: no fix
    satellites: int | None = None
    arrival_ns: int = 0  # 0: no message received yet
    jamming: int | None = None  # 0: none; 1: some, but there is a fix; 2: no fix because of it; None: not reported
    spoofing: int | None = None  # 0: none; 1: an indication; 2: several
