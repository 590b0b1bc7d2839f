"""An epoch: the sentences of one burst, and the fix that they make together."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..fix import Fix, ReceiverStatus
from .content import Content, GgaGns, Gst, RmcGllGroup, Vtg, Zda

SAME_NS = 10_000_000  # receivers truncate the time of one epoch to 2 decimals here and to 3 there; two at 100 Hz
DAY_NS = 86_400_000_000_000
FAR_DEG = 1e-3  # sentences of one epoch further apart than that contradict each other
ROUNDING_MPS = 0.15  # speeds in RMC and VTG of one epoch differ by less


def same_time(a_ns: int | None, b_ns: int | None) -> bool:
    """Whether both are known and name one epoch."""
    return a_ns is not None and b_ns is not None and abs(a_ns - b_ns) < SAME_NS


@dataclass
class Epoch:
    """The sentences of one burst. `open_time`: it began with one that has no time; the next one may give it its own."""

    arrival_ns: int
    open_time: bool = False
    utc_ns: int | None = None
    last: str = ""
    done: bool = False
    ended_by_silence: bool = False
    gga: GgaGns | None = None
    gns: GgaGns | None = None
    rmc: RmcGllGroup | None = None
    gll: RmcGllGroup | None = None
    vtg: Vtg | None = None
    gst: Gst | None = None
    zda: Zda | None = None
    stated: GgaGns | None = None  # quality, satellites and HDOP by an earlier GGA or GNS, where this burst has none
    stated_gst: Gst | None = None  # the same of the sigmas

    def has(self, kind: str) -> bool:
        """Whether a sentence of this kind came already."""
        return getattr(self, kind.lower()) is not None

    def lacks_fix(self, kind: str) -> bool:
        """Whether the sentence of this kind says that there is no fix, and another one may still say more."""
        before = getattr(self, kind.lower())
        return not self.done and before is not None and before.quality == 0

    def fits(self, kind: str, utc_ns: int | None) -> bool:
        """Whether a sentence may be of this burst: its kind is missing, and nothing is against its time."""
        if self.has(kind):
            return False
        return (
            utc_ns is None
            or same_time(utc_ns, self.utc_ns)
            or (self.utc_ns is None and self.open_time and not self.done)
        )

    def can_do_without(self, kind: str) -> bool:
        """Whether one more of a kind that came lately adds nothing: sigmas hold for a time, RMC has all else."""
        if kind == "VTG":
            return self.rmc is not None and self.rmc.speed_mps is not None
        return kind == "GST" or (kind == "ZDA" and self.rmc is not None)

    def add(self, kind: str, content: Content) -> None:
        """Add a sentence."""
        setattr(self, kind.lower(), content)
        self.last = kind
        if content.utc_ns is not None and (self.utc_ns is None or kind == "GGA"):
            self.utc_ns = content.utc_ns

    def status(self) -> ReceiverStatus | None:
        """The receiver's status; None: unknown. Where GGA and RMC are there, both must be valid."""
        first, other = (self.gga, self.rmc) if self.gga or self.rmc else (self.gns, self.gll)
        named = first or other
        if named is None:
            return None
        is_valid = named.quality != 0 and (other is None or other.quality != 0)
        quality = (self.stated or named).quality if is_valid else 0
        satellites = self._satellites() if quality else (self.gga or self.gns or GgaGns(None, 0, None)).satellites
        return ReceiverStatus(quality, satellites, self.arrival_ns)

    def _satellites(self) -> int | None:
        """In use. 0 in GGA with a fix, as of some receivers, means unknown."""
        sources = (self.gga, self.gns, self.stated)
        return next((source.satellites for source in sources if source and source.satellites), None)

    def positions(self) -> list[GgaGns | RmcGllGroup]:
        """The sentences with a position, the richest first."""
        return [sentence for sentence in (self.gga, self.gns, self.rmc, self.gll) if sentence and sentence.quality]

    def vtg_agrees(self) -> bool | None:
        """Whether VTG gives the speed of RMC; None if one of them does not give any."""
        rmc, vtg = self.rmc and self.rmc.speed_mps, self.vtg and self.vtg.speed_mps
        return None if rmc is None or vtg is None else abs(rmc - vtg) < ROUNDING_MPS

    def fix(
        self, position: GgaGns | RmcGllGroup, status: ReceiverStatus, dimensions: int | None, with_vtg: bool
    ) -> Fix:
        """The burst as a fix; position: the sentence with which it is."""
        # RMC's time says to which position its speed belongs; of VTG only its order in the burst is known.
        motion = self.rmc if self.rmc and self.rmc.speed_mps is not None else self.vtg if with_vtg else None
        dated = self.rmc or self.zda
        height = self.gga or self.gns or self.stated or GgaGns(None, status.quality, None)
        gst = self.gst or self.stated_gst or Gst(None, None, None, None)
        return Fix(
            arrival_ns=self.arrival_ns,
            utc_s=None if self.utc_ns is None else self.utc_ns / 1e9,
            date=dated.date if dated else None,
            lat_deg=position.lat_deg,
            lon_deg=position.lon_deg,
            step_deg=position.step_deg,
            alt_msl_m=height.alt_msl_m,
            geoid_sep_m=height.geoid_sep_m,
            quality=status.quality,
            satellites=status.satellites,
            hdop=height.hdop,
            speed_mps=motion.speed_mps if motion else None,
            course_deg=motion.course_deg if motion else None,
            sigma_n_m=gst.sigma_n_m,
            sigma_e_m=gst.sigma_e_m,
            sigma_d_m=gst.sigma_d_m,
            dimensions=dimensions,
        )


def contradictory(positions: Sequence[GgaGns | RmcGllGroup]) -> bool:
    """Whether they are different."""
    return any(_separation_deg(positions[0], other) > FAR_DEG for other in positions[1:])


def _separation_deg(a: GgaGns | RmcGllGroup, b: GgaGns | RmcGllGroup) -> float:
    """The larger of the distances north and east, in degrees of latitude."""
    east = (a.lon_deg - b.lon_deg + 180.0) % 360.0 - 180.0
    return max(abs(a.lat_deg - b.lat_deg), abs(east) * math.cos(math.radians(a.lat_deg)))
