"""Everything a user may set: typed, described, each number with its unit and a finite range. `config` reads files.

The descriptions are what users read (`imud reference`). A hot key takes effect on SIGHUP, any other at the next start.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta


def number(least: float, most: float, unit: str, what: str = "", *, hot: bool = False, or_zero: bool = False) -> Meta:
    """A number of this unit (empty: a plain count) from `least` to `most`.

    Every number has a finite range, in which the whole program computes without overflow, underflow or division by
    zero. or_zero: 0 is allowed as well, with a meaning of its own (`config` checks what lies between).
    """
    extra = {"unit": unit, "hot": hot, "least": least, "or_zero": or_zero}
    return Meta(ge=0 if or_zero else least, le=most, description=what, extra=extra)


def text(what: str = "", *, form: str = r"^[^\x00-\x1f\x7f\ud800-\udfff]*\Z", longest: int = 4000) -> Meta:
    """Text without control characters, which no path, address or name has, and without undecodable bytes."""
    extra = {"rule": f" without control characters, at most {longest} long"}
    return Meta(pattern=form, max_length=longest, description=what, extra=extra)


Quality = Annotated[int, number(1, 8, "")]
Angle = Annotated[float, number(-360.0, 360.0, "deg")]
Length = Annotated[float, number(-1000.0, 1000.0, "m")]
Acceleration = Annotated[float, number(-100.0, 100.0, "m/s^2")]
Processor = Annotated[int, number(0, 8191, "")]
Name = Annotated[str, text()]
MESSAGE_RATE_HZ = (0.001, 1000.0)
HOT = {"hot": True}
_MB_MAX, _YEAR_S = 100_000_000, 31_622_400.0
Mounts = Annotated[
    dict[str, tuple[Angle, Angle, Angle]],
    Meta(
        max_length=64,
        description="The same of sensors that sit otherwise, as a spare may: by serial number, or DEV of `ports`.",
    ),
]
Tuning = Annotated[
    dict[str, float],
    Meta(description="Constants of the filter, by name; `imud reference tuning` lists them, their units and defaults."),
]


class Imu(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The inertial sensor."""

    profile: Annotated[str, text("Noise profile by name; `auto`: what the driver says, else `consumer-mems`.")] = "auto"
    model: Annotated[
        str,
        text("Which it is (such as `G365PDF`), where it may not be asked (`readonly`) and does not tell."),
    ] = ""
    rate_hz: Annotated[float, number(0.1, 2000.0, "Hz", "Samples per second to ask the sensor for.")] = 1000.0
    gyro_range_dps: Annotated[
        float, number(0.0, 1e5, "deg/s", "Where the gyro's readings end; 0: as the sensor says, else its profile.")
    ] = 0.0
    accel_range_g: Annotated[
        float, number(0.0, 1e4, "g", "Where the accelerometer's readings end; 0: as the sensor says, else its profile.")
    ] = 0.0
    mount_rpy_deg: Annotated[
        tuple[Angle, Angle, Angle],
        Meta(description="Roll, pitch, yaw (ZYX) of the sensor's axes in the vehicle's (x forward, y right, z down)."),
    ] = (0.0, 0.0, 0.0)
    mounts: Mounts = {}
    filter_taps: Annotated[
        int,
        number(0, 128, "taps", "Of the sensor's own filter; 0: as few as its rate allows, least delay."),
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
        text(
            "CHIP:LINE of the GPIO that its data-ready pin is wired to, as `gpiochip0:24` or `gpiochip0:GPIO24`; its "
            "edges then time the samples. Without it they are fetched by the clock.",
            form=r"^([^:\x00-\x1f\x7f\ud800-\udfff]+:[^:\x00-\x1f\x7f\ud800-\udfff]+)?\Z",
        ),
    ] = ""


class Noise(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of the inertial sensor better than by its profile: see `imud allan`. 0: as the profile says."""

    gyro_random_walk_deg_per_sqrt_h: Annotated[
        float, number(1e-6, 1e3, "deg/√h", "Angular random walk N.", or_zero=True)
    ] = 0.0
    gyro_bias_instability_deg_per_h: Annotated[
        float, number(1e-6, 1e5, "deg/h", "Bias instability B.", or_zero=True)
    ] = 0.0
    gyro_bias_initial_dps: Annotated[float, number(1e-6, 1e3, "deg/s", "Bias at switch-on, 1 sigma.", or_zero=True)] = (
        0.0
    )
    gyro_scale_percent: Annotated[
        float, number(1e-6, 50.0, "%", "Scale factor and misalignment, 1 sigma.", or_zero=True)
    ] = 0.0
    accel_random_walk_mps_per_sqrt_h: Annotated[
        float, number(1e-6, 1e3, "m/s/√h", "Velocity random walk N.", or_zero=True)
    ] = 0.0
    accel_bias_instability_mg: Annotated[float, number(1e-6, 1e4, "mg", "Bias instability B.", or_zero=True)] = 0.0
    accel_bias_initial_mg: Annotated[float, number(1e-6, 1e4, "mg", "Bias at switch-on, 1 sigma.", or_zero=True)] = 0.0
    accel_scale_percent: Annotated[
        float, number(1e-6, 50.0, "%", "Scale factor and misalignment, 1 sigma.", or_zero=True)
    ] = 0.0


class Gnss(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The receiver."""

    latency_s: Annotated[
        float, number(0.0, 10.0, "s", "From a fix's epoch to its arrival, when nothing better is known.", hot=True)
    ] = 0.15
    pps: Annotated[str, text("The kernel's pulse per second of this receiver, such as /dev/pps0; empty: none.")] = ""
    rtcm: Annotated[
        str,
        text("HOST:PORT or path from which RTCM 3 frames of an RTK base come, for the receiver; empty: none."),
    ] = ""
    min_satellites: Annotated[
        int, number(0, 100, "", "Fixes with fewer satellites are not used; those that do not say are.", hot=True)
    ] = 5
    max_hdop: Annotated[float, number(0.1, 1000.0, "", "Fixes with a larger HDOP are not used.", hot=True)] = 20.0
    qualities: Annotated[
        tuple[Quality, ...],
        Meta(
            max_length=8,
            description="GGA qualities that are used: by default none that is estimated, entered or simulated.",
            extra=HOT,
        ),
    ] = (1, 2, 3, 4, 5)
    require_checksum: Annotated[bool, Meta(description="Sentences without a checksum are not used.")] = True
    heading: Annotated[
        bool,
        Meta(
            description="Use headings from true north that it reports: HDT, THS, PASHR, a baseline. "
            "Not where they are courses.",
            extra=HOT,
        ),
    ] = True
    configure: Annotated[
        bool,
        Meta(
            description="Set a MediaTek receiver up: faster line, fewer sentences, rate_hz. No @BAUD on its port then. "
            "A u-blox receiver in UBX is set up anyway, for rate_hz if this is true, else for 5 Hz."
        ),
    ] = False
    rate_hz: Annotated[float, number(1.0, 10.0, "Hz", "Fixes per second, if it is set up.")] = 5.0


class Attitude(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `attitude`."""

    tuning: Tuning = {}


class Riss(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `riss`; the lever arm is navigation.lever_arm_m."""

    tuning: Tuning = {}


class Navigation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `navigation`."""

    vehicle: Annotated[
        Literal["auto", "land", "free"],
        Meta(description="`land`: does not slip sideways; `free`: may move anywhere; `auto`: finds out.", extra=HOT),
    ] = "auto"
    lever_arm_m: Annotated[
        tuple[Length, Length, Length],
        Meta(description="Antenna from the inertial sensor, in the vehicle's axes (FRD).", extra=HOT),
    ] = (0.0, 0.0, 0.0)
    tuning: Tuning = {}


class GpsTrack(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `gps-track`: Prasanna's Q and R."""

    acceleration_var: Annotated[
        float, number(1e-9, 1e6, "(m/s^2)^2", "Of an acceleration that is constant from fix to fix.", hot=True)
    ] = 0.2
    position_var: Annotated[float, number(1e-6, 1e8, "m^2", "Of fixes without a sigma of their own.", hot=True)] = 0.5


class Stationary(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `stationary`: Farrell's design parameters. His Q_n and σ_b are `[noise]`'s, or the profile's."""

    bias_rate: Annotated[
        float, number(1e-9, 0.1, "1/s", "λ: the bias's rate of decay; 0: a random walk.", hot=True, or_zero=True)
    ] = 1e-3
    bias_psd: Annotated[
        float, number(1e-18, 1.0, "(m/s^2)^2/s", "Q_ω: power spectral density of the bias's random walk.", hot=True)
    ] = 8e-6
    position_var: Annotated[
        float, number(1e-14, 1e4, "m^2", "R: of the position, by the table's vibration.", hot=True)
    ] = 1e-10
    interval_s: Annotated[
        float, number(1e-3, 1000.0, "s", "T: from one measurement of the position to the next.", hot=True)
    ] = 1.0
    initial_position_sigma_m: Annotated[float, number(1e-9, 1000.0, "m", "Of the position in P0.", or_zero=True)] = 0.0
    initial_velocity_sigma_mps: Annotated[
        float, number(1e-9, 1000.0, "m/s", "Of the velocity in P0.", or_zero=True)
    ] = 0.0
    initial_bias_mps2: Annotated[
        tuple[Acceleration, Acceleration, Acceleration],
        Meta(description="b(0) along x, y, z in his sign: what is added to the readings."),
    ] = (0.0, 0.0, 0.0)


class Ins9(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `ins9`: Prasanna's Q and R."""

    acceleration_walk: Annotated[
        float, number(1e-9, 1e6, "(m/s^2)^2/s", "Of the accelerations' random walk.", hot=True)
    ] = 0.7
    distance_var: Annotated[float, number(1e-9, 1e6, "m^2", "Of each reckoned distance.", hot=True)] = 0.2


class Aiding(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Measurements beside GNSS: heading, wheel speed."""

    listen: Annotated[
        str,
        text(
            "Where other programs send them: /path/of/a/unix/socket, or HOST:PORT (UDP, this machine); empty: nowhere."
        ),
    ] = ""
    iio: Annotated[
        tuple[Name, ...],
        Meta(description="Barometers and magnetometers of the kernel (Industrial I/O) by name, such as `bmp280`."),
    ] = ()
    iio_rate_hz: Annotated[float, number(0.1, 50.0, "Hz", "Readings of each of them per second.")] = 10.0
    heading_boresight_deg: Annotated[
        float,
        number(
            -360.0, 360.0, "deg", "What the compass, or the baseline, shows when the vehicle heads north.", hot=True
        ),
    ] = 0.0
    current_mps: Annotated[
        float,
        number(
            0.0,
            10.0,
            "m/s",
            "Speed of the water itself, 1 sigma, by which a speed through it (NMEA VHW, VBW) differs from that over "
            "ground; 0: speeds through the water are not used.",
            hot=True,
        ),
    ] = 0.0
    magnetometer: Annotated[
        bool,
        Meta(description="Use a magnetometer for the heading, where nothing better knows it.", extra=HOT),
    ] = False
    magnetometer_mount_rpy_deg: Annotated[
        tuple[Angle, Angle, Angle],
        Meta(description="From the magnetometer's axes to the vehicle's (FRD): roll, pitch, yaw."),
    ] = (0.0, 0.0, 0.0)
    magnetic_year: Annotated[
        float, number(2010.0, 2030.0, "year", "For which the World Magnetic Model gives the earth's field.", hot=True)
    ] = 2027.5
    odometer_lever_arm_m: Annotated[
        tuple[Length, Length, Length],
        Meta(
            description="Wheel, or middle of the axle, from the inertial sensor, in the vehicle's axes (FRD).",
            extra=HOT,
        ),
    ] = (0.0, 0.0, 0.0)
    track_width_m: Annotated[
        float,
        number(0.0, 20.0, "m", "Between left and right wheel: their difference is a yaw rate; 0: not known.", hot=True),
    ] = 0.0
    pose_lever_arm_m: Annotated[
        tuple[Length, Length, Length],
        Meta(description="Point of external poses, from the inertial sensor, in the vehicle's axes (FRD).", extra=HOT),
    ] = (0.0, 0.0, 0.0)
    velocity_lever_arm_m: Annotated[
        tuple[Length, Length, Length],
        Meta(
            description="Point of external velocities, from the inertial sensor, in the vehicle's axes (FRD).",
            extra=HOT,
        ),
    ] = (0.0, 0.0, 0.0)


class Gpsd(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The gpsd JSON server."""

    listen: Annotated[str, text("Where: HOST:PORT, [IPV6]:PORT or /path/of/a/unix/socket.")] = "127.0.0.1:2947"
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
    spare_mb: Annotated[int, number(0, _MB_MAX, "MB", "The recording pauses while less than that is free.")] = 100


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
        Meta(max_length=16, description="Outputs of plug-ins, NAME or NAME:ARGUMENT; imud's own have tables above."),
    ] = ()
    realtime: Realtime = Realtime()


RightAngle = Annotated[float, number(-90.0, 90.0, "deg")]
Height = Annotated[float, number(-1e4, 1e6, "m")]
Speed = Annotated[float, number(-1e4, 1e4, "m/s")]


class Initial(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A start that the user knows (`--initial`); what is None the filter finds by itself."""

    lat_deg: RightAngle | None = None
    lon_deg: Angle | None = None
    height_m: Height | None = None
    vn_mps: Speed | None = None
    ve_mps: Speed | None = None
    vd_mps: Speed | None = None
    roll_deg: Angle | None = None
    pitch_deg: RightAngle | None = None
    yaw_deg: Angle | None = None

    def over(self, other: "Initial") -> "Initial":
        """What this one knows, and of the rest what the other does."""
        return msgspec.structs.replace(
            other, **{k: v for k, v in msgspec.structs.asdict(self).items() if v is not None}
        )
