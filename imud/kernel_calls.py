"""Every kernel that Python calls: all that a loop will call is called once before the loop begins.

So numba, where it has to compile, does so before samples come; and `python -m imud.compile` learns from the same calls
what the shared library must have.
"""

import contextlib
import io

import numpy as np

from imud.drivers.driver import Identity, ImuConfigured, ImuDriver
from imud.drivers.registry import drivers, plugged_in
from imud.drivers.sample import SAMPLE

from .compile.entry import Dtype, Entry, recording_entries
from .configuration.settings import Initial, Settings
from .daemon.fast_loop import FastLoop
from .estimators import Estimator, registry
from .estimators.records import FIX, MEASUREMENT, SOLUTION
from .math.arrays import Records
from .outputs.binary import BinaryOutputs
from .outputs.shared_memory import WORD, write
from .pipeline import Filter, InertialPipeline
from .sensor_errors.profiles import profile_of
from .sensor_monitor.health import check_samples, new_health, recent_findings
from .stages import decoding

_RATE_HZ, _PERIOD_NS = 1000.0, 1_000_000


def _scratch(plugins_only: bool = False) -> list[tuple[ImuDriver, Records]]:
    """Every driver of inertial sensors, with a decoder state for it to work on."""
    sensors = [driver for driver in (plugged_in().values() if plugins_only else drivers()) if driver.kind == "imu"]
    return [(d, d.new_state(ImuConfigured(Identity(d.name, ""), _RATE_HZ, _PERIOD_NS, 0, 0))) for d in sensors]


def warm_decoders(plugins_only: bool = False) -> None:
    """Compile, or load, the decoder of every inertial sensor."""
    for driver, state in _scratch(plugins_only):
        decoding(driver, state)


def warm_loop() -> None:
    """Compile, or load, the daemon's fast loop, and what checks its sensor's health."""
    with contextlib.closing(FastLoop()) as fast_loop:
        outputs = BinaryOutputs(Settings(), fast_loop.others, 1)
        fast_loop.run_until_event(0, outputs, 0, 0)
        fast_loop.note(0)
        outputs.publish(np.zeros(1, SOLUTION), 1, 0, 0)
    recent_findings(new_health(profile_of(Settings()), _RATE_HZ))


def warm(estimator: Estimator, settings: Settings) -> None:
    """Compile, or load, the kernels of an estimator that a live stream calls."""
    filter_ = Filter(estimator, settings, Initial(), _RATE_HZ)
    InertialPipeline(*_scratch()[0], filter_).ingest(0, 0)
    filter_.update(np.zeros(1, FIX))
    filter_.pending_innovations()
    if estimator.aid is not None:
        filter_.aid(np.zeros(1, MEASUREMENT))


def warm_replay(estimator: Estimator, settings: Settings) -> None:
    """Compile, or load, the kernels of an estimator that a replay calls."""
    from .recording.steps import Steps
    from .tables.estimates import EstimateWriter, estimate_cells

    solutions = np.zeros(1, SOLUTION)
    filter_ = Filter(estimator, settings, Initial(), _RATE_HZ)
    filter_.run(np.zeros(1, SAMPLE), solutions)
    Steps(lambda samples, rows: None).run(InertialPipeline(*_scratch()[0], filter_), 0, 0, 0)
    EstimateWriter(io.BytesIO(), 0).write(solutions)
    estimate_cells(solutions)


def warm_analysis() -> None:
    """Compile, or load, the kernels with which commands read recordings."""
    from .ros2.messages import fill_measured
    from .ros2.reckoning import BODY_VELOCITY, MOTION, RECKONING, body_velocities, follow_body
    from .sensor_errors.noise import allan_variances
    from .smoothing.fixed_interval import smoothed_estimates
    from .smoothing.intervals import INTERVAL
    from .tables.imu_table import write_rows

    allan_variances(np.zeros(4), np.zeros(5), np.ones(1, np.int64), np.zeros(1))
    check_samples(new_health(profile_of(Settings()), _RATE_HZ), np.zeros(1, SAMPLE))
    smoothed_estimates(np.zeros(1, INTERVAL), 1.0)
    follow_body(np.zeros(1, RECKONING), np.zeros(1, SOLUTION), np.zeros(1, MOTION))
    body_velocities(np.zeros(1, SOLUTION), np.zeros(1, BODY_VELOCITY))
    fill_measured(np.zeros(3), np.zeros(1, np.int64), np.zeros(3), np.zeros(3), np.zeros(12))
    write_rows(io.BytesIO(), np.zeros(1, np.int64), np.zeros((1, 1)))


def entries() -> dict[str, tuple[Entry, tuple[Dtype, ...]]]:
    """Every entry that imud itself calls, by symbol, with its arguments' types. Nothing is compiled for that."""
    words = np.zeros(4, WORD)
    with recording_entries() as found:
        warm_decoders()
        warm_loop()
        warm_analysis()
        write(0, 0, words, 0)
        for name in registry.NAMES:
            warm(registry.by_name(name), Settings())
            warm_replay(registry.by_name(name), Settings())
    return found
