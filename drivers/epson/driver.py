"""The driver of Epson's inertial sensors on UART and SPI, in both dialects of the family."""

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..dialogue import Dialogue
from ..driver import Identity, ImuConfigured, Options, Request, Unsupported
from .dialects import FLAT, WINDOWED, Dialect, Layout
from .models import G350, Model, model_of
from .passive_identify import passive_identify
from .protocol import describe, synchronize, synchronize_with_retry, with_late_answers
from .registers import burst
from .setup import (
    REQUESTS_PER_SAMPLE,
    choose_layout,
    choose_range,
    enable_data_ready,
    is_configuring,
    is_still_powered,
    nearest_rate,
    possible_rates,
    program,
    reported_faults,
    self_test,
    start,
    to_configuration,
    uart_carries,
    wire_s,
)
from .signatures import is_stream_of
from .spi import fetch, over_spi, spi_carries

NO_RESPONSE = "the sensor does not answer, its stream is used as it is: is the wire to its input (SIN) connected?"


class Epson:
    """The driver."""

    name = "epson"
    bauds = (460800, 230400, 115200, 19200, 9600, 921600)
    timeout_s = 0.5  # four frames at the lowest rate take 0.26 s
    interrupts = True
    fault_texts = MappingProxyType({1: "the sensor reports an error of its own (FLAG bit EA)"})

    @property
    def kind(self) -> Literal["imu"]:
        """The kind of device."""
        return "imu"

    def recognise(self, received: bytes) -> Identity | Unsupported | None:
        """An automatic stream. Only `configure` can read which model of its dialect it is."""
        if is_stream_of(received, FLAT):
            return Identity(self.name, G350.name, profile=G350.profile)
        return Identity(self.name, "") if is_stream_of(received, WINDOWED) else None

    def identify(self) -> Dialogue[Identity | Unsupported | None]:
        """Stop a stream, and query the sensor. Leaves it in configuration mode."""
        dialect, late = yield from synchronize_with_retry()
        if dialect is None:
            return None
        return (yield from with_late_answers(describe(dialect)) if late else describe(dialect))

    def identify_spi(self) -> Dialogue[Identity | Unsupported | None]:
        """See `SpiDriver`."""
        return over_spi(self._identify_spi())

    def _identify_spi(self) -> Dialogue[Identity | Unsupported | None]:
        dialect = yield from synchronize()
        if dialect is None or not (yield from is_configuring(dialect)):  # a dead line reads as zeros
            return None
        found = yield from describe(dialect)
        return replace(found, spi=True) if isinstance(found, Identity) else found

    def configure(self, identity: Identity, options: Options) -> Dialogue[ImuConfigured | Unsupported | None]:
        """The nearest possible rate, the shortest valid filter, COUNT, the finest words, automatic frames.

        On SPI the frames are fetched. Readonly, or a sensor that does not answer: the stream as it is, assumed to have
        the shortest filter of its rate.
        """
        if options.readonly:
            return self._configure_passively(identity, options.model)
        dialogue = self._set_up(identity, options)
        return over_spi(dialogue) if identity.spi else dialogue

    def _configure_passively(
        self, identity: Identity, named: str, warnings: tuple[str, ...] = ()
    ) -> Dialogue[ImuConfigured | Unsupported | None]:
        found = yield from passive_identify(identity, named)
        if not isinstance(found, tuple):
            return found
        identity, model, rate, layout = found
        return configured(identity, model, rate, model.taps(rate), layout, warnings)

    def _set_up(self, identity: Identity, options: Options) -> Dialogue[ImuConfigured | Unsupported | None]:
        dialect, late = yield from synchronize_with_retry()
        if dialect is None:  # it may stream without listening
            return (yield from self._configure_passively(identity, options.model, (NO_RESPONSE,)))
        dialogue = self._program(dialect, identity, options)
        return (yield from with_late_answers(dialogue) if late else dialogue)

    def _program(
        self, dialect: Dialect, identity: Identity, options: Options
    ) -> Dialogue[ImuConfigured | Unsupported | None]:
        described = yield from describe(dialect)
        model = model_of(described.model) if isinstance(described, Identity) else None
        if not isinstance(described, Identity) or model is None:
            return None
        streaming = identity.streaming
        identity = replace(described, baud=identity.baud, spi=identity.spi)
        polled = options.polled and not identity.spi
        warnings = yield from to_configuration(dialect)
        still_powered = yield from is_still_powered(dialect, streaming)
        warnings += yield from reported_faults(dialect)
        warnings += yield from choose_range(model)
        if options.self_test:
            warnings += yield from self_test(dialect)
        baud = identity.baud or self.bauds[0]
        most_hz = spi_carries(dialect) if identity.spi else uart_carries(baud, polled)
        rate, code, layouts = nearest_rate(model, options.rate_hz, most_hz)
        if rate != options.rate_hz:
            line = "on SPI" if identity.spi else f"at {baud} baud"
            listed = ", ".join(f"{hz:g}" for hz in sorted(possible_rates(model, most_hz), reverse=True))
            warnings.append(f"{options.rate_hz:g} samples/s wanted, {rate:g} set; possible {line}: {listed}")
        taps = options.filter_taps or model.taps(rate)
        if taps not in model.possible_taps(rate):
            listed = ", ".join(map(str, model.possible_taps(rate)))
            why = f"imu.filter_taps = {taps} is not possible at {rate:g} samples/s; possible: {listed}, or 0 to choose"
            return Unsupported(self.name, identity.model, why, identity.baud)
        warnings += yield from choose_layout(layouts[:1] if identity.spi else layouts)
        rate, refused = yield from program(model, code, taps, automatic=not (polled or identity.spi))
        yield from enable_data_ready(dialect)
        fetched = fetch(dialect, layouts[0], rate) if identity.spi else None
        layout = yield from start(dialect, polled, fetched)
        if layout is None:
            return None
        found = configured(identity, model, rate, taps, layout, (*warnings, *refused), polled)
        return replace(found, still_powered=still_powered)

    def new_state(self, configured: ImuConfigured) -> NDArray[np.void]:
        """See `ImuDriver`."""
        from .frames import state_for

        return state_for(configured)

    @property
    def decode(self) -> Callable[[NDArray[np.uint8], int, NDArray[np.void], NDArray[np.void]], int]:
        """See `ImuDriver`."""
        from .frames import decode

        return decode


def configured(
    identity: Identity,
    model: Model,
    rate_hz: float,
    taps: int,
    layout: Layout,
    warnings: tuple[str, ...] = (),
    polled: bool = False,
) -> ImuConfigured:
    """The result of `configure`."""
    wire_ns = 0 if identity.spi else round(wire_s(layout, identity.baud or Epson.bauds[0], polled) * 1e9)
    delay_ns = model.delay_ns(taps) + wire_ns
    request = Request(burst(layout.header), round(1e9 / (REQUESTS_PER_SAMPLE * rate_hz))) if polled else None
    gyro_end, accel_end = model.range_lsb
    return ImuConfigured(
        identity,
        rate_hz,
        round(1e9 / rate_hz),
        delay_ns,
        layout.length,
        warnings,
        gyro_range=gyro_end * model.gyro_scale,
        accel_range=accel_end * model.accel_scale,
        request=request,
        has_quartz=True,
    )


DRIVER = Epson()
