"""Configuring an Epson sensor, and starting its automatic stream: the same dialogue in both dialects."""

import math
from collections.abc import Callable, Sequence

from ..dialogue import Dialogue, Exchange
from ..spi import Fetch
from .dialects import Dialect, Layout
from .models import Model
from .protocol import STOP_ATTEMPTS, STOP_S, read_register, select_window, send_commands, wait_ready, write_register
from .registers import (
    ALL_NEW,
    AUTO,
    AUTO_START,
    CONFIGURE,
    CONFIGURING,
    CR,
    DATA_READY,
    HARD_ERROR,
    POLLED,
    RESET,
    SAMPLE,
    TEST,
    TEST_FAILED,
    TESTING,
    Register,
    Setting,
    burst,
    write,
)
from .signatures import layout_of

RESET_S = 0.8
TEST_POLLS, TEST_S = 10, 0.1  # it takes 80 to 150 ms
STREAM_S = 1.0
WIRE_SHARE = 0.96  # of the line's capacity that a stream may take
REQUESTS_PER_SAMPLE = 1.25  # in polled mode: no sample is missed although the two clocks are not in step
COMMAND_BYTES, STALL_S = 3, 90e-6  # of a request; its time besides the bytes (M-G362PDC1 data sheet, timing)
SAMPLE_ANSWERS, POLL_S = 4, 0.05  # polled frames that show the layout; time for each
WRITES = 3  # attempts for a setting that the sensor does not keep: the command may have been damaged
FILTER_CODE = 0x1F  # of the filter register; the bit above is set while the filter changes


def is_configuring(dialect: Dialect) -> Dialogue[bool]:
    """Whether the sensor reports that it is in configuration mode."""
    mode = yield from read_register(dialect.mode)
    return mode is not None and bool(mode & CONFIGURING)


def to_configuration(dialect: Dialect) -> Dialogue[list[str]]:
    """Enter configuration mode, by a reset if need be; returns warnings."""
    for attempt in range(STOP_ATTEMPTS + 1):
        if (yield from is_configuring(dialect)):
            return []
        if attempt < STOP_ATTEMPTS - 1:
            yield from write_register(dialect.mode, high=CONFIGURE)
            yield Exchange(listen_s=STOP_S)
        elif attempt == STOP_ATTEMPTS - 1:
            yield from write_register(dialect.command, low=RESET)
            yield Exchange(listen_s=RESET_S)
            yield from wait_ready(dialect)
    return ["the sensor does not confirm configuration mode"]


def is_still_powered(dialect: Dialect, streaming: bool) -> Dialogue[bool]:
    """Whether a sensor, in configuration mode now, has been on since somebody set it up: by `streaming` when found.

    After a power-on or a reset it does not stream, unless AUTO_START is set in its flash.
    """
    word = (yield from read_register(dialect.uart)) if streaming else None
    return word is not None and word & (AUTO | AUTO_START) == AUTO


def reported_faults(dialect: Dialect) -> Dialogue[list[str]]:
    """The faults that the sensor reports, as warnings."""
    diagnosis = (yield from read_register(dialect.diagnosis)) or 0
    broken = diagnosis & HARD_ERROR
    return [f"the sensor reports a hardware error (DIAG_STAT {diagnosis:#06x})"] if broken else []


def choose_range(model: Model) -> Dialogue[list[str]]:
    """Set the accelerometer range for which the scale factors are valid; returns warnings."""
    kept = yield from write_verified(model.settings)
    return [] if kept else [f"the sensor does not keep the range of {model.accel_range_g:g} G: its scale may be wrong"]


def self_test(dialect: Dialect) -> Dialogue[list[str]]:
    """Run the sensor's self test, in configuration mode and at rest; returns warnings."""
    yield from write_register(dialect.test, high=TEST)
    for _ in range(TEST_POLLS):
        yield Exchange(listen_s=TEST_S)
        word = yield from read_register(dialect.test)
        if word is not None and not word & TESTING:
            diagnosis = (yield from read_register(dialect.diagnosis)) or 0
            failed = diagnosis & TEST_FAILED
            return [f"the sensor's self test failed (DIAG_STAT {diagnosis:#06x})"] if failed else []
    return ["the sensor's self test does not end"]


Fastest = Callable[[Layout], float]  # samples per second that a line carries


def uart_carries(baud: int, polled: bool) -> Fastest:
    """What a serial line carries."""

    def most_hz(layout: Layout) -> float:
        if polled:
            return 1.0 / (REQUESTS_PER_SAMPLE * (wire_s(layout, baud, polled) + STALL_S))
        return WIRE_SHARE / wire_s(layout, baud, polled)

    return most_hz


def wire_s(layout: Layout, baud: int, polled: bool) -> float:
    """Time on the line of a frame and, if polled, of the request for it."""
    return (layout.length + COMMAND_BYTES * polled) * 10 / baud


def nearest_rate(model: Model, wanted_hz: float, most_hz: Fastest) -> tuple[float, int, tuple[Layout, ...]]:
    """Rate nearest to `wanted_hz` that fits on the line, its code, and the layouts with which it does, best first."""
    layouts = model.dialect.layouts
    possible = possible_rates(model, most_hz)
    rate = min(possible, key=lambda hz: abs(math.log(hz / wanted_hz)))
    return rate, possible[rate], tuple(layout for layout in layouts if rate <= most_hz(layout)) or layouts[-1:]


def possible_rates(model: Model, most_hz: Fastest) -> dict[float, int]:
    """The rates that fit on the line, with their codes; the slowest, if none does."""
    limit = max(most_hz(layout) for layout in model.dialect.layouts)
    rates = {hz: code for code, hz in model.rates.items()}
    return {hz: code for hz, code in rates.items() if hz <= limit} or {min(rates): rates[min(rates)]}


def program(model: Model, code: int, taps: int, automatic: bool) -> Dialogue[tuple[float, list[str]]]:
    """Write rate, filter and UART mode, and read them back; returns the true rate and warnings."""
    dialect, rate, warnings = model.dialect, model.rates[code], list[str]()
    filter_code = model.tap_codes[taps]
    for _ in range(WRITES):
        yield from write_register(dialect.rate, high=code)
        yield from write_register(dialect.filter, low=filter_code)
        yield from write_register(dialect.uart, low=AUTO if automatic else POLLED)
        kept_rate = yield from kept_bits(dialect.rate, code << 8, 0xFF00)
        kept_filter = yield from kept_bits(dialect.filter, filter_code, FILTER_CODE)
        if (kept_rate >> 8, kept_filter) == (code, filter_code):
            break
    if kept_rate >> 8 != code:
        rate = dialect.rates.get(kept_rate >> 8, rate)
        warnings.append(f"the sensor keeps rate code {kept_rate >> 8} instead of {code}: taken as {rate:g} samples/s")
    if kept_filter != filter_code:
        warnings.append(f"the sensor keeps filter code {kept_filter} instead of {filter_code}")
    return rate, warnings


def kept_bits(register: Register, wanted: int, bits: int) -> Dialogue[int]:
    """Those `bits` of a register as the sensor keeps them; taken as `wanted` if the sensor does not answer."""
    word = yield from read_register(register)
    return wanted if word is None else word & bits


def enable_data_ready(dialect: Dialect) -> Dialogue[None]:
    """Enable the new-data bits of FLAG and the data-ready line, and end an external trigger of another host's."""
    yield from write_register(dialect.signal, high=ALL_NEW)
    yield from write_register(dialect.test, low=DATA_READY)


def write_verified(settings: Sequence[Setting]) -> Dialogue[bool]:
    """Write registers and read them back; whether the sensor keeps the values, as far as they can be read."""
    for _ in range(WRITES):
        for register, low, high in settings:
            yield from write_register(register, low, high)
        kept = True
        for register, low, high in settings:
            word = yield from read_register(register)
            kept &= word is None or (low in (None, word & 0xFF) and high in (None, word >> 8))
        if kept:
            break
    return kept


def choose_layout(layouts: Sequence[Layout]) -> Dialogue[list[str]]:
    """Ask for the first of `layouts` that the sensor keeps; returns warnings."""
    for layout in layouts:
        if (yield from write_verified(layout.settings)):
            return [layout.drawback] if layout.drawback else []
    return ["the sensor does not keep the selected contents of its frames"]


def start(dialect: Dialect, polled: bool, fetch: Fetch | None = None) -> Dialogue[Layout | None]:
    """Begin sampling; returns the layout of the frames that come, or are fetched; None if none are.

    Leaves window 0 open.
    """
    for _ in range(2):
        yield from select_window(dialect.mode)
        if polled:
            yield from send_commands(write(dialect.mode.address + 1, SAMPLE))
            if layout := layout_of((yield from request(dialect)), dialect.layouts):
                return layout
            continue
        received = yield Exchange(
            write(dialect.mode.address + 1, SAMPLE),
            STREAM_S,
            enough=lambda received: layout_of(received, dialect.layouts) is not None,
            discard=True,
            spi=fetch,
        )
        if layout := layout_of(received, dialect.layouts):
            return layout
    return None


def request(dialect: Dialect) -> Dialogue[bytes]:
    """A few polled frames."""
    shortest = min(layout.length for layout in dialect.layouts)
    received = b""
    for _ in range(SAMPLE_ANSWERS):
        received += yield Exchange(
            burst(dialect.header),
            POLL_S,
            enough=lambda answer: len(answer) >= shortest and answer[-1] == CR,
            discard=True,
        )
    return received
