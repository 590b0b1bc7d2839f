"""Finding out which device is on a line, and how fast it talks.

First listen: a device that speaks by itself is recognised without a byte written to it, and a line that carries
something unknown is listened to at all speeds. Only a silent line is asked, by every driver at the speeds that its
devices use. A line that carries something unknown is asked only if the user named a driver whose questions may
interrupt a stream. All this is done three times, since a device may be starting up. Answers that come late are waited
for at the likeliest speed; at all speeds in a fourth turn, if anything came that was no answer.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

from .dialogue import Dialogue, Exchange
from .driver import AnyDriver, Identity, SpiDriver, Unsupported
from .findings import CHATTER, Chatter, Echo, Finding, NoAnswer, Silence, is_garbage
from .registry import by_name, drivers
from .transport.portspec import PortSpec

TURNS = 3  # and a fourth on a line that stirs
PATIENT = (1, 0, 1, 99)  # turn by turn, at how many of a driver's speeds late answers are waited for
PLENTY = 1024  # bytes in which any driver recognises its device
ECHOES = 3  # in a row are no answers
START_S = 0.4  # between turns on SPI: a device may be starting up

Found = Identity | Unsupported


@dataclass
class Stir:
    """Whether anything came while the line was asked: what it was is not known, but something there may answer late."""

    came: bool = False


def search(spec: PortSpec, readonly: bool = False, last_baud: int = 0) -> Dialogue[Found | Finding]:
    """The device on the port as the user named it, or why there is none; `last_baud` as in `detect`."""
    if spec.spi:
        return detect_spi(spec.driver, readonly)
    return detect(spec.driver, spec.baud, readonly, last_baud)


def detect_spi(driver: str | None = None, readonly: bool = False) -> Dialogue[Found | Finding]:
    """The device on an SPI line. It says nothing by itself, so every driver asks."""
    among = (by_name(driver),) if driver else drivers()
    for _ in range(0 if readonly else TURNS):
        for one in among:
            if isinstance(one, SpiDriver) and (found := (yield from one.identify_spi())):
                return found
        yield Exchange(listen_s=START_S)
    return NoAnswer(readonly)


def detect(
    driver: str | None = None, baud: int | None = None, readonly: bool = False, last_baud: int = 0
) -> Dialogue[Found | Finding]:
    """The device on the line, or why there is none; `driver` and `baud` as far as the user named them.

    readonly: only listen. last_baud: the speed at which a device was found here before, tried first; 0: none was.
    """
    among = (by_name(driver),) if driver else drivers()
    speeds = {one.name: (baud,) if baud else _from(last_baud, one.bauds) for one in among}
    bauds = tuple(_merged(list(speeds.values())))
    once: Chatter | None = None
    stir = Stir()
    for turn, patient in enumerate(PATIENT):
        if turn == TURNS and not stir.came:
            break
        first = bauds[turn % len(bauds)]
        heard = yield from _listen(among, first)
        found = _recognised(among, heard, first)
        if found is not None:
            found = replace(found, baud=_plausible(found, baud))
        noise = None
        if found is None and len(heard) >= CHATTER:
            once = Chatter(heard, first, bauds)
            found, noise = yield from _listen_at_all(among, bauds, first)
        if found is None and not readonly:
            askable = among if noise is None else [one for one in among if driver and one.interrupts]
            answer = yield from _ask({one: speeds[one.name] for one in askable}, patient, stir)
            if isinstance(answer, Echo):
                return answer
            found = answer
        if found is not None:
            yield Exchange(baud=found.baud)
            return found
        if noise is not None:
            return noise
    return once or Silence(bauds, not readonly)


def _from(first: int, bauds: Sequence[int]) -> tuple[int, ...]:
    """The same speeds, `first` ahead of the others if it is among them."""
    return tuple(sorted(bauds, key=lambda baud: baud != first))


def _merged(lists: Sequence[Sequence[int]]) -> Iterator[int]:
    """Every driver's likeliest, then every driver's second, without repetition."""
    return iter(dict.fromkeys(baud for rank in zip_longest(*lists) for baud in rank if baud))


def _recognised(among: Sequence[AnyDriver], heard: bytes, baud: int) -> Found | None:
    for driver in among:
        if found := driver.recognise(heard):
            found = replace(found, baud=baud)
            return replace(found, streaming=True) if isinstance(found, Identity) else found
    return None


def _plausible(found: Found, named: int | None) -> int:
    """The speed of a line on which a device was heard at once.

    A pseudo-terminal carries it at speeds that its driver does not know, too. On a line where another speed gave
    something else, the speed is what it is.
    """
    bauds = by_name(found.driver).bauds
    return found.baud if named or found.baud in bauds else bauds[0]


def _listen(among: Sequence[AnyDriver], baud: int) -> Dialogue[bytes]:
    def enough(heard: bytes) -> bool:
        return len(heard) >= PLENTY or is_garbage(heard) or _recognised(among, heard, baud) is not None

    patience_s = max(driver.patience_s for driver in among)
    return (yield Exchange(baud=baud, listen_s=patience_s, enough=enough, discard=True))


def _listen_at_all(
    among: Sequence[AnyDriver], bauds: Sequence[int], first: int
) -> Dialogue[tuple[Found | None, Chatter | None]]:
    """Listen at all speeds to a line that talks, at the `first` one last; the device, or the most that was heard.

    Neither if it said something once, as a starting device does, and has fallen silent since.
    """
    noise = Chatter(b"", first, tuple(bauds))
    for baud in (*(other for other in bauds if other != first), first):
        heard = yield from _listen(among, baud)
        if found := _recognised(among, heard, baud):
            return found, None
        if not heard:
            return None, None
        noise = max(noise, replace(noise, heard=heard, baud=baud), key=lambda chatter: chatter.worth)
    return None, noise


def _ask(speeds: Mapping[AnyDriver, Sequence[int]], patient: int, stir: Stir) -> Dialogue[Found | Echo | None]:
    """Every driver at its likeliest speed, then its second, and so on; all its exchanges at the first `patient`."""
    for rank, of_rank in enumerate(zip_longest(*speeds.values())):
        for driver, speed in zip(speeds, of_rank, strict=True):
            if speed:
                yield Exchange(baud=speed, discard=True)
                found = yield from _unless_echoed(driver.identify(), speed, rank >= patient, stir)
                if isinstance(found, Echo):
                    return found
                if found:
                    return (yield from _at_any_speed(driver, speeds[driver][0], speed)) or replace(found, baud=speed)
    return None


def _at_any_speed(driver: AnyDriver, likeliest: int, speed: int) -> Dialogue[Found | None]:
    """The device that answered at `speed`, if it answers at the likeliest speed, too: then the line has no speed.

    On such a line (a pseudo-terminal) the device was merely not ready when the likeliest speed was tried. To keep the
    speed at which it happened to answer would lower its sample rate for nothing.
    """
    if speed == likeliest:
        return None
    yield Exchange(baud=likeliest, discard=True)
    found = yield from _unless_echoed(driver.identify(), likeliest, hurry=True, stir=Stir())
    if found and not isinstance(found, Echo):
        return replace(found, baud=likeliest)
    yield Exchange(baud=speed, discard=True)
    return None


def _unless_echoed(
    dialogue: Dialogue[Found | None], baud: int, hurry: bool, stir: Stir
) -> Dialogue[Found | Echo | None]:
    """The dialogue, given up once `ECHOES` commands in a row came back unchanged. hurry: without spare exchanges."""
    echoes = 0
    try:
        exchange = next(dialogue)
        while echoes < ECHOES:
            heard = b"" if hurry and exchange.spare else (yield exchange)
            stir.came |= bool(heard)
            if exchange.send and heard:
                echoes = echoes + 1 if heard == exchange.send else 0
            exchange = dialogue.send(heard)
    except StopIteration as finding:
        return finding.value  # type: ignore[no-any-return]
    return Echo(baud)
