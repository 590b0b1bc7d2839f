"""NMEA 0183 receivers of any make: recognised by their sentences; configured only if the user wants that."""

from collections import Counter
from dataclasses import replace
from typing import Literal

from ..dialogue import Dialogue, Exchange
from ..driver import GnssConfigured, Identity, Options, Unsupported
from .content import READERS
from .decoder import NmeaDecoder
from .mtk import is_mtk, speaks_mtk, speed_up
from .readings import READERS as READINGS
from .sentences import RefusedError, Sentence, Splitter

ENOUGH = 2  # checked sentences of any kind; one of a kind that is read is enough, as instruments send single ones
MEDIATEK, UNCHECKED = "MediaTek NMEA receiver", "NMEA receiver without checksums"
RECEIVER, SENSOR = "NMEA receiver", "NMEA sensor without positions"  # a compass, a log, a barometer, a sounder
DEVICE = "NMEA device"  # either
POSITION_KINDS = {"GGA", "GNS", "RMC", "GLL"}
RECEIVER_KINDS = {*READERS, "GSV"}
READ_KINDS = RECEIVER_KINDS | READINGS.keys()
POSITION_S = 2.5  # in which a receiver that also sends what other sensors send sends a position
WITHOUT = "switch them on in the receiver, or accept sentences without them: --set gnss.require_checksum=false"


class Nmea:
    """The driver."""

    name = "nmea"
    bauds = (4800, 9600, 38400, 115200, 57600, 19200)
    timeout_s = 1.3  # a burst a second, a little late
    interrupts = False

    @property
    def kind(self) -> Literal["gnss"]:
        """The kind of device."""
        return "gnss"

    def recognise(self, received: bytes) -> Identity | None:
        """Sentences with the right checksum; without any, positions that lack it."""
        sentences = list(Splitter(Counter()).feed(received, 0))
        kinds = {sentence.kind for sentence in sentences}
        if len(sentences) >= ENOUGH or any(map(_is_read, sentences)):
            model = RECEIVER if RECEIVER_KINDS.intersection(kinds) else DEVICE
            return Identity(self.name, MEDIATEK if speaks_mtk(received) else model)
        unchecked = Splitter(Counter(), unchecked=True).feed(received, 0)
        return Identity(self.name, UNCHECKED) if any(map(_has_position, unchecked)) else None

    def identify(self) -> Dialogue[Identity | None]:
        """Receivers stream by themselves: nothing is queried."""
        yield Exchange()
        return None

    def configure(self, identity: Identity, options: Options) -> Dialogue[GnssConfigured | Unsupported | None]:
        """Leaves the receiver as it is, unless `options.set_up_nmea` is set and it is a MediaTek."""
        yield Exchange()
        if identity.model == UNCHECKED and not options.unchecked:
            return Unsupported(self.name, identity.model, WITHOUT, identity.baud)
        if identity.model == DEVICE:
            received = yield Exchange(listen_s=POSITION_S, enough=_has_position_kind)
            if not _has_position_kind(received):  # else it would keep the place of a receiver on another port
                return GnssConfigured(replace(identity, model=SENSOR), positions=False)
            identity = replace(identity, model=RECEIVER)
        if options.readonly or not options.set_up_nmea or not identity.baud:
            return GnssConfigured(identity)
        if identity.model != MEDIATEK and not (yield from is_mtk(identity.baud)):
            return GnssConfigured(identity, ("not known to be a MediaTek receiver: left as it is",))
        outcome = yield from speed_up(identity.baud, options.fix_rate_hz)
        if outcome.baud is None:
            return None
        warnings = (f"the receiver was not set up: {outcome.problem}",) if outcome.problem else ()
        return GnssConfigured(replace(identity, model=MEDIATEK, baud=outcome.baud), warnings)

    def new_decoder(self, unchecked: bool = False) -> NmeaDecoder:
        """See `GnssDriver`."""
        return NmeaDecoder(unchecked)


def _is_read(sentence: Sentence) -> bool:
    """Whether its kind is one of the standard's that the decoder reads."""
    return sentence.talker != "P" and sentence.kind in READ_KINDS


def _kinds(received: bytes) -> set[str]:
    """The kinds of sentence among the bytes."""
    return {sentence.kind for sentence in Splitter(Counter()).feed(received, 0)}


def _has_position_kind(received: bytes) -> bool:
    """Whether a receiver's sentences are among the bytes, with a fix or not."""
    return bool(_kinds(received) & POSITION_KINDS)


def _has_position(sentence: Sentence) -> bool:
    """Whether it is a valid sentence with a position."""
    try:
        return sentence.kind in POSITION_KINDS and bool(READERS[sentence.kind](sentence))
    except RefusedError:
        return False


DRIVER = Nmea()
