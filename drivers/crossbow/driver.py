"""The driver of Crossbow's DMU RGA300CA on a UART: three accelerometers, one gyro about its z axis, its own tilt.

The unit sends at a rate of its own, which is measured. It reports gravity, +1 g on z when level; samples are specific
force.
"""

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..dialogue import Dialogue, Exchange
from ..driver import Identity, ImuConfigured, Options, Request, Unsupported
from .packet import (
    ACCEL_FAILED,
    ACCEL_SCALE,
    BIT,
    CONVENTIONS,
    FAULT_TEXTS,
    LENGTH,
    PART,
    RANGE_LSB,
    RATE_SCALE,
    SURE,
    TICK_NS,
    TIMER,
    ZERO_INVALID,
    word,
)
from .protocol import ask_packets, describe, ping, sustained_rate, unsupported
from .services import SERVICES
from .signatures import convention, is_stream, relative, scan
from .timer import spacing_ns

START_S = 0.2
RATE_S = 1.0  # for which the stream is counted
TURN_S = 1e-3  # from a request to its answer, at most
PART_NUMBER = 300
ABILITIES = (False, False, True), RANGE_LSB * RATE_SCALE, RANGE_LSB * ACCEL_SCALE  # gyro axes; ranges
BAUD = 38400
POLLED_ONLY = "it does not stream: it is polled for each packet"


class Crossbow:
    """The driver."""

    name = "crossbow"
    bauds = (BAUD,)
    timeout_s = 0.5
    interrupts = True
    fault_texts = MappingProxyType(FAULT_TEXTS)
    services = MappingProxyType(SERVICES)

    @property
    def kind(self) -> Literal["imu"]:
        """The kind of device."""
        return "imu"

    def recognise(self, received: bytes) -> Identity | Unsupported | None:
        """A continuous stream."""
        if is_stream(received):
            return Identity(self.name, "DMU RGA300CA", profile="crossbow-dmu")
        model = relative(received)
        return unsupported(self.name, model) if model else None

    def identify(self) -> Dialogue[Identity | Unsupported | None]:
        """Stop a stream, and query the unit. Leaves it in polled mode."""
        return (yield from describe(self.name)) if (yield from ping()) else None

    def configure(self, identity: Identity, options: Options) -> Dialogue[ImuConfigured | None]:
        """Continuous mode, at a rate of the unit's own; or polled, at `options.rate_hz` if the line carries that."""
        polled = options.polled and not options.readonly
        if not options.readonly:
            found = yield from self.identify()
            if isinstance(found, Unsupported):
                return None
            if found is not None:  # else it may stream without listening
                identity = replace(found, baud=identity.baud)
        if polled:
            return (yield from self._polled(identity, options.rate_hz))
        if not options.readonly:
            yield Exchange(b"C", START_S, discard=True)
        received = yield Exchange(listen_s=RATE_S, discard=True)
        summed = convention(received)
        starts = scan(received, summed or 0)
        if summed is None or len(starts) < 2:
            return None if options.readonly else (yield from self._polled(identity, options.rate_hz, (POLLED_ONLY,)))
        timers = [word(received, p + TIMER) for p in starts]
        packets = max(len(starts), len(received) / LENGTH)  # a disturbed line carries the others, too, but not whole
        rate_hz = rounded_rate(1e9 / spacing_ns(timers, RATE_S * 1e9 / packets))
        wire_ns = round(LENGTH * 10 / (identity.baud or BAUD) * 1e9)
        warnings = warnings_of(received[starts[-1] :], summed)
        return ImuConfigured(identity, rate_hz, TICK_NS, wire_ns, LENGTH, warnings, *ABILITIES)

    def _polled(
        self, identity: Identity, wanted_hz: float, warnings: tuple[str, ...] = ()
    ) -> Dialogue[ImuConfigured | None]:
        """As `configure`, for a unit that is polled for each packet."""
        received = yield from ask_packets(SURE + 1)
        summed = convention(received)
        if summed is None:
            return None
        wire_s = (1 + LENGTH) * 10 / (identity.baud or BAUD)
        rate_hz = rounded_rate((yield from sustained_rate(min(wanted_hz, rounded_rate(1.0 / (wire_s + TURN_S))))))
        warnings += warnings_of(received[scan(received, summed)[-1] :], summed)
        if rate_hz < wanted_hz:
            warnings += (f"{wanted_hz:g} samples/s wanted, {rate_hz:g} can be polled",)
        ask = Request(b"G", round(1e9 / rate_hz))
        return ImuConfigured(identity, rate_hz, TICK_NS, round(wire_s * 1e9), LENGTH, warnings, *ABILITIES, ask)

    def new_state(self, configured: ImuConfigured) -> NDArray[np.void]:
        """See `ImuDriver`."""
        from .frames import new_state

        return new_state(configured.rate_hz)

    @property
    def decode(self) -> Callable[[NDArray[np.uint8], int, NDArray[np.void], NDArray[np.void]], int]:
        """See `ImuDriver`."""
        from .frames import decode

        return decode


def rounded_rate(rate_hz: float) -> float:
    """Rounded, so that the same unit gets the same rate at each start."""
    return float(round(rate_hz)) if rate_hz >= 10.0 else round(rate_hz, 1)


def warnings_of(packet: bytes, summed: int) -> tuple[str, ...]:
    """Warnings of the properties in which this unit differs from the known one."""
    part, bit = word(packet, PART), word(packet, BIT)
    cases = (
        (summed != 0, f"its checksum is the {CONVENTIONS[summed]}, not the {CONVENTIONS[0]}"),
        (part != PART_NUMBER, f"part number {part} instead of {PART_NUMBER}: ranges may differ"),
        (bool(bit & ACCEL_FAILED), f"it reports a failed accelerometer (BIT {bit:#06x})"),
        (bool(bit & ZERO_INVALID), f"it reports an invalid gyro zero (BIT {bit:#06x})"),
        (bool(bit & ~(ACCEL_FAILED | ZERO_INVALID)), f"BIT {bit:#06x}: meaning not known"),
    )
    return tuple(text for differs, text in cases if differs)


DRIVER = Crossbow()
