"""The dialogue that sets a receiver up: which messages on this port, fixes per second, baud rate. All of it in RAM.

Generation 9 and later take keys and values (CFG-VALSET), older ones a message for each setting (CFG-MSG, CFG-RATE,
CFG-PRT). Every command is acknowledged by ACK-ACK or ACK-NAK; one that is not answered is repeated. A receiver that
lacks an optional message answers ACK-NAK, and does without. Nothing here survives a power cycle.
Source: u-blox F9 HPG 1.32 interface description, 3.10 (CFG) and 6 (keys); u-blox M8 receiver description, 32.10.
"""

import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from ..dialogue import Dialogue, Exchange
from . import messages
from .frames import Frame, Framer, frame
from .messages import Kind

ACK, NAK = (0x05, 0x01), (0x05, 0x00)
CFG_PRT, CFG_MSG, CFG_RATE, CFG_VALSET = (0x06, 0x00), (0x06, 0x01), (0x06, 0x08), (0x06, 0x8A)
RAM = 1  # layer
TRIES = 3
ANSWER_S = 0.5
BACKLOG = 1024  # bytes that the receiver may send before it answers
BITS = 10  # on the wire per byte
SETTLE_S = 2.5  # time after a change in which messages of the receiver must arrive
FAST_BAUD = 115200
LOAD_MAX = 0.7  # of the line, at most
EPOCH_BYTES, SKY_BYTES = 312, 500  # all messages of an epoch; NAV-SAT with 40 satellites
FIRST_WITH_KEYS = 27.0  # protocol version
UART1, UART2, USB = 1, 2, 3  # CFG-PRT's numbers of the ports
UBX_OUT = 1  # in CFG-PRT's mask of protocols
GPS_TIME = 1

RATE_MEAS, RATE_NAV = 0x30210001, 0x30210002
BAUDRATE = {UART1: 0x40520001, UART2: 0x40530001}
OUT_UBX = {UART1: 0x10740001, UART2: 0x10760001, USB: 0x10780001}
OUT_NMEA = {UART1: 0x10740002, UART2: 0x10760002, USB: 0x10780002}
KEY_OF_MESSAGE: dict[Kind, int] = {  # on UART1; on the other ports it is as much higher as their number
    messages.NAV_PVT: 0x20910007,
    messages.NAV_EOE: 0x20910160,
    messages.NAV_COV: 0x20910084,
    messages.NAV_DOP: 0x20910039,
    messages.NAV_TIMEUTC: 0x2091005C,
    messages.NAV_STATUS: 0x2091001B,
    messages.NAV_RELPOSNED: 0x2091008E,
    messages.NAV_SAT: 0x20910016,
    messages.SEC_SIG: 0x20910635,
    messages.MON_HW: 0x209101B5,
}
OPTIONAL_EACH_EPOCH = (
    messages.NAV_EOE,
    messages.NAV_COV,
    messages.NAV_DOP,
    messages.NAV_STATUS,
    messages.NAV_RELPOSNED,
)
EACH_SECOND = (messages.NAV_SAT, messages.SEC_SIG)
EACH_SECOND_BEFORE_KEYS = (messages.NAV_SAT, messages.MON_HW)
NMEA_SENTENCES = [(0xF0, number) for number in (0, 1, 2, 3, 4, 5, 8)]  # GGA GLL GSA GSV RMC VTG ZDA
_SIZES = {1: "B", 2: "B", 3: "H", 4: "I"}  # of a value, by the key's bits 28 to 30


@dataclass(frozen=True)
class Version:
    """MON-VER."""

    model: str
    firmware: str
    protocol: float  # 0: not reported


@dataclass(frozen=True)
class Outcome:
    """The result. baud: the receiver's, now; None: nothing is received any more."""

    baud: int | None
    problem: str = ""


def frames(received: bytes) -> Sequence[Frame]:
    """Those with the right checksum."""
    return list(Framer(Counter()).feed(received, 0))


def values(pairs: Sequence[tuple[int, int]]) -> bytes:
    """CFG-VALSET of keys and values, for RAM."""
    packed = b"".join(struct.pack("<I" + _SIZES[key >> 28 & 7], key, value) for key, value in pairs)
    return frame(CFG_VALSET, bytes((0, RAM, 0, 0)) + packed)


def version(baud: int | None, tries: int = TRIES) -> Dialogue[Version | None]:
    """Ask for MON-VER. baud: None while the detection looks for the speed."""
    payload = yield from _poll(messages.MON_VER, baud, tries)
    return None if payload is None else _version(payload)


def _version(payload: bytes) -> Version:
    texts = [payload[:30], payload[30:40], *(payload[i : i + 30] for i in range(40, len(payload), 30))]
    software, hardware, *extensions = (text.split(b"\0")[0].decode("latin-1").strip() for text in texts)
    parts = (text.partition("=" if "=" in text else " ") for text in extensions)
    named = {name: value for name, _, value in parts}
    try:
        protocol = float(named.get("PROTVER", "0"))
    except ValueError:
        protocol = 0.0
    return Version(f"u-blox {named.get('MOD', hardware)}", named.get("FWVER", software), protocol)


def set_up(found: Version, baud: int, rate_hz: float, keep_baud: bool) -> Dialogue[Outcome]:
    """Have the receiver send what the decoder uses, `rate_hz` times a second if that fits through the line."""
    port_payload = yield from _poll(CFG_PRT, baud, 1 if found.protocol > FIRST_WITH_KEYS else TRIES)
    port = port_payload[0] if port_payload and port_payload[0] in OUT_UBX else None
    with_keys = found.protocol >= FIRST_WITH_KEYS
    if port != USB and not keep_baud and baud < FAST_BAUD:
        change = values([(BAUDRATE[port or UART1], FAST_BAUD)]) if with_keys else _port(port_payload)
        now = yield from _change_baud(change, baud, FAST_BAUD)
        if now is None:
            return Outcome(None)
        baud = now
    problem = ""
    if port != USB and (fits := _rate_that_fits(baud)) < rate_hz:
        problem, rate_hz = f"{rate_hz:g} fixes a second do not fit through {baud} baud: {fits:g} instead", fits
    configure = _with_keys if with_keys else _with_messages
    refused = yield from configure(port, rate_hz, baud)
    return Outcome(baud, refused or problem)


def _rate_that_fits(baud: int) -> float:
    return max(1.0, float(int((LOAD_MAX * baud / BITS - SKY_BYTES) / EPOCH_BYTES)))


def _with_keys(port: int | None, rate_hz: float, baud: int) -> Dialogue[str]:
    """Set up by keys; the problem, empty if there was none. port: None where it is not known."""
    once_a_second = max(1, round(rate_hz))
    rate = [(RATE_MEAS, _interval_ms(rate_hz)), (RATE_NAV, 1)]
    for ports in ((port,),) if port else ((UART1, USB), (UART1,)):  # a key of a port that is not there is rejected
        needed = [*_message_rates(messages.NAV_PVT, 1, ports), *((OUT_UBX[one], 1) for one in ports)]
        if (yield from _execute(values([*needed, *rate]), baud)):
            break
    else:
        return "it rejects CFG-VALSET for NAV-PVT and the rate"
    for kind in OPTIONAL_EACH_EPOCH:
        yield from _execute(values(_message_rates(kind, 1, ports)), baud)
    for kind in EACH_SECOND:
        yield from _execute(values(_message_rates(kind, once_a_second, ports)), baud)
    yield from _execute(values([(OUT_NMEA[one], 0) for one in ports]), baud)
    return ""


def _message_rates(kind: Kind, every: int, ports: Sequence[int]) -> list[tuple[int, int]]:
    """Keys and values that send a message on these ports at every n-th epoch, n = `every`."""
    return [(KEY_OF_MESSAGE[kind] + one - UART1, every) for one in ports]


def _with_messages(_: int | None, rate_hz: float, baud: int) -> Dialogue[str]:
    """Set up by a message for each setting; they concern the port through which they come."""
    if not (yield from _execute(_message(messages.NAV_PVT, 1), baud)):
        return "it has no NAV-PVT"
    for kind in OPTIONAL_EACH_EPOCH:
        yield from _execute(_message(kind, 1), baud)
    for kind in EACH_SECOND_BEFORE_KEYS:
        yield from _execute(_message(kind, max(1, round(rate_hz))), baud)
    for sentence in NMEA_SENTENCES:
        yield from _execute(_message(sentence, 0), baud)
    rate = struct.pack("<HHH", _interval_ms(rate_hz), 1, GPS_TIME)
    return "" if (yield from _execute(frame(CFG_RATE, rate), baud)) else f"it rejects {rate_hz:g} fixes a second"


def _interval_ms(rate_hz: float) -> int:
    return round(1000.0 / rate_hz)


def _message(kind: Kind, every: int) -> bytes:
    """CFG-MSG: send a message at every n-th epoch, n = `every`; 0: never."""
    return frame(CFG_MSG, bytes((*kind, every)))


def _port(payload: bytes | None) -> bytes:
    """CFG-PRT with another baud rate, and UBX among what is sent; empty if the port is not known."""
    if payload is None or len(payload) < 20:
        return b""
    mask = int.from_bytes(payload[14:16], "little") | UBX_OUT
    return frame(
        CFG_PRT, payload[:8] + struct.pack("<I", FAST_BAUD) + payload[12:14] + struct.pack("<H", mask) + payload[16:]
    )


def _answer_s(baud: int) -> float:
    return ANSWER_S + BACKLOG * BITS / baud


def _has(received: bytes, test: Callable[[Frame], bool]) -> bool:
    return any(map(test, frames(received)))


def _poll(kind: Kind, baud: int | None, tries: int) -> Dialogue[bytes | None]:
    """Ask for a message; its payload."""

    def answers(received: bytes) -> list[bytes]:
        return [one.payload for one in frames(received) if one.kind == kind and one.payload]

    def is_answered(received: bytes) -> bool:
        return bool(answers(received))

    listen_s, answer_bytes = (_answer_s(baud), 0) if baud else (ANSWER_S, BACKLOG)
    for _ in range(tries):
        received = yield Exchange(frame(kind), listen_s, is_answered, answer_bytes=answer_bytes)
        if found := answers(received):
            return found[-1]
    return None


def _execute(command: bytes, baud: int) -> Dialogue[bool]:
    """Send a command until it is answered; whether it was done."""
    whose = command[2:4]

    def is_answer(one: Frame) -> bool:
        return one.kind in (ACK, NAK) and one.payload[:2] == whose

    for _ in range(TRIES):
        received = yield Exchange(command, _answer_s(baud), partial(_has, test=is_answer))
        if answers := [one.kind for one in frames(received) if is_answer(one)]:
            return answers[-1] == ACK
    return False


def _change_baud(command: bytes, old: int, new: int) -> Dialogue[int | None]:
    """Change the receiver's speed and that of the line; returns the one at which it then answers, None if at neither.

    The acknowledgement may come at either speed, so only an answer at the new one counts.
    """
    if not command:
        return old
    for _ in range(TRIES):
        yield Exchange(command, _answer_s(old) / 2.0, partial(_has, test=lambda one: one.kind in (ACK, NAK)))
        yield Exchange(baud=new, discard=True)
        if (yield from version(new, 1)):
            return new
        yield Exchange(baud=old, discard=True)
        if not (yield from version(old, 1)):
            return None
    return old


def streams() -> Dialogue[bool]:
    """Whether NAV-PVT comes by itself."""
    is_pvt: Callable[[Frame], bool] = lambda one: one.kind == messages.NAV_PVT  # noqa: E731
    received = yield Exchange(listen_s=SETTLE_S, enough=partial(_has, test=is_pvt))
    return _has(received, is_pvt)
