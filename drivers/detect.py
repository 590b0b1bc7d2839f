"""Finding out which device is on a line, and how fast it talks.

First listen: a device that speaks by itself is recognised without a byte written to it, and a line that carries
something unknown is listened to at all speeds. Only a silent line is asked, by every driver at the speeds that its
devices use, or one whose driver the user named if that may interrupt a stream. Three turns, since a device may be
starting up.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

from .dialogue import Dialogue, Exchange
from .driver import AnyDriver, Identity, SpiDriver, Unsupported
from .registry import by_name, drivers
from .transport.portspec import PortSpec

TURNS = 3
CHATTER = 16  # bytes; fewer are glitches of a line that is idle, or being plugged
PLENTY = 1024  # bytes in which any driver recognises its device
GARBAGE, TEXT_SHARE = 200, 0.7  # bytes after which, with less text than that, nothing will be recognised any more
SHOWN, TEXT_SHOWN = 24, 90  # bytes
FOREIGN = {  # how their messages begin
    b"\xb5\x62\x01": "a u-blox receiver",
    b"\xa0\xa2\x00": "a SiRF receiver",
}
POSITION = re.compile(rb"\$[A-Z]{2}(GGA|RMC|GNS|GLL),")  # by any talker
ECHOES = 3  # in a row are no answers
START_S = 0.4  # between turns on SPI: a device may be starting up


@dataclass(frozen=True)
class Silence:
    """Nothing came."""

    bauds: tuple[int, ...]
    asked: bool

    def __str__(self) -> str:
        advice = "is it powered, and are its TX and RX the right way round?" if self.asked else "does it talk unasked?"
        return f"silent at {_speeds(self.bauds)}: {advice}"


@dataclass(frozen=True)
class Chatter:
    """Something came, but nothing known."""

    heard: bytes
    baud: int  # at which that was heard
    bauds: tuple[int, ...]

    def __str__(self) -> str:
        heard = f"{len(self.heard)} bytes heard at {self.baud} baud, {self.gist}"
        return f"{heard} (tried {_speeds(self.bauds)}): {_shown(self.heard)} …"

    @property
    def gist(self) -> str:
        """Without what differs from one hearing to the next."""
        return _kind(self.heard)


@dataclass(frozen=True)
class Echo:
    """What is written comes back, and nothing else."""

    baud: int

    def __str__(self) -> str:
        return "what is written comes back: are TX and RX connected with each other, or does the adapter echo?"


def _speeds(bauds: Sequence[int]) -> str:
    if len(bauds) == 1:
        return f"{bauds[0]} baud, as named; leave out @BAUD to have other speeds tried"
    return f"all of {', '.join(map(str, bauds))} baud"


def _kind(heard: bytes) -> str:
    """What the bytes look like, though no driver knows them."""
    if whose := _foreign(heard):
        return f"of {whose} in its own binary format, which imud does not read: have it send NMEA"
    if _text_share(heard) < TEXT_SHARE:
        return "but nothing known: garbage, as of a line at another speed, or a device that imud does not know"
    if any(line.startswith(b"$") and b"*" in line for line in heard.splitlines()):
        return "NMEA sentences with wrong checksums: a disturbed line"
    if POSITION.search(heard):
        return "NMEA sentences without checksums, which imud does not trust: switch them on in the receiver"
    return "text, but of no device that imud knows"


def _foreign(heard: bytes) -> str:
    """Whose binary messages are in it; empty: nobody's that is known."""
    return next((whose for mark, whose in FOREIGN.items() if mark in heard), "")


def _shown(heard: bytes) -> str:
    if _text_share(heard) < TEXT_SHARE:
        return heard[:SHOWN].hex(" ")
    return repr(heard[:TEXT_SHOWN].decode("ascii", "replace").strip())


@dataclass(frozen=True)
class NoAnswer:
    """Nothing that is known answers on an SPI line."""

    readonly: bool

    def __str__(self) -> str:
        if self.readonly:
            return "a device on SPI says nothing unasked, and nothing may be written"
        return "nothing known answers on SPI: is it powered, wired (CS, SCLK, MOSI, MISO) and set to SPI?"


Found = Identity | Unsupported
Finding = Silence | Chatter | Echo | NoAnswer


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
    for turn in range(TURNS):
        first = bauds[turn % len(bauds)]
        heard = yield from _listen(among, first)
        found = _recognised(among, heard, first)
        noise = None
        if found is None and len(heard) >= CHATTER:
            once = Chatter(heard, first, bauds)
            found, noise = yield from _listen_at_all(among, bauds, first)
        if found is None and not readonly:
            askable = among if noise is None else [one for one in among if driver and one.interrupts]
            answer = yield from _ask({one: speeds[one.name] for one in askable})
            if isinstance(answer, Echo):
                return answer
            found = answer
        if found is not None:
            speed = _plausible(found, baud)
            yield Exchange(baud=speed)
            return replace(found, baud=speed)
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
            return replace(found, baud=baud)
    return None


def _plausible(found: Found, named: int | None) -> int:
    """The speed of the device's line. A pseudo-terminal carries it at speeds that its driver does not know, too."""
    bauds = by_name(found.driver).bauds
    return found.baud if named or found.baud in bauds else bauds[0]


def _listen(among: Sequence[AnyDriver], baud: int) -> Dialogue[bytes]:
    def enough(heard: bytes) -> bool:
        return len(heard) >= PLENTY or _is_garbage(heard) or _recognised(among, heard, baud) is not None

    patience_s = max(driver.patience_s for driver in among)
    return (yield Exchange(baud=baud, listen_s=patience_s, enough=enough, discard=True))


def _is_garbage(heard: bytes) -> bool:
    return len(heard) >= GARBAGE and _text_share(heard) < TEXT_SHARE


def _text_share(heard: bytes) -> float:
    return sum(32 <= byte < 127 or byte in b"\r\n" for byte in heard) / len(heard)


def _listen_at_all(
    among: Sequence[AnyDriver], bauds: Sequence[int], first: int
) -> Dialogue[tuple[Found | None, Chatter | None]]:
    """Listen to a line that talks at all speeds, last at the first one again; the device, or the most that was heard.

    Neither: it said something once, as a device does that starts, and has fallen silent.
    """
    noise = Chatter(b"", first, tuple(bauds))
    for baud in (*(other for other in bauds if other != first), first):
        heard = yield from _listen(among, baud)
        if found := _recognised(among, heard, baud):
            return found, None
        if not heard:
            return None, None
        noise = max(noise, replace(noise, heard=heard, baud=baud), key=_worth)
    return None, noise


def _worth(chatter: Chatter) -> tuple[bool, int]:
    """For choosing what to show: what makes sense before garbage, much before little."""
    heard = chatter.heard
    sensible = len(heard) >= CHATTER and (_text_share(heard) >= TEXT_SHARE or bool(_foreign(heard)))
    return sensible, len(heard)


def _ask(speeds: Mapping[AnyDriver, Sequence[int]]) -> Dialogue[Found | Echo | None]:
    """Every driver at its likeliest speed, at leisure, then every driver at its second."""
    for rank, of_rank in enumerate(zip_longest(*speeds.values())):
        for driver, speed in zip(speeds, of_rank, strict=True):
            if speed:
                yield Exchange(baud=speed, discard=True)
                found = yield from _unless_echoed(driver.identify(), speed, hurry=rank > 0)
                if isinstance(found, Echo):
                    return found
                if found:
                    return (yield from _at_any_speed(driver, speeds[driver][0], speed)) or replace(found, baud=speed)
    return None


def _at_any_speed(driver: AnyDriver, likeliest: int, speed: int) -> Dialogue[Found | None]:
    """The device that answered at `speed`, if it answers at the likeliest one, too: a line without speeds carries it.

    It was not ready when that was tried. At a speed that only happened to be tried then, its rate would be lowered.
    """
    if speed == likeliest:
        return None
    yield Exchange(baud=likeliest, discard=True)
    found = yield from _unless_echoed(driver.identify(), likeliest, hurry=True)
    if found and not isinstance(found, Echo):
        return replace(found, baud=likeliest)
    yield Exchange(baud=speed, discard=True)
    return None


def _unless_echoed(dialogue: Dialogue[Found | None], baud: int, hurry: bool) -> Dialogue[Found | Echo | None]:
    """The dialogue, until several of its commands in a row are answered by themselves; in a `hurry` the needful."""
    echoes = 0
    try:
        exchange = next(dialogue)
        while echoes < ECHOES:
            heard = b"" if hurry and exchange.spare else (yield exchange)
            if exchange.send and heard:
                echoes = echoes + 1 if heard == exchange.send else 0
            exchange = dialogue.send(heard)
    except StopIteration as finding:
        return finding.value  # type: ignore[no-any-return]
    return Echo(baud)
