"""Talking to an Epson sensor of the flat dialect: reach it, whatever it is doing, and find out who it is."""

from ..dialogue import Dialogue, Exchange
from ..driver import Identity, Unsupported
from . import registers
from .models import model_of

ANSWER_S = 0.1  # an answer takes microseconds; adapters and stand-ins take longer
WRITE_S = 0.004  # from one command to the next: 3.7 ms at 19200 baud, 0.2 ms at 460800
STOPS = 5  # attempts to end automatic mode
STOP_S = 0.2  # until its last frames have drained from adapter and driver
READY_POLLS, READY_S = 30, 0.05  # start-up takes 0.8 s


def ask(address: int) -> Dialogue[int | None]:
    """The word of a register, or None without an exact answer."""
    reply = yield Exchange(registers.read(address), ANSWER_S, enough=lambda heard: len(heard) >= 4, discard=True)
    return registers.answer(address, reply)


def tell(*commands: bytes) -> Dialogue[None]:
    """Write commands that are not answered."""
    for command in commands:
        yield Exchange(command, WRITE_S)


def ask_text(addresses: tuple[int, ...]) -> Dialogue[str]:
    """ASCII of several registers, low bytes first; empty if they do not answer with printable text."""
    text = b""
    for address in addresses:
        word = yield from ask(address)
        if word is None:
            return ""
        text += bytes((word & 0xFF, word >> 8))
    plain = text.rstrip(b"\0 ")
    return plain.decode("ascii") if plain.isascii() and plain.decode("ascii").isprintable() else ""


def reach() -> Dialogue[bool]:
    """End automatic mode and wait until the sensor is ready; False if nothing here answers like one."""
    for attempt in range(STOPS):
        stop = b"\r" + registers.TO_CONFIGURATION
        heard = yield Exchange(stop, STOP_S if attempt else STOP_S / 4, discard=True)
        first = yield from ask(registers.GLOB_CMD)
        if first is not None and (yield from ask(registers.GLOB_CMD)) is not None:
            return (yield from wait_ready())
        if first is None and not heard:
            return False
    return False


def wait_ready() -> Dialogue[bool]:
    """Poll until start-up is over."""
    for _ in range(READY_POLLS):
        word = yield from ask(registers.GLOB_CMD)
        if word is not None and not word & registers.NOT_READY:
            return True
        yield Exchange(listen_s=READY_S)
    return False


def describe() -> Dialogue[Identity | Unsupported]:
    """Who answers: all of these registers may be missing on an M-G350."""
    yield from tell(registers.WINDOW_0)
    if (yield from ask(registers.WINDOWED_ID)) == registers.WINDOWED_ID_VALUE:
        yield from tell(registers.WINDOW_1)
        product = yield from ask_text(registers.PRODUCT_ID)
        yield from tell(registers.WINDOW_0)
        return windowed(product)
    model = model_of((yield from ask_text(registers.PRODUCT_ID)))
    version = yield from ask(registers.VERSION)
    serial = yield from ask_text(registers.SERIAL_NUMBER)
    return Identity("epson", model.name, serial, f"{version:04x}" if version else "", profile=model.profile)


def windowed(product: str) -> Unsupported:
    """A later model."""
    return Unsupported(
        "epson", f"M-{product}" if product else "M-G362 family", "this driver speaks the M-G350's dialect"
    )
