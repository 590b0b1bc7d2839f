"""Writes the files of FILES: the records of the kernels as types for mypy, from the dtypes.

`python tests/record_types.py`; a test holds the files against the dtypes.
"""

from pathlib import Path

from imud.clocks import counter
from imud.drivers.sample import SAMPLE
from imud.estimators import records, tilt
from imud.estimators.ahrs import state as ahrs
from imud.estimators.ins import core, parameters
from imud.estimators.ins.aiding import records as aiding
from imud.estimators.ins.alignment import records as alignment
from imud.estimators.ins.glr_tests import records as glr_tests
from imud.estimators.ins.integrity import records as integrity
from imud.estimators.papers import gps_track, stationary, suh
from imud.estimators.papers.ins9 import state as ins9
from imud.estimators.riss import state as riss
from imud.sensor_monitor import clipping, health, spikes, units

IMUD = Path(__file__).resolve().parents[1] / "imud"
ESTIMATORS = {
    "Sample": SAMPLE,
    "Fix": records.FIX,
    "Measurement": records.MEASUREMENT,
    "Solution": records.SOLUTION,
    "Innovation": records.INNOVATION,
    "PendingInnovations": records.PENDING_INNOVATIONS,
    "TiltParameters": tilt.PARAMETERS,
    "TiltState": tilt.STATE,
}
TUNING = {"Tuning": parameters.PARAMETERS["tuning"]}
INS = {
    "StoredSample": core.STORED_SAMPLE,
    "Parameters": parameters.PARAMETERS,
    "Nav": core.NAV,
    "Earth": core.EARTH,
    "Imu": core.IMU,
    "Covariance": core.COVARIANCE,
    "MotionClass": core.MOTION_CLASS,
    "Stationarity": core.STATIONARITY,
    "BiasChanges": core.BIAS_CHANGES,
    "RestGap": core.REST_GAP,
    "GravityMonitor": integrity.GRAVITY_MONITOR,
    "TimeEvidence": core.TIME_EVIDENCE,
    "Nhc": aiding.NHC,
    "LandEvidence": aiding.LAND_EVIDENCE,
    "Gnss": aiding.GNSS,
    "Integrity": integrity.INTEGRITY,
    "ProcessNoise": core.PROCESS_NOISE,
    "FaultSensitivities": glr_tests.FAULT_SENSITIVITIES,
    "Drift": glr_tests.DRIFT,
    "VelocityDrift": glr_tests.VELOCITY_DRIFT,
    "ChordPoint": integrity.CHORD_POINT,
    "VelocityDiscrepancy": integrity.VELOCITY_DISCREPANCY,
    "VelocityLag": integrity.VELOCITY_LAG,
    "TimeOffsetStep": glr_tests.TIME_OFFSET_STEP,
    "CompassOffset": glr_tests.COMPASS_OFFSET,
    "Current": glr_tests.CURRENT,
    "GyroBiasStep": glr_tests.GYRO_BIAS_STEP,
    "ImuBiasStep": glr_tests.IMU_BIAS_STEP,
    "LeverArmError": glr_tests.LEVER_ARM_ERROR,
    "Alignment": alignment.ALIGNMENT,
    "Barometer": aiding.BAROMETER,
    "ExternalAid": aiding.EXTERNAL_AID,
    "SourceAge": aiding.SOURCE_AGE,
    "HeadingAid": aiding.HEADING_AID,
    "Magnetometer": aiding.MAGNETOMETER,
    "Odometer": aiding.ODOMETER,
    "WheelCheck": aiding.WHEEL_CHECK,
    "Transition": core.TRANSITION,
    "VelocityEpoch": core.VELOCITY_EPOCH,
    "Scratch": core.SCRATCH,
    "Snapshot": core.SNAPSHOT,
    "Core": core.CORE,
    "FixAge": alignment.FIX_AGE,
    "VectorPair": alignment.VECTOR_PAIR,
    "HypothesisBank": alignment.HYPOTHESIS_BANK,
    "StoredMeasurement": core.STORED_MEASUREMENT,
    "State": core.STATE,
}
AHRS = {
    "Tuning": ahrs.PARAMETERS["tuning"],
    "Parameters": ahrs.PARAMETERS,
    "Nav": ahrs.NAV,
    "Covariance": ahrs.COVARIANCE,
    "Imu": ahrs.IMU,
    "Stamps": ahrs.STAMPS,
    "Queue": ahrs.QUEUE,
    "Integrals": ahrs.INTEGRALS,
    "Levelling": ahrs.LEVELLING,
    "Motion": ahrs.MOTION,
    "Stationarity": ahrs.STATIONARITY,
    "Divergence": ahrs.DIVERGENCE,
    "AttitudeStep": ahrs.ATTITUDE_STEP,
    "Drag": ahrs.DRAG,
    "Clipping": ahrs.CLIPPING,
    "VarianceFactor": ahrs.VARIANCE_FACTOR,
    "VelocityHypotheses": ahrs.VELOCITY_HYPOTHESES,
    "Quantization": ahrs.QUANTIZATION,
    "History": ahrs.HISTORY,
    "Scratch": ahrs.SCRATCH,
    "State": ahrs.STATE,
}
PAPERS = {
    "StationaryParameters": stationary.PARAMETERS,
    "StationaryState": stationary.STATE,
    "SuhParameters": suh.PARAMETERS,
    "SuhState": suh.STATE,
    "TrackParameters": gps_track.PARAMETERS,
    "TrackState": gps_track.STATE,
    "Ins9Parameters": ins9.PARAMETERS,
    "Ins9State": ins9.STATE,
}
RISS = {"Tuning": riss.PARAMETERS["tuning"], "RissParameters": riss.PARAMETERS, "RissState": riss.STATE}
MONITOR = {
    "Clipping": clipping.CLIPPING,
    "Spikes": spikes.SPIKES,
    "RateUnits": units.RATE_UNITS,
    "Health": health.HEALTH,
}
FILES = {  # file: (what its records are, its records, those of other files by the module that they are imported from)
    IMUD / "clocks" / "types.py": ("record of a clock", {"Clock": counter.CLOCK}, {}),
    IMUD / "sensor_monitor" / "types.py": ("records of the sensor monitor", MONITOR, {}),
    IMUD / "estimators" / "types.py": ("records of all estimators, and of `tilt`", ESTIMATORS, {}),
    IMUD / "estimators" / "papers" / "types.py": (
        "records of the papers' estimators",
        PAPERS,
        {"..types": ESTIMATORS},
    ),
    IMUD / "estimators" / "riss" / "types.py": ("records of the reduced inertial estimator", RISS, {}),
    IMUD / "estimators" / "ahrs" / "types.py": ("records of the attitude filter", AHRS, {}),
    IMUD / "estimators" / "ins" / "tuning_types.py": ("tunables of the navigation filter", TUNING, {}),
    IMUD / "estimators" / "ins" / "types.py": (
        "records of the navigation filter",
        INS,
        {"..types": ESTIMATORS, ".tuning_types": TUNING},
    ),
}
OF_LEARNING = ("learning_values", "learning_d", "learning_gain", "covariance")
TO_KALMAN = dict.fromkeys(("columns", "column", "learning_columns"), "Indices") | dict.fromkeys(
    ("P", "predicted_P", "x", "d", "gain", "ph", "values", "jacobian", "one", "dx", "row", *OF_LEARNING), "Floats"
)
HEAD = '"""The {} as types for mypy, written by tests/record_types.py."""\n'


def type_of(dtype, name, known):
    """What mypy knows a field of this dtype as; the kernels of kalman take numpy's arrays."""
    base, shape = dtype.subdtype or (dtype, ())
    if name in TO_KALMAN and len(shape) == 1:
        return TO_KALMAN[name]
    if base.names:
        record = next(record for record, of in known.items() if of == base)
        return f"list[{record}]" if shape else record
    if not shape:
        return "float" if base.kind == "f" else "int"
    if len(shape) > 1:
        return "Tensor"
    return "Reals" if base.kind == "f" else "Integers"


def text(path):
    """The whole of this file."""
    title, own, others = FILES[path]
    known = own | {name: dtype for more in others.values() for name, dtype in more.items()}
    types = {
        record: {field: type_of(dtype[field], field, known) for field in dtype.names} for record, dtype in own.items()
    }
    used = {kind.removeprefix("list[").rstrip("]") for fields in types.values() for kind in fields.values()}
    arrays = "." * len(path.relative_to(IMUD).parts) + "math.arrays"
    imports = {arrays: {"Floats", "Indices", "Integers", "Reals", "Tensor"}} | {
        where: set(more) for where, more in others.items()
    }
    lines = [
        f"from {where} import {', '.join(sorted(names & used))}\n"
        for where, names in sorted(imports.items(), key=lambda item: (-item[0].count("."), item[0]))
        if names & used
    ]
    classes = [
        f"\n\nclass {record}:\n" + "".join(f"    {field}: {kind}\n" for field, kind in fields.items())
        for record, fields in types.items()
    ]
    return HEAD.format(title) + "".join(["\n"] * bool(lines) + lines) + "".join(classes)


if __name__ == "__main__":
    for path in FILES:
        path.write_text(text(path))
