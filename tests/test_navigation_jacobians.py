"""Jacobians of position, velocity, non-holonomic constraint, heading and odometer against finite differences.

Each measurement is evaluated by the filter's own code, as plain Python, which hands its Jacobian and its innovation to
a recorder instead of the Kalman filter. The nominal state is displaced along one error state by `inject_error`. An
innovation is measured minus predicted, so that its derivative is minus the Jacobian.
"""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imud.compile.jit import interpreted
from imud.configuration.settings import Aiding, Initial, Navigation, Settings
from imud.estimators.ins.aiding import (
    barometer,
    external_pose,
    external_velocity,
    gnss_position,
    gnss_velocity,
    heading,
    magnetometer,
    non_holonomic,
    odometer,
    two_wheels,
)
from imud.estimators.ins.alignment.modes import transfer_lever_arm
from imud.estimators.ins.ekf import decorrelate, inject_error
from imud.estimators.ins.lever_arm import arm_velocity_row
from imud.estimators.ins.mechanization import ned_difference
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import (
    ATTITUDE,
    BARO_OFFSET,
    GNSS_BIAS,
    GNSS_LEVER_ARM,
    GNSS_VELOCITY_BIAS,
    GYRO_BIAS,
    MOUNT_PITCH,
    MOUNT_YAW,
    NAVIGATING,
    NHC_LEVER_ARM,
    ODOMETER_SCALE,
    POSITION,
    STATES,
    TIME_OFFSET,
    VELOCITY,
    VELOCITY_TIME_OFFSET,
)
from imud.estimators.records import (
    BAROMETER_SOURCE,
    BODY_VELOCITY_SOURCE,
    FIX,
    HEADING_SOURCE,
    INNOVATION,
    MAGNETOMETER_SOURCE,
    MEASUREMENT,
    ODOMETER_SOURCE,
    POSE_SOURCE,
    VELOCITY_SOURCE,
)

STEP = 1e-5  # m, m/s, rad, ...: small against every curvature, large against the rounding of a latitude (1e-9 m)
LEVER_ARM = (1.2, -0.7, -1.9)
EPOCH_NS = 7_000_000_000

as_python = cache(interpreted)


def record(array):
    """The only element of an array, with its fields as attributes."""
    return array.view(np.recarray)[0]


class Recorder:
    """Stands for the Kalman filter: keeps the Jacobian (STATES) and the innovation of every measurement."""

    def __init__(self):
        self.rows = []

    def gated_update(self, c, m, z, r, gate):
        self._keep(c, m, z)
        return z, r, 1.0

    def correlated_update(self, c, m, z, r, shared, gate, axis):
        return self.gated_update(c, m, z, r, gate)

    def fix_update(self, p, c, m, z, r, gate, axis):
        return self.gated_update(c, m, z, r, gate)

    def pseudo_measurement(self, c, kind, m, z, r, gate, axis):
        return self.gated_update(c, m, z, r, gate)

    def _keep(self, c, m, z):
        jacobian = np.zeros(STATES)
        for k in range(m):
            jacobian[c.scratch.columns[k]] += c.scratch.values[k]
        self.rows.append((jacobian, z))


@pytest.fixture
def recorder(monkeypatch):
    as_python.cache_clear()  # kernels that are interpreted from now on call the recorder
    made = Recorder()
    monkeypatch.setattr(gnss_position, "fix_update", made.fix_update)
    monkeypatch.setattr(gnss_velocity, "fix_update", made.fix_update)
    monkeypatch.setattr(magnetometer, "correlated_update", made.correlated_update)
    monkeypatch.setattr(heading, "correlated_update", made.correlated_update)
    monkeypatch.setattr(odometer, "correlated_update", made.correlated_update)
    monkeypatch.setattr(two_wheels, "correlated_update", made.correlated_update)
    monkeypatch.setattr(barometer, "correlated_update", made.correlated_update)
    monkeypatch.setattr(external_pose, "correlated_update", made.correlated_update)
    monkeypatch.setattr(external_velocity, "correlated_update", made.correlated_update)
    monkeypatch.setattr(non_holonomic, "pseudo_measurement", made.pseudo_measurement)
    return made


def nominal(seed, rolling=False):
    """Parameters and state of a filter that navigates: any attitude, some 15 m/s, turning and accelerating.

    rolling: the smoothed rate has a part about the forward axis, whose effect on the constraint is not in H.
    """
    p, s = navigating(seed, rolling)
    return p.copy(), s.copy()


@cache
def navigating(seed, rolling):
    rng = np.random.default_rng(seed)
    aiding = Aiding(
        pose_lever_arm_m=(0.4, 0.3, -1.1),
        velocity_lever_arm_m=(-0.5, 0.6, 0.8),
        velocity_mount_rpy_deg=(20.0, -10.0, 35.0),
    )
    p = configure(Settings(navigation=Navigation(lever_arm_m=LEVER_ARM), aiding=aiding), 100.0)
    s = start(p, Initial(lat_deg=50.0, lon_deg=8.0, height_m=120.0, yaw_deg=10.0))
    c = record(s).core[0]
    attitude = Rotation.random(random_state=seed)
    c.alignment.mode = NAVIGATING
    c.cov.P[:] = 0.0
    c.nav.t_ns = c.gnss.last_used_ns = EPOCH_NS
    c.nav.q_nb = np.roll(attitude.as_quat(), 1)
    c.nav.v_n, c.nav.gnss_lever_arm = rng.standard_normal(3) * 15.0, LEVER_ARM
    c.nav.forward, c.nav.lateral = Rotation.random(random_state=seed + 100).as_matrix()[:2]
    c.nav.nhc_lever_arm, c.nav.time_offset, c.nav.velocity_time_offset = 0.8, 0.0, 0.04
    c.imu.w, c.imu.rate_b = rng.standard_normal((2, 3)) * 0.5
    if not rolling:
        c.imu.rate_b = c.imu.rate_b - (c.nav.forward @ c.imu.rate_b) * c.nav.forward
    c.scratch.velocity_epoch.acceleration = rng.standard_normal(3) * 2.0
    c.gnss.reported_sigma, c.gnss.noise_var, c.nhc.enabled = (1.5, 3.0), (1.0, 4.0), 1
    return p, s


def fix_near(c, rng):
    """A fix with position and velocity, some metres and tenths of m/s from the estimate."""
    fix = np.zeros(1, FIX)
    f = record(fix)
    north, east, down = rng.standard_normal(3)
    f.t_ns, f.arrival_ns, f.quality, f.sigma, f.speed, f.course = EPOCH_NS, EPOCH_NS, 1, np.nan, np.nan, np.nan
    f.lat, f.lon, f.height = c.nav.lat + north / 6.4e6, c.nav.lon + east / 4.1e6, c.nav.height - down
    f.v = c.nav.v_n + rng.standard_normal(3) * 0.1
    return f


def measure_position(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    age = c.nav.time_offset - 1e-9 * (fix.t_ns - c.nav.t_ns)
    as_python(gnss_position.fuse_gnss_position)(p, c, fix, age, rows, 0)


def measure_velocity(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    age = c.nav.time_offset - 1e-9 * (fix.t_ns - c.nav.t_ns)
    e = c.scratch.velocity_epoch  # of a constant acceleration, and of a constant rate
    e.change = (age + c.nav.velocity_time_offset) * e.acceleration
    for i in range(3):
        e.by_lever_arm[i] = as_python(arm_velocity_row)(c, i)
    as_python(gnss_velocity.fuse_gnss_velocity)(p, c, fix, rows, 0)


def measure_nhc(p, c, fix):
    as_python(non_holonomic.fuse_nhc)(p, c)


def measure_heading(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    m = record(np.zeros(1, MEASUREMENT))
    m.t_ns, m.kind, m.value, m.sigma = c.nav.t_ns, HEADING_SOURCE, 1.0, 0.02
    p.tuning.heading_gate = 1e9
    as_python(heading.fuse_heading)(p, c, m, rows)


def measure_magnetometer(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    m = record(np.zeros(1, MEASUREMENT))
    m.t_ns, m.kind, m.sigma = c.nav.t_ns, MAGNETOMETER_SOURCE, 1e-9
    m.value = 2e-5, -1e-5, 4e-5, 2.1e-5, 1e-6, 4.3e-5
    p.magnetometer, p.tuning.mag_yaw_sigma, p.tuning.mag_memory_s = 1, 1e-3, 1e12
    p.tuning.mag_gate = p.tuning.mag_strength_gate = p.tuning.mag_dip_gate = p.tuning.mag_variation = 1e9
    c.magnetometer.last_ns, c.magnetometer.since_ns = c.nav.t_ns - 10**8, c.nav.t_ns - 10**11
    decorrelate(c, ATTITUDE + 2, 1.0)
    as_python(magnetometer.fuse_magnetometer)(p, c, m, rows)


def measure_odometer(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    m = record(np.zeros(1, MEASUREMENT))
    m.t_ns, m.kind, m.value, m.sigma = (
        c.nav.t_ns,
        ODOMETER_SOURCE,
        (5.0, *[np.nan] * 5),
        (9.0, np.nan, np.nan, np.nan),
    )
    c.odometer.direction = c.odometer.reverses = 1
    p.tuning.odometer_gate = p.tuning.odometer_sign_sigmas = 1e6
    as_python(odometer.fuse_odometer)(p, c, m, rows)


def measure_two_wheels(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    m = record(np.zeros(1, MEASUREMENT))
    m.t_ns, m.kind, m.sigma = c.nav.t_ns, ODOMETER_SOURCE, (9.0, np.nan, np.nan, np.nan)
    m.value = 5.0
    m.value[1] = 0.4
    c.odometer.direction = c.odometer.reverses = 1
    p.track_width = 1.5
    p.tuning.odometer_gate = p.tuning.odometer_sign_sigmas = 1e6
    as_python(odometer.fuse_odometer)(p, c, m, rows)


def measure_barometer(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    m = record(np.zeros(1, MEASUREMENT))
    m.t_ns, m.kind, m.value, m.sigma = c.nav.t_ns, BAROMETER_SOURCE, 130.0, 100.0
    as_python(barometer.fuse_barometer)(p, c, m, rows)


def measure_pose(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    m = record(np.zeros(1, MEASUREMENT))
    m.t_ns, m.kind, m.sigma = c.nav.t_ns, POSE_SOURCE, 50.0
    m.value[:4] = fix.lat, fix.lon, fix.height, 1.0
    as_python(external_pose.fuse_pose)(p, c, m, rows)


def measure_external_velocity(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    m = record(np.zeros(1, MEASUREMENT))
    m.t_ns, m.kind, m.sigma, m.value[:3] = c.nav.t_ns, VELOCITY_SOURCE, 50.0, fix.v
    as_python(external_velocity.fuse_external_velocity)(p, c, m, rows)


def measure_body_velocity(p, c, fix):
    rows = np.zeros(4, INNOVATION).view(np.recarray)
    m = record(np.zeros(1, MEASUREMENT))
    m.t_ns, m.kind, m.sigma, m.value[:3] = c.nav.t_ns, BODY_VELOCITY_SOURCE, 50.0, (9.0, 1.0, -2.0)
    as_python(external_velocity.fuse_external_velocity)(p, c, m, rows)


MEASUREMENTS = {  # measurement: rows, and the error states by which its Jacobian has elements
    measure_position: (
        3,
        (
            *(*range(POSITION, POSITION + 3), *range(ATTITUDE, ATTITUDE + 3), *range(GNSS_BIAS, GNSS_BIAS + 3)),
            *(*range(GNSS_LEVER_ARM, GNSS_LEVER_ARM + 3), TIME_OFFSET),
        ),
    ),
    measure_velocity: (
        3,
        (
            *(*range(VELOCITY, ATTITUDE + 3), *range(GYRO_BIAS, GYRO_BIAS + 3), TIME_OFFSET, VELOCITY_TIME_OFFSET),
            *range(GNSS_VELOCITY_BIAS, GNSS_LEVER_ARM + 3),
        ),
    ),
    measure_nhc: (
        2,
        (*range(VELOCITY, VELOCITY + 3), *range(ATTITUDE, ATTITUDE + 3), MOUNT_PITCH, MOUNT_YAW, NHC_LEVER_ARM),
    ),
    measure_heading: (1, tuple(range(ATTITUDE, ATTITUDE + 3))),
    measure_magnetometer: (1, tuple(range(ATTITUDE, ATTITUDE + 3))),
    measure_pose: (4, (*range(POSITION, POSITION + 3), *range(ATTITUDE, ATTITUDE + 3))),
    measure_external_velocity: (3, tuple(range(VELOCITY, GYRO_BIAS + 3))),
    measure_body_velocity: (3, tuple(range(VELOCITY, GYRO_BIAS + 3))),
    measure_barometer: (1, (POSITION + 2, BARO_OFFSET)),
    measure_two_wheels: (
        2,
        (
            *(*range(VELOCITY, VELOCITY + 3), *range(ATTITUDE, ATTITUDE + 3), *range(GYRO_BIAS, GYRO_BIAS + 3)),
            *(MOUNT_PITCH, MOUNT_YAW, ODOMETER_SCALE),
        ),
    ),
    measure_odometer: (
        1,
        (
            *(*range(VELOCITY, VELOCITY + 3), *range(ATTITUDE, ATTITUDE + 3)),
            *(MOUNT_PITCH, MOUNT_YAW, ODOMETER_SCALE),
        ),
    ),
}


def innovations(recorder, measure, seed, state, step, rolling=False):
    """Jacobians (rows, STATES) and innovations (rows), the nominal state displaced by `step` along an error state."""
    p, s = nominal(seed, rolling)
    parameters, c = record(p), record(s).core[0]
    fix = fix_near(c, np.random.default_rng(seed))
    c.scratch.x[state] = step
    as_python(inject_error)(parameters, c)
    recorder.rows.clear()
    measure(parameters, c, fix)
    return np.array([row for row, _ in recorder.rows]), np.array([z for _, z in recorder.rows])


def differenced(recorder, measure, seed, state, rolling=False):
    """Derivative of the innovations with respect to an error state, by central differences."""
    _, ahead = innovations(recorder, measure, seed, state, STEP, rolling)
    _, behind = innovations(recorder, measure, seed, state, -STEP, rolling)
    return (ahead - behind) / (2.0 * STEP)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("measure", MEASUREMENTS)
def test_jacobian_is_the_derivative_of_the_prediction(recorder, measure, seed):
    rows, states = MEASUREMENTS[measure]
    H, _ = innovations(recorder, measure, seed, 0, 0.0)
    assert H.shape == (rows, STATES)
    assert set(np.flatnonzero(np.any(H != 0.0, axis=0))) == set(states)
    for state in states:
        derivative = differenced(recorder, measure, seed, state)
        np.testing.assert_allclose(-derivative, H[:, state], rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_term_omitted_from_the_jacobian_of_the_constraint_is_that_of_the_derivation(recorder, seed):
    """The rate of turn about the vehicle's vertical axis, with which the lever arm swings, depends on the mounting."""
    _, s = nominal(seed, rolling=True)
    c = record(s).core[0]
    omitted = (-c.nav.nhc_lever_arm * (c.nav.forward @ c.imu.rate_b), 0.0)
    H, _ = innovations(recorder, measure_nhc, seed, MOUNT_PITCH, 0.0, rolling=True)
    derivative = differenced(recorder, measure_nhc, seed, MOUNT_PITCH, rolling=True)
    np.testing.assert_allclose(-derivative - H[:, MOUNT_PITCH], omitted, rtol=0.0, atol=1e-4)


def transferred(seed, state, step):
    """Position (m, NED), velocity and P after the transfer from antenna to IMU, displaced by `step` along a state."""
    p, s = nominal(seed)
    parameters, c = record(p), record(s).core[0]
    start = c.nav.lat, c.nav.lon, c.nav.height
    c.imu.rate_b = c.imu.accel_n = 0.0
    c.scratch.x[state] = step
    as_python(inject_error)(parameters, c)
    c.cov.P[:] = [i == k and i != TIME_OFFSET for i in range(STATES) for k in range(i, STATES)]
    as_python(transfer_lever_arm)(c, 1.0)
    north, east = as_python(ned_difference)(c, start[0], start[1], c.nav.lat, c.nav.lon)
    return np.array([north, east, start[2] - c.nav.height, *c.nav.v_n]), c.cov.P.copy()


@pytest.mark.parametrize("seed", range(3))
def test_transfer_of_the_covariance_from_antenna_to_imu_is_the_derivative_of_that_of_the_state(seed):
    states = [*range(POSITION, GYRO_BIAS + 3), *range(GNSS_LEVER_ARM, GNSS_LEVER_ARM + 3)]
    ahead, behind = (np.array([transferred(seed, i, step)[0] for i in states]) for step in (STEP, -STEP))
    T = ((ahead - behind) / (2.0 * STEP)).T
    P = np.zeros((STATES, STATES))
    P[np.triu_indices(STATES)] = transferred(seed, 0, 0.0)[1]
    np.testing.assert_allclose(P[:6, :6], np.triu(T @ T.T), rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(P[:6, states[6:]], T[:, 6:], rtol=0.0, atol=1e-4)
