"""Everything a user may set, typed, with units in the names. Values only: reading files is `config`'s business."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Quality = Annotated[int, Meta(ge=1, le=8)]
Triple = tuple[float, float, float]


class Imu(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The inertial sensor."""

    profile: str = "auto"  # noise profile by name; auto: what the driver says, else consumer-mems
    rate_hz: Annotated[float, Meta(gt=0.0, le=2000.0)] = 1000.0
    mount_rpy_deg: Triple = (0.0, 0.0, 0.0)  # ZYX angles of the sensor's axes in the vehicle's
    filter_taps: Annotated[int, Meta(ge=0, le=128)] = 0  # of the sensor's own filter, at least; 0: for the least delay
    self_test: bool = False  # have the sensor test itself whenever it is connected; it must be at rest


class Gnss(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The receiver."""

    latency_s: NonNegative = 0.15  # from a fix's epoch to its arrival, when nothing better is known
    min_satellites: Annotated[int, Meta(ge=0)] = 5  # fixes with fewer are not used; those that do not say are
    max_hdop: Positive = 20.0
    qualities: tuple[Quality, ...] = (1, 2, 3, 4, 5)  # of GGA: neither estimated nor entered nor simulated
    configure: bool = False  # set a MediaTek receiver up: faster line, fewer sentences, rate_hz (no @BAUD on its port)
    rate_hz: Annotated[float, Meta(ge=1.0, le=10.0)] = 5.0  # fixes per second, if so


class Navigation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The navigation filter."""

    vehicle: Literal["auto", "land", "free"] = "auto"
    lever_arm_m: Triple = (0.0, 0.0, 0.0)  # antenna from IMU, body FRD


class GpsTrack(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `gps-track`: Prasanna's Q and R."""

    acceleration_var: Positive = 0.2  # (m/s^2)^2, constant from fix to fix
    position_var: Positive = 0.5  # m^2, of fixes without a sigma of their own


class Ins9(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator `ins9`: Prasanna's Q and R."""

    acceleration_walk: Positive = 0.7  # (m/s^2)^2/s
    distance_var: Positive = 0.2  # m^2, of each reckoned distance


class Gpsd(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The gpsd JSON server."""

    listen: str = "127.0.0.1:2947"
    allow_remote: bool = False
    rate_hz: Annotated[float, Meta(gt=0.0, le=1000.0)] = 10.0
    max_clients: Annotated[int, Meta(gt=0, le=1024)] = 64


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole."""

    estimator: str = "auto"  # navigation with GNSS, attitude without
    ports: tuple[str, ...] = ()
    imu: Imu = Imu()
    gnss: Gnss = Gnss()
    navigation: Navigation = Navigation()
    gps_track: GpsTrack = GpsTrack()
    ins9: Ins9 = Ins9()
    gpsd: Gpsd = Gpsd()


class Initial(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A start that the user knows (`--initial`); what is None the filter finds by itself."""

    lat_deg: float | None = None
    lon_deg: float | None = None
    height_m: float | None = None
    vn_mps: float | None = None
    ve_mps: float | None = None
    vd_mps: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
