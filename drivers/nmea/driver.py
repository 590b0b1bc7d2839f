"""NMEA 0183 receivers, of any make: recognised by what they say, and only listened to."""

from collections import Counter
from typing import Literal

from ..dialogue import Dialogue, Exchange
from ..driver import GnssConfigured, Identity, Options
from .decoder import NmeaDecoder
from .sentences import Splitter

ENOUGH = 2  # checked sentences; one of a kind that only receivers send will do
TELLING = {"GGA", "GNS", "RMC"}


class Nmea:
    """The driver."""

    name = "nmea"
    bauds = (4800, 9600, 38400, 115200, 57600, 19200)
    patience_s = 1.3  # a burst a second, a little late

    @property
    def kind(self) -> Literal["gnss"]:
        """The kind of device."""
        return "gnss"

    def recognise(self, heard: bytes) -> Identity | None:
        """Sentences with the right checksum."""
        sentences = list(Splitter(Counter()).feed(heard, 0))
        if len(sentences) < ENOUGH and not any(sentence.kind in TELLING for sentence in sentences):
            return None
        mediatek = any(sentence.talker == "P" and sentence.kind.startswith("MTK") for sentence in sentences)
        return Identity(self.name, "MediaTek NMEA receiver" if mediatek else "NMEA receiver")

    def identify(self) -> Dialogue[Identity | None]:
        """Receivers speak by themselves: nothing is asked."""
        yield Exchange()
        return None

    def configure(self, identity: Identity, options: Options) -> Dialogue[GnssConfigured | None]:
        """Takes the receiver as it is."""
        yield Exchange()
        return GnssConfigured(identity)

    def new_decoder(self) -> NmeaDecoder:
        """See `GnssDriver`."""
        return NmeaDecoder()


DRIVER = Nmea()
