"""Heading by the earth's magnetic field: an aid of last resort, where nothing better knows the heading.

z = declination - azimuth of the measured field, turned to north and east by the estimated attitude. A measurement has
value: the field in the body, T, and the earth's field at the place by the World Magnetic Model, north, east, down, T,
NaN while the place is not known; sigma[0]: T, of the field's horizontal components, NaN where it is not reported.

*Lasting error.* Iron of the vehicle and of its surroundings turns the field for as long as nothing moves. So all
readings together know no more than one: they correct the heading while its sigma is larger than that of a reading, and
never make it smaller than that. A heading that GNSS or a compass knows better is left alone.

*Disturbances.* What differs from the strength and dip of the earth's field is added to the sigma. A field that is much
stronger, weaker, steeper or flatter is not used, nor one that varies, as near motors, nor one that has done so a moment
ago. Where the field contradicts the heading, or where another test inflates the variance of the heading, it is not used
for minutes.

Source of the model: NOAA NCEI and BGS, The World Magnetic Model for 2025-2030.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import wrap_angle
from ....sensor_errors.magnetometer import REMAINING_T
from ...aiding_source import AidingSource, Column
from ...innovation_kinds import KINDS
from ...records import EARTH_DOWN_VALUE, EARTH_EAST_VALUE, EARTH_NORTH_VALUE, MAGNETOMETER, MAGNETOMETER_SOURCE
from ...tuning import Tunable
from ..ekf import cross_covariance, variance
from ..fusion import NO_GATE, correct_state, correlated_update, write_innovation
from ..mechanization import body_to_ned
from ..state import ATTITUDE, HEADING_AXIS, NEVER_NS
from .heading import yaw_jacobian
from .records import CONTRADICTED, OTHER_FIELD

if TYPE_CHECKING:
    from ....math.rotation import Vector
    from ...types import Innovation, Measurement
    from ..types import Core, Parameters

LEAST_FIELD = 1e-7  # T, of a reading, and level: the earth's is 2e-5 T and more
_FIELD = Column(1e-6, -1000.0, 1000.0)
SOURCE = AidingSource(
    "magnetometer",
    MAGNETOMETER_SOURCE,
    "MAG",
    dict.fromkeys(("mx_ut", "my_ut", "mz_ut", "north_ut", "east_ut", "down_ut"), _FIELD),
    {"sigma_ut": Column(1e-6, 0.01, 1000.0)},
    {MAGNETOMETER: KINDS[MAGNETOMETER]},
    optional=("north_ut", "east_ut", "down_ut"),
    short_names={"mx_ut": "x", "my_ut": "y", "mz_ut": "z"},
)
TUNABLES = (
    Tunable(
        "mag_sigma", REMAINING_T, "T", "Sigma of a magnetic field that reports none.", "What a calibration leaves."
    ),
    Tunable(
        "mag_yaw_sigma",
        math.radians(4.0),
        "rad",
        "Sigma of the heading by the field, beside that of the field.",
        "Surroundings, misalignment.",
    ),
    Tunable("mag_time_sigma", 0.05, "s", "Unknown age of a reading.", "Choice: half a period of 10 Hz."),
    Tunable("mag_gate", 6.25, "NIS", "Gate of a heading by the field.", "2.5 sigma: a last resort."),
    Tunable(
        "mag_strength_gate",
        0.12,
        "",
        "Largest difference of the field's strength from the model's, as a share.",
        "Five times its error; weak iron.",
    ),
    Tunable(
        "mag_dip_gate",
        math.radians(8.0),
        "rad",
        "Largest difference of the dip from the model's, beside the tilt error.",
        "As strength.",
    ),
    Tunable("mag_variation", 0.03, "", "Largest variation of strength, and of dip in rad.", "Noise of cheap sensors."),
    Tunable("mag_memory_s", 2.0, "s", "Time over which the variation is taken.", "Choice."),
    Tunable(
        "mag_settle_s", 3.0, "s", "Time for which the field must be that of the earth before it is used.", "Choice."
    ),
    Tunable(
        "mag_agreement_gate",
        2.25,
        "NIS",
        "Gate within which the field agrees with the heading after a contradiction.",
        "1.5 sigma.",
    ),
    Tunable("mag_distrust_s", 300.0, "s", "Time for which the field must agree after a contradiction.", "Choice."),
    Tunable(
        "mag_heading_inflation",
        math.radians(10.0),
        "rad",
        "Sigma by which a heading that was inflated between two readings has grown at least.",
        "Choice.",
    ),
)


@kernel
def has_field(p: Parameters, m: Measurement) -> bool:
    """Whether a reading is to be used at all: asked for, with a field, and that of the earth."""
    v = m.value
    known = (
        v[0] ** 2 + v[1] ** 2 + v[2] ** 2 > LEAST_FIELD**2
        and v[EARTH_NORTH_VALUE] ** 2 + v[EARTH_EAST_VALUE] ** 2 > LEAST_FIELD**2
    )  # no NaN
    return p.magnetometer != 0 and known and math.isfinite(v[EARTH_DOWN_VALUE])


@kernel
def is_earths_field(p: Parameters, c: Core, m: Measurement) -> bool:
    """Whether strength and dip have been those of the earth, and steady, for a while."""
    g, r = c.magnetometer, m.value
    north, east, down = body_to_ned(c, (r[0], r[1], r[2]))
    level, earth_level = elementary.hypot(north, east), elementary.hypot(r[EARTH_NORTH_VALUE], r[EARTH_EAST_VALUE])
    strength = elementary.hypot(level, down) / elementary.hypot(earth_level, r[EARTH_DOWN_VALUE]) - 1.0
    dip = elementary.atan2(down, level) - elementary.atan2(r[EARTH_DOWN_VALUE], earth_level)
    dt = 1e-9 * (m.t_ns - g.last_ns) if g.last_ns != NEVER_NS else math.inf
    if dt > p.tuning.mag_settle_s:  # the first, or the first for long
        g.strength, g.dip, g.variation, g.since_ns, g.heading_variance = strength, dip, 0.0, m.t_ns, 0.0
    g.last_ns = m.t_ns
    a, b, share = strength - g.strength, dip - g.dip, min(dt / p.tuning.mag_memory_s, 1.0)
    g.strength += share * a
    g.dip += share * b
    g.variation += share * (a * a + b * b - g.variation)
    tilt2 = max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    most_dip2 = p.tuning.mag_dip_gate**2 + p.tuning.limit_sigmas**2 * tilt2
    is_strange = abs(strength) > p.tuning.mag_strength_gate or dip * dip > most_dip2
    if is_strange or g.variation > p.tuning.mag_variation**2:
        g.since_ns = m.t_ns
    return m.t_ns - g.since_ns > 1e9 * p.tuning.mag_settle_s


@kernel
def field_variance(p: Parameters, c: Core, m: Measurement) -> float:
    """Variance of a heading by the field, rad^2, with the tilt known.

    What disturbs the field along and across its dip disturbs it as much across the heading, where nothing shows it.
    """
    g, sigma = c.magnetometer, m.sigma[0] if m.sigma[0] > 0.0 else p.tuning.mag_sigma
    earth2 = m.value[EARTH_NORTH_VALUE] ** 2 + m.value[EARTH_EAST_VALUE] ** 2
    disturbance2 = (earth2 + m.value[EARTH_DOWN_VALUE] ** 2) * (g.strength * g.strength + g.dip * g.dip)
    return p.tuning.mag_yaw_sigma**2 + (sigma * sigma + disturbance2) / earth2


@kernel
def field_in_ned(c: Core, m: Measurement) -> Vector:
    """The field that was measured, in NED by the core's attitude."""
    north, east, down = body_to_ned(c, (m.value[0], m.value[1], m.value[2]))
    return LEAST_FIELD if north == 0.0 else north, east, down


@kernel
def field_innovation(c: Core, m: Measurement) -> float:
    """Declination less the azimuth of the field, rad, at the time of the core."""
    north, east, _ = field_in_ned(c, m)
    return wrap_angle(
        elementary.atan2(m.value[EARTH_EAST_VALUE], m.value[EARTH_NORTH_VALUE]) - elementary.atan2(east, north)
    )


@kernel
def distrust_after_inflation(p: Parameters, c: Core, m: Measurement, heading_variance: float) -> None:
    """Do not use the field for a while if the heading's variance was inflated since the last reading.

    Whatever inflated the variance contradicts the heading, and so the field that the heading may be from. At rest it
    is the gyros that are contradicted, not the field. Stores the variance for the next reading.
    """
    g = c.magnetometer
    grown = heading_variance > g.heading_variance + p.tuning.mag_heading_inflation**2
    if g.heading_variance > 0.0 and grown and not c.stationarity.at_rest:
        g.contradicted_ns = m.t_ns
    g.heading_variance = heading_variance


@kernel
def is_contradicted(p: Parameters, c: Core, m: Measurement) -> bool:
    """Whether the field has contradicted a heading lately."""
    return m.t_ns - c.magnetometer.contradicted_ns < 1e9 * p.tuning.mag_distrust_s


@kernel
def fuse_magnetometer(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a reading while navigating; returns the rows of innovations (before: `alignment.magnetic_heading`).

    One that agrees with a heading known better counts as used, but leaves it alone.
    """
    if not has_field(p, m):
        return 0
    g, steady, known = c.magnetometer, is_earths_field(p, c, m), variance(c, ATTITUDE + 2)
    distrust_after_inflation(p, c, m, known)
    north, east, down = field_in_ned(c, m)
    z, length = field_innovation(c, m), yaw_jacobian(c, north, east, down)
    rate = body_to_ned(c, (c.imu.rate_b[0], c.imu.rate_b[1], c.imu.rate_b[2]))[2]
    z -= rate * 1e-9 * (m.t_ns - c.nav.t_ns)  # 0 but for an epoch after the newest sample
    least, h = field_variance(p, c, m), cross_covariance(c, length)
    r, shared = least + (rate * p.tuning.mag_time_sigma) ** 2, c.scratch.d[ATTITUDE + 2]
    contradicted = is_contradicted(p, c, m)
    largest = p.tuning.mag_agreement_gate * (r + min(h, r)) if contradicted else p.tuning.mag_gate * (r + h)
    if steady and z * z > largest:
        g.contradicted_ns = m.t_ns
    used = steady and not contradicted and z * z <= largest
    g.unused = 0 if used else (CONTRADICTED if steady else OTHER_FIELD)
    s = h + r
    if used and known > least:  # with this variance the heading's is not below `least` afterwards
        others = max(shared * shared / (known - least) - s, 0.0)
        correlated_update(c, length, z, r, others, NO_GATE, HEADING_AXIS)
        correct_state(p, c)
    g.heading_variance = variance(c, ATTITUDE + 2)
    return write_innovation(innovations, 0, m.t_ns, MAGNETOMETER, z, s, used)
