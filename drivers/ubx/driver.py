"""u-blox receivers in their own protocol, from generation 7 on: velocity in three dimensions, and the errors of a fix.

A receiver that sends UBX is recognised, and set up unless its port is readonly. One that sends NMEA alone, as from the
factory, is left to the driver `nmea`, and so is one whose UBX is without fixes (raw measurements) and that does not
answer; it is asked and set up if the user names this driver: `DEV:ubx`.
"""

from dataclasses import replace
from typing import Literal

from ..dialogue import Dialogue, Exchange
from ..driver import GnssConfigured, Identity, Options, Unsupported
from .decoder import UbxDecoder
from .frames import SYNC
from .messages import NAV_PVT
from .setup import frames, set_up, streams, version

UNNAMED = "u-blox receiver"
TOO_OLD = "it has no NAV-PVT, which receivers have from u-blox 7 on: have it send NMEA, and name its port DEV:nmea"
NO_PVT = "it sends no NAV-PVT, and does not answer: have it send that, or NMEA and name its port DEV:nmea"


class Ubx:
    """The driver."""

    name = "ubx"
    bauds = (38400, 9600, 115200, 57600, 460800, 230400, 19200, 921600)
    timeout_s = 1.3  # an epoch a second, a little late
    interrupts = True  # a question disturbs neither the stream nor another receiver
    also_speaks = "nmea"

    @property
    def kind(self) -> Literal["gnss"]:
        """The kind of device."""
        return "gnss"

    def recognise(self, received: bytes) -> Identity | None:
        """A frame with the right checksum."""
        return Identity(self.name, UNNAMED) if SYNC in received and frames(received) else None

    def sends_fixes(self, received: bytes) -> bool:
        """Whether NAV-PVT is among the bytes."""
        return SYNC in received and any(one.kind == NAV_PVT for one in frames(received))

    def identify(self) -> Dialogue[Identity | None]:
        """Ask for the version, at the speed that is set."""
        found = yield from version(None, 1)
        return Identity(self.name, found.model, firmware=found.firmware) if found else None

    def configure(self, identity: Identity, options: Options) -> Dialogue[GnssConfigured | Unsupported | None]:
        """Set the receiver up in RAM, and wait for its fixes."""
        yield Exchange()
        if options.readonly:
            return GnssConfigured(identity)
        found = yield from version(identity.baud)
        if found is None:
            if (yield from streams()):
                return GnssConfigured(identity, ("the receiver does not answer: left as it is",))
            others = yield Exchange(listen_s=self.timeout_s, enough=lambda received: bool(frames(received)))
            return Unsupported(self.name, identity.model, NO_PVT, identity.baud) if frames(others) else None
        identity = replace(identity, model=found.model, firmware=found.firmware)
        outcome = yield from set_up(found, identity.baud, options.fix_rate_hz, options.keep_baud)
        if outcome.baud is None:
            return None
        identity = replace(identity, baud=outcome.baud)
        if not (yield from streams()):
            return Unsupported(self.name, identity.model, outcome.problem or TOO_OLD, identity.baud)
        warnings = (f"the receiver is not set up as wanted: {outcome.problem}",) if outcome.problem else ()
        return GnssConfigured(identity, warnings)

    def new_decoder(self, unchecked: bool = False) -> UbxDecoder:
        """See `GnssDriver`. (Every message has a checksum.)"""
        return UbxDecoder()


DRIVER = Ubx()
