"""Registers of an Epson sensor over its UART: synchronize in any state and dialect; read its identity.

A sensor answers within microseconds, so an empty line is detected quickly. A device that answers late (an emulator, a
line through a network) is recognised by its late answers to the first queries, and is given longer timeouts then.
"""

from dataclasses import replace

from ..dialogue import Dialogue, Exchange, Result
from ..driver import Identity, Unsupported
from .dialects import FLAT, IDENTITY, IDENTITY_VALUE, WINDOWED, Dialect
from .models import G350, model_of
from .registers import CONFIGURE, CR, NOT_READY, WIN_CTRL, Register, read, write

ANSWER_S = 0.1  # an answer takes microseconds; adapters and emulators take longer
FIRST_ANSWER_S = 0.06  # to the first query: short, as most lines that are queried have no sensor at their end
STOP_ATTEMPTS = 5  # attempts to end automatic mode
LATE_S = 0.5  # in which late answers may arrive
LATE_MAX = STOP_ATTEMPTS * 3 * 4  # bytes of the answers to all queries of `synchronize`
SLOW_ANSWER_S = 0.8  # for devices that answer late
PAUSE_S = 0.006  # from one command or answer to the next command: 3.7 ms at 19200 baud, 0.2 ms at 460800
STOP_S = 0.2  # until the last frames have drained from adapter and driver
ANSWERS = 6  # to one query, of which two must agree
SILENT_MAX = 3  # queries of a register without an answer, after which there is no such register
READY_POLLS, READY_S = 30, 0.05  # start-up takes 0.8 s
IDENTITY_ANSWER = bytes((IDENTITY.address, *IDENTITY_VALUE.to_bytes(2), CR))


def send_commands(*commands: bytes) -> Dialogue[None]:
    """Send commands that are not answered."""
    for command in commands:
        yield Exchange(command, PAUSE_S)


def select_window(register: Register) -> Dialogue[None]:
    """Select the window of `register`."""
    if register.window is not None:
        yield from send_commands(write(WIN_CTRL, register.window))


def read_register_once(register: Register) -> Dialogue[bytes]:
    """The bytes received as the answer."""
    yield from select_window(register)
    reply = yield Exchange(read(register), ANSWER_S, enough=lambda received: len(received) >= 4, discard=True)
    if reply:
        yield Exchange(listen_s=PAUSE_S)
    return reply


def read_register(register: Register) -> Dialogue[int | None]:
    """The word of a register, which no checksum guards: two answers must agree. None: none do, or it is silent."""
    words, silences = set[int](), 0
    for _ in range(ANSWERS):
        reply = yield from read_register_once(register)
        word = register.answer(reply)
        if word in words:
            return word
        if word is not None:
            words.add(word)
        silences += not reply
        if silences == SILENT_MAX:
            break
    return None


def write_register(register: Register, low: int | None = None, high: int | None = None) -> Dialogue[None]:
    """Write a register's low byte, its high byte, or both."""
    yield from select_window(register)
    if low is not None:
        yield from send_commands(write(register.address, low))
    if high is not None:
        yield from send_commands(write(register.address + 1, high))


def read_text(registers: tuple[Register, ...]) -> Dialogue[str]:
    """ASCII of several registers, low bytes first; empty if they do not answer with printable text."""
    text = b""
    for register in registers:
        word = yield from read_register(register)
        if word is None:
            return ""
        text += bytes((word & 0xFF, word >> 8))
    plain = text.rstrip(b"\0 ")
    return plain.decode("ascii") if plain.isascii() and plain.decode("ascii").isprintable() else ""


def synchronize() -> Dialogue[Dialect | None]:
    """End automatic mode and wait until the sensor is ready; None if nothing here answers like one.

    The windowed dialect is tried first: to a flat sensor its commands mean nothing, while the flat stop command would
    write into the rotation matrix of a windowed one.
    """
    for _ in range(STOP_ATTEMPTS):
        yield from send_commands(b"\r" + write(WIN_CTRL, 0), write(WINDOWED.mode.address + 1, CONFIGURE))
        received = yield Exchange(
            read(IDENTITY), FIRST_ANSWER_S, enough=lambda received: received.endswith(IDENTITY_ANSWER)
        )
        if received.endswith(IDENTITY_ANSWER) and (yield from read_register_once(IDENTITY)) == IDENTITY_ANSWER:
            return WINDOWED if (yield from wait_ready(WINDOWED)) else None
        yield Exchange(write(FLAT.mode.address + 1, CONFIGURE), STOP_S if received else PAUSE_S)
        first = FLAT.command.answer((yield from read_register_once(FLAT.command)))
        if first is not None and FLAT.command.answer((yield from read_register_once(FLAT.command))) is not None:
            identity = yield from read_register_once(IDENTITY)
            if IDENTITY_ANSWER in (identity, (yield from read_register_once(FLAT.command))):  # the answer may come late
                continue
            return FLAT if (yield from wait_ready(FLAT)) else None
        if first is None and not received:
            return None
    return None


def synchronize_with_retry() -> Dialogue[tuple[Dialect | None, bool]]:
    """`synchronize`, repeated if answers are late; the dialect, and whether all dialogues need `with_late_answers`."""
    dialect = yield from synchronize()
    if dialect is not None:
        return dialect, False
    late = yield Exchange(listen_s=LATE_S, optional=True)
    if len(late) > LATE_MAX or all(register.answer(late[-4:]) is None for register in (IDENTITY, FLAT.command)):
        return None, False
    return (yield from with_late_answers(synchronize())), True


def with_late_answers(dialogue: Dialogue[Result]) -> Dialogue[Result]:
    """The same dialogue, with longer timeouts."""
    received: bytes | None = None
    try:
        while True:
            exchange = dialogue.send(received) if received is not None else next(dialogue)
            is_query = exchange.send and exchange.enough
            received = yield replace(exchange, listen_s=max(exchange.listen_s, SLOW_ANSWER_S)) if is_query else exchange
    except StopIteration as finding:
        result: Result = finding.value
        return result


def wait_ready(dialect: Dialect) -> Dialogue[bool]:
    """Poll until start-up is over."""
    for _ in range(READY_POLLS):
        word = dialect.command.answer((yield from read_register_once(dialect.command)))
        if word is not None and not word & NOT_READY:
            return True
        yield Exchange(listen_s=READY_S)
    return False


def describe(dialect: Dialect) -> Dialogue[Identity | Unsupported]:
    """The sensor's identity. A flat sensor may have none of these registers."""
    product = yield from read_text(dialect.product)
    model = model_of(product)
    if dialect is FLAT:
        model = model if model is not None and model.dialect is FLAT else G350
    elif model is None:
        return Unsupported("epson", f"Epson {product or 'IMU'}", "its scale factors are not in drivers/epson/models.py")
    version = yield from read_register(dialect.version)
    serial = yield from read_text(dialect.serial)
    if product and not serial:  # it has one: a machine under load reads answers late
        serial = yield from with_late_answers(read_text(dialect.serial))
    name = model.name if dialect is FLAT else f"M-{product}"
    return Identity("epson", name, serial, f"{version:04x}" if version else "", profile=model.profile)
