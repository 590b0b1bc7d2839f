"""The two halves of the way from bytes to solutions, as templates: the driver's decoder; then clock, health, estimator.

Each is composed with every driver and every estimator that is used; `ingest` calls the halves by their addresses in the
pipeline's record. So drivers plus estimators are compiled, not drivers times estimators.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from imud.drivers import elementary
from imud.drivers.driver import DECODER_FIELDS, ImuDriver
from imud.drivers.sample import MOUNTING_UNKNOWN, SAMPLE

from .clocks.counter import CLOCK, stamp
from .compile.entry import address_of, entry, set_unique_name
from .compile.jit import inlined, kernel
from .compile.system import call, records
from .errors import ImudError
from .estimators import Estimator
from .estimators.records import ATTITUDE_VALID, HEADING_VALID, SOLUTION
from .math.arrays import Integers, Records
from .math.rotation import dcm_of_quat, euler_variances
from .sensor_errors.calibration import CORRECTION, MAX_MOUNTING_SIGMA_DEG, correct
from .sensor_errors.mounting_error import added_covariance
from .sensor_monitor.health import HEALTH, check_sample

Kernel = Callable[..., Any]
BATCH = 1024  # samples one call may yield: more than a reading can hold of the shortest frames, lines of 6 bytes
RX = 65536  # bytes
BYTE = np.dtype(np.uint8)
_MAX_MOUNTING_VARIANCE = math.radians(MAX_MOUNTING_SIGMA_DEG) ** 2

INERTIAL_PIPELINE = np.dtype(
    [
        ("at", "<i8"),  # addresses: of this record itself,
        ("decode", "<i8"),  # of the functions that `_decode` and `_advance` become,
        ("advance", "<i8"),
        ("rx", "<i8"),  # and of what they work on
        ("decoder", "<i8"),
        ("samples", "<i8"),
        ("clock", "<i8"),
        ("health", "<i8"),
        ("correction", "<i8"),
        ("parameters", "<i8"),
        ("state", "<i8"),
        ("solutions", "<i8"),
        ("fill", "<i8"),  # bytes in rx that belong to no whole frame yet
        ("count", "<i8"),  # samples since the start
        ("newest", "<i8"),  # row of the newest solution; -1: none yet
        ("last_data_ns", "<i8"),  # when it came
        ("first_flags", "<i8"),  # of the next sample: POWER_ON, RECONNECTED
    ],
    align=True,
)

READ_CURSOR = np.dtype(  # how far `ingest_reads` has come
    [
        ("read", "<i8"),  # the next read,
        ("byte", "<i8"),  # and the index of its first byte
        ("end", "<i8"),  # the read before which the run ends
        ("filled", "<i8"),  # rows of samples and solutions
    ],
    align=True,
)


@entry
def ingest(pipeline: Records, received: int, arrival_ns: int) -> int:
    """Decode, stamp and step what was written to rx[fill:fill + received]; returns how many solutions are new."""
    s = pipeline[0]
    n = call(s.decode, (s.at, received))
    if n:
        call(s.advance, (s.at, n, arrival_ns))
        s.count += n
        s.newest = n - 1
        s.last_data_ns = arrival_ns
    return int(n)


@entry
def ingest_reads(
    pipeline: Records, data: Integers, size: Integers, t_ns: Integers, cursor: Records, samples: Records, out: Records
) -> int:
    """`ingest` recorded reads: their bytes one behind the other, how many each has, and when it came.

    cursor: array of one READ_CURSOR, which advances. Ends earlier where `samples` and `out` have no more room. Returns
    the number of reads done.
    """
    s, c = pipeline[0], cursor[0]
    rx = records(s.rx, RX, BYTE)
    new_samples, solutions = records(s.samples, BATCH, SAMPLE), records(s.solutions, BATCH, SOLUTION)
    done = 0
    while c.read < c.end and c.filled + BATCH <= len(out):
        received = size[c.read]
        for k in range(received):
            rx[s.fill + k] = data[c.byte + k]
        n = ingest(pipeline, received, t_ns[c.read])
        for k in range(n):
            samples[c.filled + k] = new_samples[k]
            out[c.filled + k] = solutions[k]
        c.read += 1
        c.byte += received
        c.filled += n
        done += 1
    return done


@kernel
def _takes_none(parameters: Any, state: Any, row: Any, innovations: Any) -> int:
    """The `update` of an estimator that takes no fixes, the `aid` of one that takes no other measurements."""
    return 0


@kernel
def _has_none(state: Any, innovations: Any) -> int:
    """The `pending_innovations` of an estimator whose steps make no innovations."""
    return 0


@kernel
def add_mounting(sample: Any, errors: Any, solution: Any) -> None:
    """The attitude of a sensor is the body's only where its mounting is known, and as well as that is known."""
    if errors.mounting_error.angle_sigma > 0.0:
        q = (solution.q_nb[0], solution.q_nb[1], solution.q_nb[2], solution.q_nb[3])
        n00, n01, n02, n11, n12, n22 = added_covariance(errors.mounting_error, dcm_of_quat(q))
        added = euler_variances(q, n00, n01, n02, n11, n12, n22)
        for i in range(3):
            solution.sigma_rpy[i] = elementary.hypot(solution.sigma_rpy[i], added[i] ** 0.5)
        if max(added[0], added[1]) > _MAX_MOUNTING_VARIANCE:
            solution.status &= ~(ATTITUDE_VALID | HEADING_VALID)
        elif added[2] > _MAX_MOUNTING_VARIANCE:
            solution.status &= ~HEADING_VALID
    if sample.flags & MOUNTING_UNKNOWN != 0:
        solution.status &= ~(ATTITUDE_VALID | HEADING_VALID)
        for i in range(3):
            solution.sigma_rpy[i] = math.pi


@functools.cache
def _decoder(decode: Kernel, decoder: np.dtype[Any]) -> Kernel:
    """A driver's half of `ingest`. decoder: of its state."""

    def decode_received(pipeline: int, received: int) -> int:
        s = records(pipeline, 1, INERTIAL_PIPELINE)[0]
        state = records(s.decoder, 1, decoder)
        n: int = decode(records(s.rx, RX, BYTE), s.fill + received, state, records(s.samples, BATCH, SAMPLE))
        s.fill = state[0].leftover
        return n

    set_unique_name(decode_received, decode, decoder)
    return entry(decode_received)


@functools.cache
def _stepper(step: Kernel) -> Kernel:
    """Health, calibration and estimator, for a sample that has its time."""

    def step_sample(health: Any, sample: Any, errors: Any, p: Any, s: Any, solution: Any) -> None:
        check_sample(health, sample)
        correct(sample, errors)
        step(p, s, sample, solution)
        add_mounting(sample, errors, solution)

    set_unique_name(step_sample, step)
    return kernel(step_sample)


@functools.cache
def _batch_stepper(step: Kernel) -> Kernel:
    """Clock and `_stepper`, for each sample of a batch."""
    step_sample = _stepper(step)

    def step_batch(
        samples: Any, n: int, arrival_ns: int, clock: Any, health: Any, errors: Any, p: Any, s: Any, out: Any
    ) -> None:
        for k in range(n):
            samples[k].t_ns = stamp(clock[0], samples[k].tick, arrival_ns)
            step_sample(health[0], samples[k], errors[0], p[0], s[0], out[k])

    set_unique_name(step_batch, step)
    return inlined(step_batch)


@functools.cache
def _advancer(step: Kernel, parameters: np.dtype[Any], state: np.dtype[Any]) -> Kernel:
    """An estimator's half of `ingest`. parameters, state: of its records."""
    step_batch = _batch_stepper(step)

    def advance_pipeline(pipeline: int, n: int, arrival_ns: int) -> int:
        s = records(pipeline, 1, INERTIAL_PIPELINE)[0]
        samples = records(s.samples, BATCH, SAMPLE)
        samples[0].flags |= s.first_flags
        s.first_flags = 0
        step_batch(
            samples,
            n,
            arrival_ns,
            records(s.clock, 1, CLOCK),
            records(s.health, 1, HEALTH),
            records(s.correction, 1, CORRECTION),
            records(s.parameters, 1, parameters),
            records(s.state, 1, state),
            records(s.solutions, BATCH, SOLUTION),
        )
        return n

    set_unique_name(advance_pipeline, step, parameters, state)
    return entry(advance_pipeline)


@functools.cache
def _feeder(step: Kernel, update: Kernel, aid: Kernel, pending: Kernel) -> Kernel:
    """What `Filter.feed` calls."""
    step_sample = _stepper(step)

    def feed(
        health: Any,
        samples: Any,
        errors: Any,
        p: Any,
        s: Any,
        out: Any,
        fixes: Any,
        fix_before: Any,
        measurements: Any,
        measurement_before: Any,
        innovations: Any,
    ) -> int:
        n = fixed = fused = 0
        for k in range(len(samples) + 1):
            while fused < len(measurements) and measurement_before[fused] <= k:
                n += pending(s[0], innovations[n:])
                n += aid(p[0], s[0], measurements[fused], innovations[n:])
                fused += 1
            while fixed < len(fixes) and fix_before[fixed] <= k:
                n += pending(s[0], innovations[n:])
                n += update(p[0], s[0], fixes[fixed], innovations[n:])
                fixed += 1
            if k < len(samples):
                step_sample(health[0], samples[k], errors[0], p[0], s[0], out[k])
        return n

    set_unique_name(feed, step, update, aid, pending)
    return entry(feed)


@functools.cache
def _aider(aid: Kernel) -> Kernel:
    """What `Filter.aid` calls."""

    def fuse_measurements(p: Any, s: Any, measurements: Any, innovations: Any) -> int:
        n = 0
        for k in range(len(measurements)):
            n += aid(p[0], s[0], measurements[k], innovations[n:])
        return n

    set_unique_name(fuse_measurements, aid)
    return entry(fuse_measurements)


@functools.cache
def _collector(pending: Kernel) -> Kernel:
    """What `Filter.pending_innovations` calls."""

    def innovations_of(state: Any, innovations: Any) -> int:
        return int(pending(state[0], innovations))

    set_unique_name(innovations_of, pending)
    return entry(innovations_of)


def decoding(driver: ImuDriver, decoder: Records) -> int:
    """Address of the compiled driver's half of `ingest`. decoder: its state. Raises ImudError if that lacks a field."""
    if missing := [name for name in DECODER_FIELDS if name not in (decoder.dtype.names or ())]:
        raise ImudError(f"the decoder's state of the driver {driver.name} has no field {', '.join(missing)}")
    return address_of(_decoder(driver.decode, decoder.dtype))


class Stages:
    """What is composed with an estimator."""

    def __init__(self, estimator: Estimator) -> None:
        update, pending = estimator.update or _takes_none, estimator.pending_innovations or _has_none
        self._step = estimator.step
        self.step_batch = _batch_stepper(estimator.step)
        self.feed = _feeder(estimator.step, update, estimator.aid or _takes_none, pending)
        self.pending_innovations = _collector(pending)
        self.aid = estimator.aid and _aider(estimator.aid)

    def advancing(self, parameters: Records, state: Records) -> int:
        """Address of the compiled estimator's half of `ingest`."""
        return address_of(_advancer(self._step, parameters.dtype, state.dtype))
