"""Dialogues of the drivers with emulated devices whose answers are changed as the input says."""

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import msgspec
import numpy as np
from emulated import REST, UTC, Emulated, device
from framer_properties import Decoder
from spi_memory import Memory

from imud.drivers.detect import detect_server
from imud.drivers.driver import AnyDriver, GnssConfigured, Identity, ImuConfigured, Options, SpiDriver, Unsupported
from imud.drivers.registry import by_name
from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.g350 import G350
from imud.firmware_sim.g370 import VARIANTS, Windowed
from imud.firmware_sim.noise import IDEAL, ImuErrors
from imud.firmware_sim.ublox import Ublox

STEP_S = 0.005
LONGEST_S = 900.0  # of a dialogue, on its own clock
MOST_EXCHANGES = 20_000
GREETING = b'{"class":"VERSION","release":"3.22","rev":"3.22","proto_major":3,"proto_minor":14}\r\n'
REPORT = b'{"class":"TPV","device":"/dev/a","mode":3,"time":"2026-11-23T01:10:07.000Z","lat":35.6,"lon":139.7}\r\n'


class Greeter:
    """A gpsd: says the same whatever it is asked."""

    def __init__(self) -> None:
        self.host_baud, self.outgoing = 0, bytearray(GREETING)

    def receive_from(self, data: bytes) -> None:
        if data:
            self.outgoing += REPORT

    def pass_time(self, seconds: float) -> None:
        """It answers at once."""


def _ublox() -> Emulated:
    return Emulated(Ublox(SimulatedFixes(REST, np.random.default_rng(1), UTC, True), UTC, rate_hz=1.0, no_fix_s=0.0))


def _spi(name: str) -> Callable[[], Memory]:
    def made() -> Memory:
        errors = ImuErrors(IDEAL, np.random.default_rng(1), 2000.0)
        sensor = G350(REST, errors, 460800) if name == "g350" else Windowed(VARIANTS[name], REST, errors, 460800)
        return Memory(sensor)

    return made


DEVICES: tuple[tuple[str, Callable[[], object]], ...] = (
    ("epson", lambda: device("g350", 460800)),
    ("epson", lambda: device("g365", 460800)),
    ("epson", _spi("g350")),
    ("epson", _spi("g370")),
    ("crossbow", lambda: device("rga300", 38400)),
    ("seraccel", lambda: device("seraccel", 57600)),
    ("ubx", _ublox),
    ("nmea", lambda: device("nmea", 9600)),
    ("gpsd", Greeter),
)
OPTIONS = (
    Options(),
    Options(rate_hz=2000.0, polled=True, self_test=True, filter_taps=64, fix_rate_hz=10.0, set_up_nmea=True),
    Options(rate_hz=50.0, readonly=True, unchecked=True, keep_baud=True),
)


class Answers:
    """Changes what is received: nothing, all, its end, one byte of it, or what comes before it."""

    def __init__(self, orders: bytes) -> None:
        self._orders = iter(orders)

    def _some(self) -> bytes:
        return bytes(byte for byte, _ in zip(self._orders, range(next(self._orders, 0)), strict=False))

    def changed(self, answer: bytes) -> bytes:
        order = next(self._orders, 0)
        kind, where = order % 6, order // 6
        if kind == 1:
            return self._some()
        if kind == 2:
            return answer[: len(answer) * where // 42]
        if kind == 3 and answer:
            at = len(answer) * where // 43
            return answer[:at] + bytes([next(self._orders, 0)]) + answer[at + 1 :]
        if kind == 4:
            return self._some() + answer
        return b"" if kind == 5 else answer


def _received(exchange: object, unit: Emulated) -> Iterator[bytes]:
    """What has come so far, after each step."""
    if exchange.baud is not None:
        unit.host_baud = exchange.baud
    if exchange.discard:
        unit.outgoing.clear()
    unit.receive_from(exchange.send)
    heard, waited_s = b"", 0.0
    while waited_s < exchange.listen_s:
        unit.pass_time(STEP_S)
        waited_s += STEP_S
        heard += bytes(unit.outgoing)
        unit.outgoing.clear()
        yield heard
    unit.pass_time(STEP_S)


def _converse(dialogue, unit, answers: Answers):
    """The result of a dialogue with a device on a wire."""
    received, passed_s = None, 0.0
    with contextlib.closing(dialogue):
        for _ in range(MOST_EXCHANGES):
            try:
                exchange = dialogue.send(received)
            except StopIteration as ended:
                return ended.value
            passed_s += exchange.listen_s
            assert exchange.listen_s >= 0.0
            assert passed_s < LONGEST_S
            received = b""
            for heard in _received(exchange, unit):
                received = heard
                if exchange.enough and heard and exchange.enough(heard):
                    break
            received = answers.changed(received)
            if exchange.enough:
                exchange.enough(received)
    raise AssertionError("the dialogue does not end")


def _converse_spi(dialogue, bus: Memory, answers: Answers):
    """The same on SPI: the words that come back are changed."""
    words = bus.words
    bus.words = lambda data: answers.changed(words(data))
    return bus.run(dialogue)


def _identified(driver: AnyDriver, unit: object, answers: Answers):
    if isinstance(unit, Memory):
        assert isinstance(driver, SpiDriver)
        return _converse_spi(driver.identify_spi(), unit, answers)
    if isinstance(unit, Greeter):
        return _converse(detect_server(), unit, answers)
    unit.host_baud = unit.unit.uart.baud
    unit.pass_time(1.0)
    return _converse(driver.identify(), unit, answers)


def dialogue(data: bytes) -> None:
    """First byte: which device; second: which options, and whether it is asked at all; then changes to its answers."""
    which, how, answers = data[0] if data else 0, data[1] if len(data) > 1 else 0, Answers(data[2:])
    name, make = DEVICES[which % len(DEVICES)]
    driver, unit = by_name(name), make()
    wired = isinstance(unit, Emulated)
    found = None if how >= 128 else _identified(driver, unit, answers)
    if found is None:  # another driver, or the user, may have named it
        found = Identity(name, "", spi=isinstance(unit, Memory))
    if isinstance(found, Unsupported):
        assert str(found) and msgspec.json.encode(found)
    if not isinstance(found, Identity):
        return
    assert msgspec.json.encode(found)
    if wired:
        found = replace(found, baud=unit.unit.uart.baud)
    wanted = driver.configure(found, OPTIONS[how % len(OPTIONS)])
    converse = _converse_spi if isinstance(unit, Memory) else _converse
    check(driver, converse(wanted, unit, answers))


def check(driver: AnyDriver, configured: object) -> None:
    """The result of a `configure` can be used."""
    assert configured is None or isinstance(configured, Unsupported | GnssConfigured | ImuConfigured)
    if isinstance(configured, ImuConfigured):
        assert 0.0 < configured.rate_hz < math.inf
        assert configured.period_ns > 0 and configured.delay_ns >= 0 and configured.frame_bytes > 0
        assert configured.gyro_range > 0.0 < configured.accel_range
        Decoder(driver, configured).feed(bytes(range(256)))


def recognise(data: bytes) -> None:
    """What a driver makes of a line that it only listens to."""
    for _, name in sorted({(name, name) for name, _ in DEVICES}):
        found = by_name(name).recognise(data)
        assert found is None or msgspec.json.encode(found)


EXAMPLES = tuple(bytes((i, how)) for i in range(len(DEVICES)) for how in range(len(OPTIONS)))
WORDS = (GREETING, REPORT, b"\1\4\x20\0\0\r", b"\6\6\6", b"\5\5\5", b"\4\x10", b"\xb5b", b"\xff\xff", b"\r")
