"""Everything a user may set: typed, described, units in the names. Values only: reading files is `config`'s business.

The descriptions are what users read (`imud reference`). A HOT key takes effect on SIGHUP, any other at the next start.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Quality = Annotated[int, Meta(ge=1, le=8)]
Triple = tuple[float, float, float]
HOT = {"hot": True}
Tuning = Annotated[
    dict[str, float],
    Meta(description="Constants of the filter, by name; `imud reference tuning` lists them, their units and defaults."),
]


class Imu(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The inertial sensor."""

    profile: Annotated[
        str, Meta(description="Noise profile by name; `auto`: what the driver says, else `consumer-mems`.")
    ] = "auto"
    model: Annotated[
        str,
        Meta(description="Which it is (such as `G365PDF`), where it may not be asked (`readonly`) and does not tell."),
    ] = ""
    rate_hz: Annotated[float, Meta(gt=0.0, le=2000.0, description="Samples per second to ask the sensor for.")] = 1000.0
    mount_rpy_deg: Annotated[
        Triple,
        Meta(description="Roll, pitch, yaw (ZYX) of the sensor's axes in the vehicle's (x forward, y right, z down)."),
    ] = (0.0, 0.0, 0.0)
    filter_taps: Annotated[
        int,
        Meta(ge=0, le=128, description="Of the sensor's own filter; 0: as few as its rate allows, least delay."),
    ] = 0
    mode: Annotated[
        Literal["auto", "polled"],
        Meta(description="`auto`: the sensor sends by itself; `polled`: it is asked for each sample, if it can be."),
    ] = "auto"
    self_test: Annotated[
        bool, Meta(description="Have the sensor test itself whenever it is connected; it must be at rest.")
    ] = False


class Spi(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An inertial sensor on SPI."""

    data_ready: Annotated[
        str,
        Meta(
            pattern=r"^$|^[^:]+:[^:]+$",
            description="CHIP:LINE of the GPIO that its data-ready pin is wired to, as `gpiochip0:24` or "
            "`gpiochip0:GPIO24`; its edges then time the samples. Without it they are fetched by the clock.",
        ),
    ] = ""


class Noise(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of the inertial sensor better than by its profile: see `imud allan`. 0: as the profile says."""

    gyro_random_walk_deg_per_sqrt_h: Annotated[float, Meta(ge=0.0, description="Angular random walk N.")] = 0.0
    gyro_bias_instability_deg_per_h: Annotated[float, Meta(ge=0.0, description="Bias instability B.")] = 0.0
    gyro_bias_initial_dps: Annotated[float, Meta(ge=0.0, description="Bias at switch-on, 1 sigma.")] = 0.0
    gyro_scale_percent: Annotated[float, Meta(ge=0.0, description="Scale factor and misalignment, 1 sigma.")] = 0.0
    accel_random_walk_mps_per_sqrt_h: Annotated[float, Meta(ge=0.0, description="Velocity random walk N.")] = 0.0
    accel_bias_instability_mg: Annotated[float, Meta(ge=0.0, description="Bias instability B.")] = 0.0
    accel_bias_initial_mg: Annotated[float, Meta(ge=0.0, description="Bias at switch-on, 1 sigma.")] = 0.0
    accel_scale_percent: Annotated[float, Meta(ge=0.0, description="Scale factor and misalignment, 1 sigma.")] = 0.0


class Gnss(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The receiver."""

    latency_s: Annotated[
        float, Meta(ge=0.0, description="From a fix's epoch to its arrival, when nothing better is known.", extra=HOT)
    ] = 0.15
    pps: Annotated[
        str, Meta(description="The kernel's pulse per second of this receiver, such as /dev/pps0; empty: none.")
    ] = ""
    min_satellites: Annotated[
        int, Meta(ge=0, description="Fixes with fewer satellites are not used; those that do not say are.", extra=HOT)
    ] = 5
    max_hdop: Annotated[float, Meta(gt=0.0, description="Fixes with a larger HDOP are not used.", extra=HOT)] = 20.0
    qualities: Annotated[
        tuple[Quality, ...],
        Meta(
            description="GGA qualities that are used: by default none that is estimated, entered or simulated.",
            extra=HOT,
        ),
    ] = (1, 2, 3, 4, 5)
    require_checksum: Annotated[bool, Meta(description="Sentences without a checksum are not used.")] = True
    configure: Annotated[
        bool,
        Meta(
            description="Set a MediaTek receiver up: faster line, fewer sentences, rate_hz. No @BAUD on its port then."
        ),
    ] = False
    rate_hz: Annotated[float, Meta(ge=1.0, le=10.0, description="Fixes per second, if it is set up.")] = 5.0


class Attitude(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `attitude`."""

    tuning: Tuning = {}


class Navigation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `navigation`."""

    vehicle: Annotated[
        Literal["auto", "land", "free"],
        Meta(description="`land`: does not slip sideways; `free`: may move anywhere; `auto`: finds out.", extra=HOT),
    ] = "auto"
    lever_arm_m: Annotated[
        Triple, Meta(description="Antenna from the inertial sensor, in the vehicle's axes (FRD).", extra=HOT)
    ] = (0.0, 0.0, 0.0)


class GpsTrack(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `gps-track`: Prasanna's Q and R."""

    acceleration_var: Annotated[
        float, Meta(gt=0.0, description="(m/s^2)^2, of an acceleration that is constant from fix to fix.", extra=HOT)
    ] = 0.2
    position_var: Annotated[
        float, Meta(gt=0.0, description="m^2, of fixes without a sigma of their own.", extra=HOT)
    ] = 0.5


class Ins9(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `ins9`: Prasanna's Q and R."""

    acceleration_walk: Annotated[
        float, Meta(gt=0.0, description="(m/s^2)^2/s, of the accelerations' random walk.", extra=HOT)
    ] = 0.7
    distance_var: Annotated[float, Meta(gt=0.0, description="m^2, of each reckoned distance.", extra=HOT)] = 0.2


class Gpsd(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The gpsd JSON server."""

    listen: Annotated[str, Meta(description="Where: HOST:PORT, [IPV6]:PORT or /path/of/a/unix/socket.")] = (
        "127.0.0.1:2947"
    )
    allow_remote: Annotated[bool, Meta(description="Let other machines connect; there is no password.")] = False
    rate_hz: Annotated[
        float, Meta(gt=0.0, le=1000.0, description="Messages per second to clients that do not say.", extra=HOT)
    ] = 10.0
    max_clients: Annotated[int, Meta(gt=0, le=1024, description="Connections at a time.", extra=HOT)] = 64


class Stream(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Every state in binary, for `imud.client` and C programs."""

    listen: Annotated[
        str, Meta(description="A Unix socket (SEQPACKET), such as /run/imud/front.stream; empty: none.")
    ] = ""
    max_clients: Annotated[int, Meta(gt=0, le=64, description="Connections at a time.")] = 16


class SharedMemory(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The newest state behind a sequence lock, for control loops that cannot wait on a socket."""

    path: Annotated[str, Meta(description="A file on a tmpfs, such as /run/imud/front.state; empty: none.")] = ""


class Nmea(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """NMEA 0183 sentences (GGA, RMC, VTG, HDT, ROT, PASHR) for plotters and autopilots."""

    udp: Annotated[str, Meta(description="HOST[:PORT] to send to, such as 127.0.0.1:10110; empty: none.")] = ""
    allow_remote: Annotated[bool, Meta(description="That may be another machine, or a broadcast address.")] = False
    pty: Annotated[str, Meta(description="Name of a pseudo-terminal, such as /run/imud/front.nmea; empty: none.")] = ""
    rate_hz: Annotated[float, Meta(gt=0.0, le=50.0, description="Bursts of sentences per second.")] = 5.0


class Chrony(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The receiver's time for chrony (`refclock SHM 2:perm=0666 delay 0.2`, in use when imud starts) or ntpd."""

    shm_unit: Annotated[
        int,
        Meta(ge=-1, le=255, description="Unit of refclock SHM; -1: none. As right as `gnss.latency_s` is."),
    ] = -1


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A recording (MCAP) of everything: raw bytes, samples, estimates, innovations, events."""

    path: Annotated[
        str, Meta(description="A file such as /var/lib/imud/drive.mcap; the next is drive.0001.mcap; empty: none.")
    ] = ""
    folder: Annotated[
        str,
        Meta(description="Where clients on this machine may have recordings made, as by `imud web`; empty: nowhere."),
    ] = ""
    sample_rate_hz: Annotated[
        float, Meta(ge=0.0, description="Decoded samples per second; 0: all. Raw bytes are always complete.")
    ] = 0.0
    estimate_rate_hz: Annotated[
        float, Meta(ge=0.0, description="Estimates per second; 0: all. A replay computes them all.")
    ] = 50.0
    file_mb: Annotated[int, Meta(ge=0, description="A new file begins after so much; 0: never.")] = 1024
    file_s: Annotated[float, Meta(ge=0.0, description="Or after so long; 0: never.")] = 0.0
    budget_mb: Annotated[
        int, Meta(ge=0, description="All files of `path` together, the oldest are removed for the newest; 0: no limit.")
    ] = 0
    spare_mb: Annotated[int, Meta(ge=0, description="The recording pauses while less than that is free.")] = 100


class Realtime(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """For control loops. Each needs permission (`imud install-service --realtime`); without it the start fails."""

    lock_memory: Annotated[bool, Meta(description="Keep all memory from being paged out.")] = False
    scheduler: Annotated[
        Literal["other", "fifo", "rr"], Meta(description="Of the kernel: `other` is the usual one.")
    ] = "other"
    priority: Annotated[int, Meta(ge=1, le=99, description="Of `fifo` and `rr`; interrupt threads have 50.")] = 40
    cpus: Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(description="Processors to run on; empty: any.")] = ()


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole."""

    estimator: Annotated[
        str, Meta(description="Estimator by name; `auto`: `navigation` with a second port, else `attitude`.")
    ] = "auto"
    ports: Annotated[
        tuple[str, ...],
        Meta(
            description="DEV[:DRIVER[@BAUD]] of the inertial sensor and the receiver, in any order; SPI: spi:BUS.DEV."
        ),
    ] = ()
    readonly: Annotated[
        bool | tuple[str, ...], Meta(description="Those DEVs to which nothing is ever written; `true`: all of them.")
    ] = False
    imu: Imu = Imu()
    noise: Noise = Noise()
    spi: Spi = Spi()
    gnss: Gnss = Gnss()
    attitude: Attitude = Attitude()
    navigation: Navigation = Navigation()
    gps_track: GpsTrack = GpsTrack()
    ins9: Ins9 = Ins9()
    gpsd: Gpsd = Gpsd()
    nmea: Nmea = Nmea()
    stream: Stream = Stream()
    shared_memory: SharedMemory = SharedMemory()
    record: Record = Record()
    chrony: Chrony = Chrony()
    realtime: Realtime = Realtime()


_Angle = Annotated[float, Meta(ge=-360.0, le=360.0)]
_Speed = Annotated[float, Meta(ge=-1e4, le=1e4)]


class Initial(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A start that the user knows (`--initial`); what is None the filter finds by itself."""

    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    lon_deg: _Angle | None = None
    height_m: Annotated[float, Meta(ge=-1e4, le=1e6)] | None = None
    vn_mps: _Speed | None = None
    ve_mps: _Speed | None = None
    vd_mps: _Speed | None = None
    roll_deg: _Angle | None = None
    pitch_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    yaw_deg: _Angle | None = None
