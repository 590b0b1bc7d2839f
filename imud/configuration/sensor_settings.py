"""What a user may set of sensors, receivers and other sources of measurements."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from .fields import HOT, Angle, Length, Name, Quality, number, text

Mounts = Annotated[
    dict[str, tuple[Angle, Angle, Angle]],
    Meta(
        max_length=64,
        description="The same of sensors that sit otherwise, as a spare may: by serial number, or DEV of `ports`. A "
        "spare that is named here has a heading also if it takes over before motion has shown how it sits.",
    ),
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
            example="gpiochip0:24",
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
    gyro_scale_percent: Annotated[float, number(1e-6, 50.0, "%", "Scale factor, 1 sigma.", or_zero=True)] = 0.0
    gyro_misalignment_percent: Annotated[
        float, number(1e-6, 50.0, "%", "Cross-axis sensitivity (1 % is 0.57 deg), 1 sigma.", or_zero=True)
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
            "A u-blox receiver in UBX is always set up, unless its port is readonly."
        ),
    ] = False
    rate_hz: Annotated[float, number(1.0, 10.0, "Hz", "Fixes per second, if it is set up.")] = 5.0


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
    heading_boresight_sigma_deg: Annotated[
        Literal["auto"] | Annotated[float, number(0.001, 180.0, "deg")],
        Meta(
            description="1 sigma of it; what it is off by is estimated in motion. `auto`: 3, as of what is mounted by "
            "eye. What a compass reports of itself is not how it is mounted.",
            extra=HOT,
        ),
    ] = "auto"
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
    velocity_mount_rpy_deg: Annotated[
        tuple[Angle, Angle, Angle],
        Meta(
            description="From the axes of a velocity sensor (`body_velocity`) to the vehicle's (FRD): roll, pitch, "
            "yaw; what they are off by is estimated in motion."
        ),
    ] = (0.0, 0.0, 0.0)
