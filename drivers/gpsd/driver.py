"""A gpsd as the receiver: it owns the device, and its reports are the fixes.

gpsd greets with VERSION and sends reports once they are asked for with WATCH. That is a request to gpsd, nothing is
written to the device, so it is made on readonly ports, too.
"""

import json
from collections import Counter
from collections.abc import Sequence
from typing import Literal

from ..dialogue import Dialogue, Exchange
from ..driver import GnssConfigured, Identity, Options, Unsupported
from .decoder import GpsdDecoder
from .reports import Lines, Report

WORDS_MAX = 255  # characters of a text of its own that are shown; gpsd's have fewer
REPORTS_S = 12.0  # gpsd opens its device for the first client, and finds its speed
IS_IMUD = "it is an imud, whose positions are estimates: name a gpsd that reads the receiver itself"
SILENT = "it has no device that reports: gpsdctl add DEVICE, or look at the system's log"


def reports(received: bytes) -> list[Report]:
    """The reports in the complete lines of `received`."""
    return list(Lines(Counter()).feed(received, 0))


class Gpsd:
    """The driver."""

    name = "gpsd"
    bauds: Sequence[int] = ()  # it is on no serial line
    timeout_s = 1.0
    interrupts = False

    @property
    def kind(self) -> Literal["gnss"]:
        """The kind of device."""
        return "gnss"

    def recognise(self, received: bytes) -> Identity | Unsupported | None:
        """The greeting."""
        if b'"VERSION"' not in received:
            return None
        for report in reports(received):
            if report.kind == "VERSION":
                release, revision = (str(report.values.get(name, ""))[:WORDS_MAX] for name in ("release", "rev"))
                if "imud" in revision or "imud" in release:
                    return Unsupported(self.name, f"imud {release}", IS_IMUD)
                return Identity(self.name, "gpsd", firmware=release)
        return None

    def identify(self) -> Dialogue[None]:
        """Sends nothing: gpsd greets by itself."""
        yield Exchange()
        return None

    def configure(self, identity: Identity, options: Options) -> Dialogue[GnssConfigured | Unsupported | None]:
        """Ask for reports, and wait for the first TPV."""
        wanted: dict[str, object] = {"enable": True, "json": True, "pps": True}
        if options.device:
            wanted["device"] = options.device
        received = yield Exchange(b"?WATCH=%s;\n" % json.dumps(wanted).encode(), REPORTS_S, _has_fixes)
        if errors := [str(one.values.get("message"))[:WORDS_MAX] for one in reports(received) if one.kind == "ERROR"]:
            return Unsupported(self.name, identity.model, f"it says: {errors[-1]}")
        return GnssConfigured(identity) if _has_fixes(received) else Unsupported(self.name, identity.model, SILENT)

    def new_decoder(self, unchecked: bool = False) -> GpsdDecoder:
        """See `GnssDriver`. (TCP has checksums of its own.)"""
        return GpsdDecoder()


def _has_fixes(received: bytes) -> bool:
    return b'"TPV"' in received or b'"ERROR"' in received


DRIVER = Gpsd()
