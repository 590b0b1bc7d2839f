"""NMEA 0183 receivers, of any make: recognised by what they say; written to only if the user wants that."""

from collections import Counter
from dataclasses import replace
from typing import Literal

from ..dialogue import Dialogue, Exchange
from ..driver import GnssConfigured, Identity, Options
from .decoder import NmeaDecoder
from .mtk import is_mtk, speaks_mtk, speed_up
from .sentences import Splitter

ENOUGH = 2  # checked sentences; one of a kind that only receivers send will do
MEDIATEK = "MediaTek NMEA receiver"
TELLING = {"GGA", "GNS", "RMC"}


class Nmea:
    """The driver."""

    name = "nmea"
    bauds = (4800, 9600, 38400, 115200, 57600, 19200)
    patience_s = 1.3  # a burst a second, a little late
    interrupts = False

    @property
    def kind(self) -> Literal["gnss"]:
        """The kind of device."""
        return "gnss"

    def recognise(self, heard: bytes) -> Identity | None:
        """Sentences with the right checksum."""
        sentences = list(Splitter(Counter()).feed(heard, 0))
        if len(sentences) < ENOUGH and not any(sentence.kind in TELLING for sentence in sentences):
            return None
        return Identity(self.name, MEDIATEK if speaks_mtk(heard) else "NMEA receiver")

    def identify(self) -> Dialogue[Identity | None]:
        """Receivers speak by themselves: nothing is asked."""
        yield Exchange()
        return None

    def configure(self, identity: Identity, options: Options) -> Dialogue[GnssConfigured | None]:
        """Takes the receiver as it is, unless `options.fix_rate_hz` says otherwise and it is a MediaTek."""
        yield Exchange()
        if options.readonly or not options.fix_rate_hz or not identity.baud:
            return GnssConfigured(identity)
        if identity.model != MEDIATEK and not (yield from is_mtk(identity.baud)):
            return GnssConfigured(identity, ("not known to be a MediaTek receiver: left as it is",))
        outcome = yield from speed_up(identity.baud, options.fix_rate_hz)
        if outcome.baud is None:
            return None
        warnings = (f"the receiver was not set up: {outcome.problem}",) if outcome.problem else ()
        return GnssConfigured(replace(identity, model=MEDIATEK, baud=outcome.baud), warnings)

    def new_decoder(self) -> NmeaDecoder:
        """See `GnssDriver`."""
        return NmeaDecoder()


DRIVER = Nmea()
