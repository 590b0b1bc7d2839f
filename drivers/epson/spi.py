"""Epson's sensors on SPI: the same registers in SPI words, and how a sample is fetched.

A word is 16 bits, mode 3, high byte first. A write is address | 0x80, value; a read is address, 0, and its answer comes
with the next word, whichever that is. The windowed dialect can send a whole frame after 0x80, 0 (window 0 open). The
flat dialect cannot: its words are read one by one, with COUNT before and after them; if COUNT differs, they belong to
two samples. What was fetched is put between header and CR, as on a UART, for the same decoders.

Pauses and clocks: sensor_epsonSpi.c of Epson's public driver, epson_imu_reg.h of its kernel driver (20 us after a word,
40 us from word to word; 45 us after the burst command, 4 us after its words; 2 MHz, bursts 1 MHz). For the M-G350
no others are known. CS may rise between words: the kernel driver and NASA Astrobee's let it.
"""

from collections.abc import Callable, Iterator

from ..dialogue import Dialogue, Exchange, Result
from ..spi import Bus, Cycle, Fetch
from .dialects import FLAT, Dialect, Layout
from .registers import CR

MODE = 3
REGISTERS = Bus(MODE, 500_000, 20)
CLOCK_HZ = 1_000_000
STALL_US = 24  # a word takes 16 us then
COMMAND_STALL_US, BURST_STALL_US = 45, 5
COMMAND_BYTES = 3  # on a UART
UNDRIVEN = b"\xff\xff"  # the word read from a line that no device drives
NEW_DATA = 0xFE  # FLAG, high byte: temperature, gyros, accelerometers
BURST = b"\x80\0"
CALL_NS = 15_000  # for each transfer, in the system and in spidev
SHARE = 0.8  # of the time that fetching may take

FLAG, TEMP, LAST, COUNT = 0x00, 0x02, 0x0E, 0x12  # flat
WINDOWED_FLAG, WINDOWED_COUNT = 0x06, 0x0A


def over_spi(dialogue: Dialogue[Result]) -> Dialogue[Result]:
    """Run a dialogue that was written for a UART over SPI."""
    setup: Bus | None = REGISTERS
    answered: bytes | None = None
    try:
        while True:
            exchange = dialogue.send(answered) if answered is not None else next(dialogue)
            commands = tuple(_commands(exchange.send))
            words = b"".join(map(_words, commands))
            if isinstance(exchange.spi, Fetch):
                answered = yield Exchange(words, exchange.listen_s, exchange.enough, spi=exchange.spi)
                setup = REGISTERS
                continue
            answers = yield Exchange(words, exchange.listen_s, _complete(len(words)), discard=True, spi=setup)
            answered, setup = _uart_answers(commands, answers), None
    except StopIteration as finding:
        result: Result = finding.value
        return result


def _complete(size: int) -> Callable[[bytes], bool] | None:
    return (lambda answered: len(answered) >= size) if size else None


def _commands(sent: bytes) -> Iterator[tuple[int, int]]:
    """Address and value of each command; the CR before them, which ends a partial command on a UART, is dropped."""
    sent = sent.lstrip(b"\r")
    return ((sent[i], sent[i + 1]) for i in range(0, len(sent), COMMAND_BYTES))


def _words(command: tuple[int, int]) -> bytes:
    return bytes(command) + (b"" if _is_write(command) else bytes(2))


def _is_write(command: tuple[int, int]) -> bool:
    return bool(command[0] & 0x80)


def _uart_answers(commands: tuple[tuple[int, int], ...], answers: bytes) -> bytes:
    """The answers to the reads, as a UART brings them."""
    answered, at = b"", 0
    for command in commands:
        at += len(_words(command))
        word = answers[at - 2 : at]
        if not _is_write(command) and word not in (b"", UNDRIVEN):
            answered += bytes((command[0], *word, CR))
    return answered


def _is_new(flag: bytes) -> bool:
    return flag != UNDRIVEN and bool(flag[0] & NEW_DATA)


def _read_cycle(address: int) -> Cycle:
    return Cycle(bytes((address, 0)), STALL_US)


_FLAT_CYCLES = (
    _read_cycle(FLAG),
    _read_cycle(COUNT),
    *map(_read_cycle, range(TEMP, LAST + 2, 2)),
    _read_cycle(COUNT),
    _read_cycle(0),
)


def _flat_frame(answers: bytes) -> bytes:
    """The answers are one word late: -, FLAG, COUNT, TEMP, GYRO x y z, ACCL x y z, COUNT. GPIO is not read."""
    flag, count = answers[2:4], answers[4:6]
    return b"\x20" + flag + answers[6:-2] + b"\0\0" + count + b"\r" if count == answers[-2:] else b""


def _burst_frame(answers: bytes) -> bytes:
    """The answers: -, FLAG, -, then the words of the burst."""
    return b"\x80" + answers[6:] + b"\r"


def fetch(dialect: Dialect, layout: Layout, rate_hz: float) -> Fetch:
    """How a sample of that layout is fetched."""
    period_ns = round(1e9 / rate_hz)
    if dialect is FLAT:
        return Fetch(CLOCK_HZ, _FLAT_CYCLES, 1, _is_new, 1, _flat_frame, period_ns)
    words = (layout.length - 2) // 2
    data = (*[Cycle(b"\0\0", BURST_STALL_US)] * (words - 1), Cycle(b"\0\0", STALL_US))
    # reading COUNT brings the answer to FLAG; reading FLAG again could clear the new-data bits of a newer sample
    cycles = (_read_cycle(WINDOWED_FLAG), _read_cycle(WINDOWED_COUNT), Cycle(BURST, COMMAND_STALL_US), *data)
    return Fetch(CLOCK_HZ, cycles, 1, _is_new, 2, _burst_frame, period_ns)


def spi_carries(dialect: Dialect) -> Callable[[Layout], float]:
    """How many samples of a layout per second are fetched soon enough before the next."""

    def most_hz(layout: Layout) -> float:
        plan = fetch(dialect, layout, 1.0)
        return SHARE * 1e9 / (plan.bus_ns() + CALL_NS * len(plan.cycles))

    return most_hz
