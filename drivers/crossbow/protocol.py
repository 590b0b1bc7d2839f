"""Commands of a Crossbow DMU: single letters, most of them answered.

    R -> H ping   P polled   C continuous   G -> packet   S -> FF, serial number, its byte sum   v or V -> FF, text, $
    z n -> Z when the gyro's zero is found, over n hundred samples   b -> B, then a at the new speed -> A

Sources: Prasanna (2009), table "IMU Commands"; VRPN's vrpn_Tracker_Crossbow; Moog Crossbow manual 7430-0280-01.
"""

from ..dialogue import Dialogue, Exchange
from ..driver import Identity, Unsupported
from .packet import CONVENTIONS, HEADER, LENGTH, is_packet
from .signatures import RELATIVES, is_stream, without_packets

QUIET_S = 0.05  # after P, until the last packet is through
FIRST_ANSWER_S, LATE_S = 0.1, 0.15  # short, as most lines that are pinged have no unit at their end
ANSWER_S = 0.6  # for any answer: a unit takes milliseconds; an emulator, or a line through a network, longer
RATE_REQUESTS, RATE_TRIES, SLOWEST_HZ = 8, 2, 1.0  # requests that show whether a unit keeps up
TRIES = 3
EXTRA_S = 0.05  # in which a packet longer than the RGA's would continue
ZERO_S = 0.5  # at most, for a hundred samples: VRPN found 3 to 4 ms each
ZERO_MARGIN_S, ZERO_MAX_S = 5.0, 120.0


def stop() -> Dialogue[None]:
    """End a running stream, and discard its last bytes."""
    yield Exchange(b"P", QUIET_S, discard=True)


def ping() -> Dialogue[bool]:
    """Whether a device answers as a DMU does, and sends nothing else."""
    for _ in range(TRIES):
        yield from stop()
        received = yield Exchange(b"R", FIRST_ANSWER_S, enough=is_pong, discard=True)
        received = received or (yield Exchange(listen_s=LATE_S, enough=is_pong, optional=True))
        if received.strip() == b"H":
            return True
        if not received:
            return False
    return False


def is_pong(received: bytes) -> bool:
    """Whether this is the answer to R."""
    return received == b"H"


def serial_number() -> Dialogue[str]:
    """In decimal, or the text that Prasanna's table promises; empty if the answer is neither."""
    reply = yield Exchange(b"S", ANSWER_S, enough=is_serial_number, discard=True)
    return str(int.from_bytes(reply[1:5], "big")) if is_serial_number(reply) else printable_text(reply)


def is_serial_number(reply: bytes) -> bool:
    """Whether this is the binary form that VRPN found."""
    return len(reply) == 6 and reply[0] == 0xFF and sum(reply[1:5]) & 0xFF == reply[5]


def printable_text(reply: bytes) -> str:
    """The reply as one line of text; empty if it is none."""
    text = reply.strip(b"\0 \r\n")
    return text.decode("ascii") if text.isascii() and text.decode("ascii").isprintable() else ""


def version() -> Dialogue[str]:
    """The unit's own description; empty if it gives none."""
    for command in (b"v", b"V"):
        reply = yield Exchange(
            command, ANSWER_S, enough=lambda received: b"$" in received or HEADER in received, discard=True
        )
        if text := printable_text(reply.partition(b"$")[0].partition(HEADER)[0].removeprefix(b"\xff")):
            return text
    return ""


def ask_packets(n: int) -> Dialogue[bytes]:
    """The answers of a polled unit to n requests for a packet; empty if the first is not answered."""
    received = b""
    for _ in range(n):
        answer = yield Exchange(b"G", ANSWER_S, enough=lambda answer: len(answer) >= LENGTH, discard=True)
        if not answer:
            break
        received += answer
    return received


def sustained_rate(wanted_hz: float) -> Dialogue[float]:
    """The rate at which a polled unit has answered each request before the next: at a higher one it would fall behind.

    The wanted one, or a half, a quarter … of it.
    """
    rate_hz = wanted_hz
    while rate_hz > SLOWEST_HZ:
        for _ in range(RATE_TRIES):
            received = b""
            for _ in range(RATE_REQUESTS):
                received += yield Exchange(b"G", 1.0 / rate_hz)
            if len(received) >= RATE_REQUESTS * LENGTH:
                return rate_hz
            yield Exchange(listen_s=ANSWER_S)  # late answers
        rate_hz *= 0.5
    return rate_hz


def describe(name: str) -> Dialogue[Identity | Unsupported | None]:
    """The identity of the unit that answers, by a packet of it. None: none that is known."""
    packet = yield Exchange(b"G", ANSWER_S, enough=lambda received: len(received) >= LENGTH, discard=True)
    received = b""
    if len(packet) >= LENGTH:
        packet += yield Exchange(listen_s=EXTRA_S)
    else:
        received = yield Exchange(b"C", ANSWER_S, enough=is_stream, discard=True)
        yield from stop()
    serial = yield from serial_number()
    firmware = yield from version()
    if is_stream(received) or any(is_packet(packet, convention) for convention in range(len(CONVENTIONS))):
        return Identity(name, "DMU RGA300CA", serial, firmware, profile="crossbow-dmu")
    for kind in RELATIVES:
        if kind.is_packet(packet):
            return unsupported(name, f"{kind.name}: {firmware}" if firmware else kind.name)
    if serial:
        model = f"Crossbow DMU {firmware or 'of an unknown model'}"
        return Unsupported(name, model, "no whole packet of the RGA300CA's angle mode comes from it")
    return None


def unsupported(name: str, model: str) -> Unsupported:
    """A related model."""
    return Unsupported(name, model, "this driver speaks the RGA300CA's angle mode")


def find_zero(hundreds: int) -> Dialogue[bool]:
    """Have the unit average its gyro over that many hundred samples at rest (1 to 255), and subtract the mean.

    Ends a stream. False: the unit did not report the end.
    """
    yield from stop()
    longest_s = min(ZERO_MAX_S, ZERO_S * hundreds + ZERO_MARGIN_S)
    received = yield Exchange(
        bytes((ord("z"), hundreds)), longest_s, enough=lambda received: b"Z" in without_packets(received), discard=True
    )
    return b"Z" in without_packets(received)


def change_baud(baud: int) -> Dialogue[bool]:
    """Change the baud rate. False: the unit did not change; the line is at the new baud rate in both cases."""
    yield from stop()
    received = yield Exchange(b"b", ANSWER_S, enough=lambda received: received == b"B", discard=True)
    if received != b"B":
        return False
    received = yield Exchange(b"a", ANSWER_S, enough=lambda received: received == b"A", baud=baud, discard=True)
    return received == b"A"
