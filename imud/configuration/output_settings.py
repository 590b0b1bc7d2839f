"""What a user may set of the outputs."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from ..client import GPSD_ADDRESS
from .fields import MESSAGE_RATE_HZ, number, text

_MB_MAX = 100_000_000
_YEAR_S = 31_622_400.0


class Gpsd(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The gpsd JSON server."""

    listen: Annotated[str, text("Where: HOST:PORT, [IPV6]:PORT or /path/of/a/unix/socket.")] = GPSD_ADDRESS
    allow_remote: Annotated[bool, Meta(description="Let other machines connect; there is no password.")] = False
    rate_hz: Annotated[
        float, number(*MESSAGE_RATE_HZ, "Hz", "Messages per second to clients that do not say.", hot=True)
    ] = 10.0
    max_clients: Annotated[int, number(1, 1024, "", "Connections at a time.", hot=True)] = 64


class Stream(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Every state in binary, for `imud.client` and C programs."""

    listen: Annotated[str, text("A Unix socket (SEQPACKET), such as /run/imud/front.stream; empty: none.")] = ""
    max_clients: Annotated[int, number(1, 64, "", "Connections at a time.")] = 16


class SharedMemory(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The newest state behind a sequence lock, for control loops that cannot wait on a socket."""

    path: Annotated[str, text("A file on a tmpfs, such as /run/imud/front.state; empty: none.")] = ""


class Nmea(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """NMEA 0183 sentences (GGA, RMC, VTG, HDT, ROT, PASHR) for plotters and autopilots."""

    udp: Annotated[str, text("HOST[:PORT] to send to, such as 127.0.0.1:10110; empty: none.")] = ""
    allow_remote: Annotated[bool, Meta(description="That may be another machine, or a broadcast address.")] = False
    pty: Annotated[str, text("Name of a pseudo-terminal, such as /run/imud/front.nmea; empty: none.")] = ""
    rate_hz: Annotated[float, number(0.001, 50.0, "Hz", "Bursts of sentences per second.")] = 5.0


class Chrony(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The receiver's time for chrony (`refclock SHM 2:perm=0660 delay 0.2`, in use when imud starts) or ntpd."""

    shm_unit: Annotated[
        int,
        number(-1, 255, "", "Unit of refclock SHM; -1: none. As right as `gnss.latency_s` is."),
    ] = -1
    shm_mode: Annotated[
        Literal["0600", "0660", "0666"],
        Meta(
            description="Permissions of the segment where imud makes it; `0666`: every user of this machine may set "
            "the time that chrony gets."
        ),
    ] = "0600"


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A recording (MCAP) of everything: raw bytes, samples, estimates, innovations, events."""

    path: Annotated[str, text("A file such as /var/lib/imud/drive.mcap; the next is drive.0001.mcap; empty: none.")] = (
        ""
    )
    folder: Annotated[
        str,
        text("Where clients on this machine may have recordings made, as by `imud web`; empty: nowhere."),
    ] = ""
    sample_rate_hz: Annotated[
        float,
        number(0.001, 1e4, "Hz", "Decoded samples per second; 0: all. Raw bytes are always complete.", or_zero=True),
    ] = 5.0
    estimate_rate_hz: Annotated[
        float, number(0.001, 1e4, "Hz", "Estimates per second; 0: all. A replay computes them all.", or_zero=True)
    ] = 5.0
    file_mb: Annotated[int, number(0, _MB_MAX, "MB", "A new file begins after so much; 0: never.")] = 1024
    file_s: Annotated[float, number(1.0, _YEAR_S, "s", "Or after so long; 0: never.", or_zero=True)] = 0.0
    budget_mb: Annotated[
        int,
        number(0, _MB_MAX, "MB", "All files of `path` together, the oldest are removed for the newest; 0: no limit."),
    ] = 0
    spare_mb: Annotated[
        int, number(0, _MB_MAX, "MB", "The recording pauses while less than that is free; 1 MB at least to begin.")
    ] = 100
