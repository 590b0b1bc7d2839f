"""Everything a user may set: typed, described, each number with its unit and a finite range. `config` reads files.

The descriptions are what users read (`imud reference`). A hot key takes effect on SIGHUP, any other at the next start.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from .estimator_settings import Attitude, GpsTrack, Initial, Ins9, Navigation, Riss, Stationary
from .fields import Name, Processor, number, text
from .output_settings import Chrony, Gpsd, Nmea, Record, SharedMemory, Stream
from .sensor_settings import Aiding, Gnss, Imu, Noise, Spi

__all__ = [
    "Aiding",
    "Attitude",
    "Chrony",
    "Gnss",
    "GpsTrack",
    "Gpsd",
    "Imu",
    "Initial",
    "Ins9",
    "Navigation",
    "Nmea",
    "Noise",
    "Realtime",
    "Record",
    "Riss",
    "Settings",
    "SharedMemory",
    "Spi",
    "Stationary",
    "Stream",
]


class Realtime(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """For control loops. Each needs permission (`imud install-service --realtime`); without it the start fails."""

    lock_memory: Annotated[bool, Meta(description="Keep all memory from being paged out.")] = False
    scheduler: Annotated[
        Literal["other", "fifo", "rr"], Meta(description="Of the kernel: `other` is the usual one.")
    ] = "other"
    priority: Annotated[int, number(1, 99, "", "Of `fifo` and `rr`; interrupt threads have 50.")] = 40
    cpus: Annotated[tuple[Processor, ...], Meta(max_length=8192, description="Processors to run on; empty: any.")] = ()


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole."""

    estimator: Annotated[str, text("Estimator by name; `auto`: `navigation` with a second port, else `attitude`.")] = (
        "auto"
    )
    initial: Annotated[
        str,
        text(
            "What is known of the start, as `yaw_deg=57,lat_deg=48.1`; the keys are those of `imud replay --initial`."
        ),
    ] = ""
    ports: Annotated[
        tuple[Name, ...],
        Meta(
            max_length=64,
            description="DEV[:DRIVER[@BAUD]] of the inertial sensor and the receiver, in any order; SPI: spi:BUS.DEV.",
        ),
    ] = ()
    readonly: Annotated[
        bool | tuple[Name, ...],
        Meta(description="Those DEVs to which nothing is ever written; `true`: all of them."),
    ] = False
    imu: Imu = Imu()
    noise: Noise = Noise()
    spi: Spi = Spi()
    gnss: Gnss = Gnss()
    attitude: Attitude = Attitude()
    navigation: Navigation = Navigation()
    riss: Riss = Riss()
    gps_track: GpsTrack = GpsTrack()
    stationary: Stationary = Stationary()
    ins9: Ins9 = Ins9()
    aiding: Aiding = Aiding()
    gpsd: Gpsd = Gpsd()
    nmea: Nmea = Nmea()
    stream: Stream = Stream()
    shared_memory: SharedMemory = SharedMemory()
    record: Record = Record()
    chrony: Chrony = Chrony()
    outputs: Annotated[
        tuple[Name, ...],
        Meta(max_length=16, description="Outputs of plug-ins, NAME or NAME:ARGUMENT; imud's own have settings."),
    ] = ()
    realtime: Realtime = Realtime()
