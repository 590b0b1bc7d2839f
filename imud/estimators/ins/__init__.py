"""The inertial navigation system (INS): position, velocity, attitude and sensor biases from an IMU and aiding sources.

An error-state Kalman filter around a strapdown mechanization. In the order of the data:

| file or folder | holds |
|---|---|
| `filter` | the entry points: an inertial sample, a GNSS fix, a measurement of another source |
| `fusion_horizon` | rings of samples, snapshots and measurements: each measurement is fused at its epoch |
| `velocity_epoch` | the antenna when its velocity was that of a fix |
| `imu_sample` | the order of things for a sample; `damaged_readings`: missing and clipped ones |
| `propagation` | to a later time; `mechanization`: the nominal state; `error_model`, `noise_density`: F and Q |
| `stationarity`, `rest` | windows of samples; is the sensor at rest? |
| `gnss_fix`, `sources` | the order of things for a fix; the table of the other sources |
| `aiding/` | one file a source: its Jacobian, noise and gate |
| `fusion`, `ekf` | one update of the Kalman filter; `process_noise`: learned from the innovations |
| `alignment/` | roll, pitch and heading before navigation, and the modes |
| `glr_tests/` | faults sought in every update: of receiver, time tags, gyro bias, compass, lever arm; a current |
| `integrity/` | other fault detection: a frozen or alternating receiver, a contradicted heading or gyro bias |
| `state`, `core`, `parameters` | the error states; the records, a concern each; the tunables |
| `solution`, `filter_states`, `findings` | what comes out; what is estimated beside it; what contradicts the settings |
| `checkpoint` | what outlasts a restart of the program |
"""

from .. import Estimator
from .checkpoint import checkpoint, resume
from .filter import aid, pending_innovations, step, update
from .filter_states import attitude, filter_states
from .findings import findings
from .parameters import TUNABLES, configure
from .setup import (
    backward_fixes,
    backward_tuning,
    fix_delay_s,
    is_valid,
    place,
    restore_biases,
    source_ages_s,
    start,
    variances,
)
from .source_estimates import source_estimates
from .sources import SOURCES

ESTIMATOR = Estimator(
    "navigation",
    configure,
    start,
    step,
    update,
    pending_innovations=pending_innovations,
    tunables=TUNABLES,
    survives_power_on=True,
    aid=aid,
    sources=SOURCES,
    is_valid=is_valid,
    restore_biases=restore_biases,
    checkpoint=checkpoint,
    resume=resume,
    backward_tuning=backward_tuning,
    backward_fixes=backward_fixes,
    fix_delay_s=fix_delay_s,
    source_ages_s=source_ages_s,
    source_estimates=source_estimates,
    findings=findings,
    place=place,
    variances=variances,
    filter_states=filter_states,
    attitude=attitude,
)
