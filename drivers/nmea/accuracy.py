"""How accurate a receiver says it is, for epochs whose sentences do not say it: GGA, GNS and GST may come more rarely.

Without that a receiver with RMC ten times and GGA once a second would be one of another quality in each second.
"""

from dataclasses import dataclass
from typing import Generic, TypeVar

from .content import GgaGns, Gst
from .epochs import DAY_NS, Epoch

STATED_NS = 2_500_000_000  # for which a statement holds: one a second, of which one is lost
Statement = TypeVar("Statement", GgaGns, Gst)


@dataclass(frozen=True)
class _Stated(Generic[Statement]):
    """A statement, the time of its epoch, and what the epoch's RMC or GLL said of the quality; None: it had neither."""

    sentence: Statement
    utc_ns: int
    quality: int | None

    def holds(self, epoch: Epoch) -> bool:
        """Whether it holds for a later epoch: soon after it, and of the same quality."""
        later = epoch.utc_ns is not None and (epoch.utc_ns - self.utc_ns) % DAY_NS <= STATED_NS
        quality = _quality(epoch)
        return later and (self.quality is None or quality is None or quality == self.quality)


class StatedAccuracy:
    """Takes the epochs in sequence, and completes them. Not thread-safe."""

    def __init__(self) -> None:
        self._gga: _Stated[GgaGns] | None = None
        self._gst: _Stated[Gst] | None = None

    def complete(self, epoch: Epoch) -> None:
        """Add what the receiver has said lately and the epoch does not say. No height: it may have changed."""
        own = epoch.gga or epoch.gns
        if own is None and self._gga is not None and self._gga.holds(epoch):
            epoch.stated = self._gga.sentence._replace(alt_msl_m=None, geoid_sep_m=None)
        changed = own and self._gga and own.quality != self._gga.sentence.quality
        if epoch.gst is None and self._gst is not None and self._gst.holds(epoch) and not changed:
            epoch.stated_gst = self._gst.sentence
        elif epoch.gst is not None and epoch.utc_ns is not None:
            self._gst = _Stated(epoch.gst, epoch.utc_ns, _quality(epoch))
        else:
            self._gst = None
        if own is not None:
            is_timed = own.quality != 0 and epoch.utc_ns is not None
            self._gga = _Stated(own, epoch.utc_ns or 0, _quality(epoch)) if is_timed else None

    def add_late(self, gst: Gst, epoch: Epoch) -> None:
        """Take a GST of an epoch that is complete: it holds for later ones."""
        if epoch.utc_ns is not None:
            self._gst = _Stated(gst, epoch.utc_ns, _quality(epoch))


def _quality(epoch: Epoch) -> int | None:
    other = epoch.rmc or epoch.gll
    return other.quality if other else None
