"""What a sensor reports beside samples and fixes. Values only, frozen; unknown is NaN, as in the records."""

from math import isnan, nan
from typing import NamedTuple

from imud.drivers.fix import Fix, Sky

NO_VECTOR = (nan, nan, nan)


class ReceiverReport(NamedTuple):
    """What the receiver said, with its last fix or since, or before its first one, that the solution does not hold."""

    satellites: int | None = None  # in use
    hdop: float = nan
    quality: int | None = None  # as NMEA GGA
    alt_msl: float = nan  # m
    geoid_sep: float = nan  # m, geoid above ellipsoid
    age_s: float = nan  # since the fix
    sky: Sky = Sky()
    fix: bytes = b""  # the last one that was used: a row of FIX; empty: there was none
    reported: Fix | None = None  # the same, as the receiver reported it

    @property
    def height_is_msl(self) -> bool:
        """Whether the height of its fixes, and so the filter's, is above sea level: it does not report the geoid."""
        return isnan(self.geoid_sep) and not isnan(self.alt_msl)


class ClockFit(NamedTuple):
    """How well the counter of the inertial sensor fits the host's time."""

    residual_s: float = nan  # median distance of the earliest arrivals from the line
    drift: float = nan  # of the sensor's clock against the host's, positive when slow; dimensionless
    sigma_drift: float = nan  # 1 sigma by the scatter of the arrivals alone
