"""The limits of what is shown of sensors and filter: one table for the daemon, the live page, status and report.

A value beyond its limit is a fault in words (`imud_health`, `imud status`, the log) where it says something of a
device, and is marked wherever it is shown.
"""

from typing import NamedTuple

SIGNIFICANT = 3.0  # sigmas by which an uncertain value must be beyond


class Limit(NamedTuple):
    """The range of a healthy value, in the unit that its name ends with."""

    least: float
    most: float
    source: str


LIMITS = {
    "clock_drift_ppm": Limit(-500.0, 500.0, "two quartzes differ by some 200 at most; only where a sensor has one"),
    "clock_residual_us": Limit(0.0, 5e3, "what turns by 30 deg/s turns by 0.15 deg meanwhile"),
    "temperature_c": Limit(-40.0, 85.0, "operating range of all data sheets that the drivers cite"),
    "samples_late_us": Limit(0.0, 100e3, "choice: a tenth of a second is a machine that had no time"),
    "gnss_age_s": Limit(0.0, 3.0, "choice: receivers report each second, or more often"),
    "fix_latency_s": Limit(0.0, 1.0, "choice: receivers need some tenths of a second"),
    "damaged_share": Limit(0.0, 0.01, "choice"),
    "rejected_share": Limit(0.0, 0.05, "choice: gates of 5 sigma let all but one in a million pass"),
    "innovation_ratio": Limit(0.0, 2.0, "chi-square of 32 values over 32, 3.3 sigma"),
}
# which shown quantity a setting judges that refuses a receiver's fixes
BY_SETTING = {"gnss.qualities": "gnss_quality", "gnss.min_satellites": "satellites", "gnss.max_hdop": "hdop"}


def is_beyond(name: str, value: float | None, sigma: float = 0.0) -> bool:
    """Whether the value is outside its range, by more than SIGNIFICANT of its sigmas. What is not known is not."""
    limit = LIMITS[name]
    margin = SIGNIFICANT * sigma
    return value is not None and (value < limit.least - margin or value > limit.most + margin)
