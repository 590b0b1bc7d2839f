"""What a user may set of the estimators, and what he knows of the start."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from .fields import HOT, Acceleration, Angle, Height, Length, RightAngle, Speed, number

Tuning = Annotated[
    dict[str, float],
    Meta(description="Constants of the filter, by name; `imud reference tuning` lists them, their units and defaults."),
]


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
        Literal["auto"] | tuple[Length, Length, Length],
        Meta(
            description="Antenna from the inertial sensor, in the vehicle's axes (FRD); `auto`: not known, somewhere "
            "near the sensor.",
            extra=HOT,
        ),
    ] = "auto"
    lever_arm_sigma_m: Annotated[
        Literal["auto"] | Annotated[float, number(0.0, 10.0, "m")],
        Meta(
            description="1 sigma of each component of it, which is then estimated; 0: it is exact. `auto`: 1 m if the "
            "lever arm is not given; else 0.2 m, and with positions of centimetres 0.03 m, until these contradict it. "
            "With those of a survey's log it is exact, until they contradict it by more than half a metre.",
            extra=HOT,
        ),
    ] = "auto"
    tuning: Tuning = {}

    @property
    def lever_arm(self) -> tuple[float, float, float]:
        """The lever arm before any is estimated, metres, FRD: `lever_arm_m`, or zero where that is not known."""
        return (0.0, 0.0, 0.0) if self.lever_arm_m == "auto" else self.lever_arm_m


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
