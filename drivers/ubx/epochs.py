"""An epoch: the messages of one time of week, and the fix that they make together."""

from dataclasses import dataclass, field

from ..fix import Fix, ReceiverStatus
from .messages import Baseline, Content, Covariance, Dop, Kind, Pvt, Utc, day_and_seconds

SPOOFED = 2  # level: several indications


@dataclass
class Epoch:
    """The messages of one time of week."""

    week_ms: int
    arrival_ns: int
    kinds: set[Kind] = field(default_factory=set)
    done: bool = False
    pvt: Pvt | None = None
    covariance: Covariance = field(default_factory=Covariance)
    dop: Dop = field(default_factory=Dop)
    utc: Utc = field(default_factory=Utc)
    baseline: Baseline = field(default_factory=Baseline)

    def add(self, kind: Kind, content: Content) -> None:
        """Add a message; contents that make no fix only count as having come."""
        self.kinds.add(kind)
        match content:
            case Pvt():
                self.pvt = content
            case Covariance():
                self.covariance = content
            case Dop():
                self.dop = content
            case Utc():
                self.utc = content
            case Baseline():
                self.baseline = content

    def status(self, before: ReceiverStatus) -> ReceiverStatus:
        """The receiver's status, with what it last said of interference."""
        assert self.pvt is not None
        return ReceiverStatus(self.pvt.quality, self.pvt.satellites, self.arrival_ns, before.jamming, before.spoofing)

    def fix(self, status: ReceiverStatus) -> Fix:
        """The fix. Without NAV-COV each axis gets the whole horizontal and speed accuracy: rather too large."""
        pvt = self.pvt
        assert pvt is not None
        time = pvt.time or self.utc.time
        day, seconds = day_and_seconds(time) if time else (None, None)
        plane, up, speed = pvt.horizontal_sigma_m, pvt.vertical_sigma_m, pvt.speed_sigma_mps
        sigma = self.covariance.position or (plane, plane, up)
        north, east, down = pvt.velocity_mps
        return Fix(
            arrival_ns=self.arrival_ns,
            utc_s=seconds,
            date=day,
            lat_deg=pvt.lat_deg,
            lon_deg=pvt.lon_deg,
            alt_msl_m=pvt.alt_msl_m,
            geoid_sep_m=pvt.height_m - pvt.alt_msl_m,
            quality=pvt.quality,
            satellites=pvt.satellites,
            hdop=self.dop.hdop,
            speed_mps=pvt.speed_mps,
            course_deg=pvt.course_deg,
            sigma_n_m=sigma[0] or None,
            sigma_e_m=sigma[1] or None,
            sigma_d_m=sigma[2] or None,
            dimensions=pvt.dimensions,
            velocity_mps=(north, east, down if pvt.dimensions > 2 else None),
            velocity_sigma_mps=self.covariance.velocity or (speed, speed, speed),
            heading_deg=self.baseline.heading_deg,
            heading_sigma_deg=self.baseline.heading_sigma_deg,
            spoofed=status.spoofing is not None and status.spoofing >= SPOOFED,
        )
