"""The two halves of the way from bytes to solutions, as templates: the driver's decoder; then clock, health, estimator.

Each is composed with every driver and every estimator that is used; `ingest` calls the halves by their addresses in the
stream's record. So drivers plus estimators are compiled, not drivers times estimators.
"""

import types
from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.driver import ImuDriver
from drivers.entry import entry
from drivers.sample import POWER_ON, SAMPLE

from .clocks.counter import CLOCK, stamp
from .compile.jit import inlined, kernel
from .compile.system import call, records
from .estimators import Estimator
from .estimators.records import SOLUTION
from .math.arrays import Records
from .sensor_errors.calibration import CORRECTION, correct
from .sensors.health import HEALTH, examine

BATCH = 1024  # samples one call may yield: more than a reading can hold of the shortest frames, lines of 6 bytes
RX = 65536  # bytes
BYTE = np.dtype(np.uint8)

STREAM = np.dtype(
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
        ("heard_ns", "<i8"),  # when it came
        ("power_on", "<i8"),  # 1: the next sample is the first one after a power-on
    ],
    align=True,
)


def _decode(stream: int, received: int) -> int:
    s = records(stream, 1, STREAM)[0]
    state = records(s.decoder, 1, DECODER)  # type: ignore[name-defined]  # noqa: F821
    n: int = decode(  # type: ignore[name-defined]  # noqa: F821
        records(s.rx, RX, BYTE), s.fill + received, state, records(s.samples, BATCH, SAMPLE)
    )
    s.fill = state[0].leftover
    return n


def _advance(stream: int, n: int, arrival_ns: int) -> int:
    s = records(stream, 1, STREAM)[0]
    samples = records(s.samples, BATCH, SAMPLE)
    if s.power_on:
        samples[0].flags |= POWER_ON
        s.power_on = 0
    advance(  # type: ignore[name-defined]  # noqa: F821
        samples,
        n,
        arrival_ns,
        records(s.clock, 1, CLOCK),
        records(s.health, 1, HEALTH),
        records(s.correction, 1, CORRECTION),
        records(s.parameters, 1, PARAMETERS),  # type: ignore[name-defined]  # noqa: F821
        records(s.state, 1, STATE),  # type: ignore[name-defined]  # noqa: F821
        records(s.solutions, BATCH, SOLUTION),
    )
    return n


def _each(
    samples: Any, n: int, arrival_ns: int, clock: Any, health: Any, errors: Any, parameters: Any, state: Any, out: Any
) -> None:
    for k in range(n):
        samples[k].t_ns = stamp(clock[0], samples[k].tick, arrival_ns)
        examine(health[0], samples[k])
        correct(samples[k], errors[0])
        step(parameters[0], state[0], samples[k], out[k])  # type: ignore[name-defined]  # noqa: F821


@entry
def ingest(stream: Records, received: int, arrival_ns: int) -> int:
    """Decode, stamp and step what was written to rx[fill:fill + received]; returns how many solutions are new."""
    s = stream[0]
    n = call(s.decode, (s.at, received))
    if n:
        call(s.advance, (s.at, n, arrival_ns))
        s.count += n
        s.newest = n - 1
        s.heard_ns = arrival_ns
    return int(n)


def _feed(
    health: Any,
    samples: Any,
    errors: Any,
    parameters: Any,
    state: Any,
    out: Any,
    fixes: Any,
    places: Any,
    innovations: Any,
) -> int:
    n = fed = 0
    for k in range(len(samples) + 1):
        while fed < len(fixes) and places[fed] <= k:
            n += told(state[0], innovations[n:])  # type: ignore[name-defined]  # noqa: F821
            n += update(parameters[0], state[0], fixes[fed], innovations[n:])  # type: ignore[name-defined]  # noqa: F821
            fed += 1
        if k < len(samples):
            examine(health[0], samples[k])
            correct(samples[k], errors[0])
            step(parameters[0], state[0], samples[k], out[k])  # type: ignore[name-defined]  # noqa: F821
    return n


def _told(state: Any, innovations: Any) -> int:
    n: int = told(state[0], innovations)  # type: ignore[name-defined]  # noqa: F821
    return n


@kernel
def _takes_none(parameters: Any, state: Any, fix: Any, innovations: Any) -> int:
    """The `update` of an estimator that takes no fixes."""
    return 0


@kernel
def _tells_none(state: Any, innovations: Any) -> int:
    """The `told` of an estimator whose steps make no innovations."""
    return 0


_composed: dict[str, Any] = {}


def _compose(how: Callable[..., Any], template: Callable[..., Any], name: str, **parts: Any) -> Any:
    """The template with its free names bound to `parts`, under a name of its own, by which its code is cached."""
    if name not in _composed:
        bound = types.FunctionType(template.__code__, {**globals(), **parts}, name)
        bound.__qualname__ = name
        _composed[name] = how(bound)
    return _composed[name]


def decoding(driver: ImuDriver, decoder: Records) -> int:
    """Address of the compiled driver's half of `ingest`; compiles it if need be."""
    parts = {"decode": driver.decode, "DECODER": decoder.dtype}
    return int(_compose(entry, _decode, f"decode_{driver.name}", **parts).address)


class Stages:
    """What is composed with an estimator; each is compiled when it is first called."""

    def __init__(self, estimator: Estimator) -> None:
        self._stem = estimator.name.replace("-", "_")
        step, told, update = estimator.step, estimator.told or _tells_none, estimator.update or _takes_none
        self.each = _compose(inlined, _each, f"each_{self._stem}", step=step)
        self.feed = _compose(entry, _feed, f"feed_{self._stem}", step=step, told=told, update=update)
        self.told = _compose(entry, _told, f"told_{self._stem}", told=told)

    def advancing(self, parameters: Records, state: Records) -> int:
        """Address of the estimator's half of `ingest`; compiles it if need be."""
        parts = {"advance": self.each, "PARAMETERS": parameters.dtype, "STATE": state.dtype}
        return int(_compose(entry, _advance, f"advance_{self._stem}", **parts).address)
