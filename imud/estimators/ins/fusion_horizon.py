"""The fusion horizon: measurements that arrive late are fused at their own epochs, of aiding sources in any order.

Fixes of the receiver come in the order of their epochs; an older one is rejected. Rings hold the last two seconds, or
32 fixes and 256 measurements where these come faster (1.3 s of fixes at 25 Hz): IMU samples, snapshots of the core and
of the hypothesis bank, and measurements in the order of their times. To fuse a measurement of epoch t the core is
rewound to the last snapshot not after t, propagated to t exactly, corrected, and replayed to the newest sample with the
code that new samples take. Measurements between t and now, which had been fused before, are fused again at their own
epochs, and the snapshots are renewed.

Source: a delayed fusion horizon with one buffer for each sensor is that of PX4's EKF2; here the present solution is
corrected at once instead of predicted from the horizon.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ..records import GNSS_FIX
from .imu_sample import process_sample
from .propagation import propagate_to
from .state import (
    AIDING_RING,
    BANKS,
    IMU_RING,
    SNAPSHOT_NS,
    SNAPSHOTS,
)

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from ..types import Fix, Sample
    from .types import Core, Parameters, Snapshot, State, StoredMeasurement


@kernel
def store_sample(s: State, sample: Sample, w: Reals, f: Reals) -> None:
    """Store a sample in the ring, with rate w (rad/s) and specific force f (m/s^2), body axes."""
    r = s.imu_ring[s.sample_count % IMU_RING]
    r.t_ns = sample.t_ns
    r.flags = sample.flags
    r.outage_s = sample.outage_s
    for i in range(3):
        r.w[i] = w[i]
        r.f[i] = f[i]
    s.sample_count += 1


@kernel
def insert_measurement(s: State, t_ns: int, kind: int) -> int:
    """Insert an empty measurement to be fused at t_ns, after those of the same time; returns its number."""
    if s.aiding_count == AIDING_RING:
        s.aiding_start += 1
        s.aiding_count -= 1
    k = s.aiding_start + s.aiding_count
    s.aiding_count += 1
    while k > s.aiding_start and s.aiding_ring[(k - 1) % AIDING_RING].t_ns > t_ns:
        s.aiding_ring[k % AIDING_RING] = s.aiding_ring[(k - 1) % AIDING_RING]
        k -= 1
    e = s.aiding_ring[k % AIDING_RING]
    e.t_ns, e.kind = t_ns, kind
    if kind == GNSS_FIX:
        e.bank = s.bank_count
        s.bank_count += 1
    return k


@kernel
def fusion_time(s: State, fix: Fix) -> int:
    """When a fix is fused, ns: its epoch less the time offset, not before the last fix, not after the last sample."""
    newest_ns = s.imu_ring[(s.sample_count - 1) % IMU_RING].t_ns
    return max(min(fix.t_ns - int(1e9 * s.last_time_offset), newest_ns), s.last_fusion_ns)


@kernel
def store_bank(s: State, e: StoredMeasurement) -> None:
    """Before a fix is fused: store the hypothesis bank, which only fixes change, for a rewind to a time before it."""
    s.banks[e.bank % BANKS] = s.bank[0]
    e.last_epoch_ns, e.last_time_offset, e.last_fusion_ns = s.last_epoch_ns, s.last_time_offset, s.last_fusion_ns


@kernel
def restore_bank(s: State, e: StoredMeasurement) -> None:
    """Restore the hypothesis bank, and the times of the last fix, to those before a fix."""
    s.bank[0] = s.banks[e.bank % BANKS]
    s.last_epoch_ns, s.last_time_offset, s.last_fusion_ns = e.last_epoch_ns, e.last_time_offset, e.last_fusion_ns


@kernel
def first_fix_from(s: State, first: int) -> int:
    """Number of the oldest fix among measurement `first` and those after it; -1: there is none."""
    for k in range(first, s.aiding_start + s.aiding_count):
        if s.aiding_ring[k % AIDING_RING].kind == GNSS_FIX:
            return k
    return -1


@kernel
def store_snapshot(s: State) -> None:
    """Store a copy of the core, without its scratch."""
    c, k = s.core[0], s.snapshots[s.snapshot_count % SNAPSHOTS]
    k.nav, k.earth, k.imu, k.cov, k.stationarity = c.nav, c.earth, c.imu, c.cov, c.stationarity
    k.nhc, k.gnss, k.integrity, k.drift, k.alignment = c.nhc, c.gnss, c.integrity, c.drift, c.alignment
    k.land_evidence, k.time_evidence = c.land_evidence, c.time_evidence
    k.process_noise, k.gravity_monitor, k.barometer = c.process_noise, c.gravity_monitor, c.barometer
    k.bias_changes, k.rest_gap = c.bias_changes, c.rest_gap
    k.heading_aid, k.odometer, k.wheel_check = c.heading_aid, c.odometer, c.wheel_check
    k.pose, k.external_velocity, k.magnetometer = c.pose, c.external_velocity, c.magnetometer
    k.time_offset_step, k.gyro_bias_step = c.time_offset_step, c.gyro_bias_step
    k.velocity_drift, k.compass_offset, k.faults = c.velocity_drift, c.compass_offset, c.faults
    k.current, k.body_velocity = c.current, c.body_velocity
    k.lever_arm_error, k.imu_bias_step = c.lever_arm_error, c.imu_bias_step
    s.snapshot_count += 1


@kernel
def store_snapshot_if_due(s: State) -> None:
    """Store a copy of the core if the last one is older than SNAPSHOT_NS."""
    last = s.snapshots[(s.snapshot_count - 1) % SNAPSHOTS]
    if s.snapshot_count == 0 or s.core[0].nav.t_ns - last.nav.t_ns >= SNAPSHOT_NS:
        store_snapshot(s)


@kernel
def restore_snapshot(c: Core, k: Snapshot) -> None:
    """Restore the core from snapshot k."""
    c.nav, c.earth, c.imu, c.cov, c.stationarity = k.nav, k.earth, k.imu, k.cov, k.stationarity
    c.nhc, c.gnss, c.integrity, c.drift, c.alignment = k.nhc, k.gnss, k.integrity, k.drift, k.alignment
    c.land_evidence, c.time_evidence = k.land_evidence, k.time_evidence
    c.process_noise, c.gravity_monitor, c.barometer = k.process_noise, k.gravity_monitor, k.barometer
    c.bias_changes, c.rest_gap = k.bias_changes, k.rest_gap
    c.heading_aid, c.odometer, c.wheel_check = k.heading_aid, k.odometer, k.wheel_check
    c.pose, c.external_velocity, c.magnetometer = k.pose, k.external_velocity, k.magnetometer
    c.time_offset_step, c.gyro_bias_step = k.time_offset_step, k.gyro_bias_step
    c.velocity_drift, c.compass_offset, c.faults = k.velocity_drift, k.compass_offset, k.faults
    c.current, c.body_velocity = k.current, k.body_velocity
    c.lever_arm_error, c.imu_bias_step = k.lever_arm_error, k.imu_bias_step


@kernel
def replay_to_newest(p: Parameters, s: State) -> None:
    """Process all stored samples up to the newest one, with a snapshot whenever one is due."""
    c = s.core[0]
    while c.imu.sample_count < s.sample_count:
        process_sample(p, c, s.imu_ring[c.imu.sample_count % IMU_RING])
        store_snapshot_if_due(s)


@kernel
def rewind_to(s: State, t_ns: int) -> bool:
    """Restore core and hypothesis bank from the last snapshot not after t_ns; False if it is no longer stored.

    Nor if what has to be fused again is not, once another measurement has been inserted into a full ring.
    """
    if s.core[0].nav.t_ns <= t_ns:
        return True
    oldest = max(0, s.snapshot_count - SNAPSHOTS)
    k = s.snapshot_count - 1
    while k >= oldest and s.snapshots[k % SNAPSHOTS].nav.t_ns > t_ns:
        k -= 1
    if k < oldest:
        return False
    snapshot = s.snapshots[k % SNAPSHOTS]
    oldest_kept = s.aiding_start + (1 if s.aiding_count == AIDING_RING else 0)
    if snapshot.imu.sample_count < s.sample_count - IMU_RING or snapshot.nav.fused_count < oldest_kept:
        return False
    fix = first_fix_from(s, snapshot.nav.fused_count)
    if fix >= 0 and s.bank_count - s.aiding_ring[fix % AIDING_RING].bank > BANKS:
        return False
    if fix >= 0:
        restore_bank(s, s.aiding_ring[fix % AIDING_RING])
    restore_snapshot(s.core[0], s.snapshots[k % SNAPSHOTS])
    s.snapshot_count = k + 1
    return True


@kernel
def propagate_to_epoch(p: Parameters, s: State, t_ns: int, w: Reals, f: Reals) -> None:
    """Propagate the core to t_ns exactly, not after the newest sample; (w, f): scratch for the interpolated sample."""
    c = s.core[0]
    while c.imu.sample_count < s.sample_count and s.imu_ring[c.imu.sample_count % IMU_RING].t_ns <= t_ns:
        process_sample(p, c, s.imu_ring[c.imu.sample_count % IMU_RING])
    if c.nav.t_ns >= t_ns or c.imu.sample_count >= s.sample_count:
        return
    r = s.imu_ring[c.imu.sample_count % IMU_RING]
    share = (t_ns - c.nav.t_ns) / (r.t_ns - c.nav.t_ns)
    for i in range(3):
        w[i] = c.imu.w[i] + share * (r.w[i] - c.imu.w[i])
        f[i] = c.imu.f[i] + share * (r.f[i] - c.imu.f[i])
    propagate_to(p, c, t_ns, w, f)
