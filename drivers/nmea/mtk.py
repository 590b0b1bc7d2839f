"""MediaTek receivers: giving them fewer sentences, a faster line and more fixes a second, by PMTK commands.

Every command is acknowledged with PMTK001 (flag 3: done); silence is asked again twice. PMTK220, the fix interval, is
not known to all of them; PMTK300 is tried after it. Nothing here survives a power cycle. If any step fails, what was
changed is changed back. Source: MTK NMEA packet user manual; design/protocols.md 4.3.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from ..dialogue import Dialogue, Exchange
from .sentences import Sentence, Splitter, checksum

TRIES = 3
DONE = "3"
ANSWER_S = 1.0
BACKLOG = 2048  # bytes that the receiver may have to say before it answers
BITS = 10  # on the wire per byte
SETTLE_S = 2.5  # in which a receiver is heard at its new speed: one burst a second, and one may be torn
WANTED = "314,0,1,1,1,5,0,0,0,0,0,0,0,0,0,0,0,0,0,0"  # RMC VTG GGA at each fix, GSA at every fifth
DEFAULTS = "314,-1"
FIX_BYTES = 220  # of those per fix: GGA 82, RMC 76, VTG 40, a fifth of GSA 60, and a little
LOAD = 0.8  # of the line, at most
FAST_BAUD = 57600
SLOWEST_MS = 1000


@dataclass(frozen=True)
class Outcome:
    """What became of it. baud: at which the receiver talks now; None: it is not heard any more."""

    baud: int | None
    problem: str = ""


def command(text: str) -> bytes:
    """The sentence for a command such as `220,200`."""
    body = f"PMTK{text}".encode("ascii")
    return b"$%s*%02X\r\n" % (body, checksum(body))


def sentences(heard: bytes) -> Sequence[Sentence]:
    """Those with the right checksum."""
    return list(Splitter(Counter()).feed(heard, 0))


def speaks_mtk(heard: bytes) -> bool:
    """Whether a MediaTek receiver said something of its own."""
    return any(sentence.talker == "P" and sentence.kind.startswith("MTK") for sentence in sentences(heard))


def is_mtk(baud: int) -> Dialogue[bool]:
    """Ask for the firmware's version. Any answer in PMTK will do, also that the question is not known."""
    for _ in range(TRIES):
        if speaks_mtk((yield Exchange(command("605"), patience_s(baud), speaks_mtk))):
            return True
    return False


def speed_up(baud: int, rate_hz: float) -> Dialogue[Outcome]:
    """Set up a MediaTek receiver that talks at `baud` for `rate_hz` fixes a second."""
    faster = max(baud, FAST_BAUD)
    if rate_hz * FIX_BYTES * BITS > LOAD * faster:
        return Outcome(baud, f"{rate_hz:g} fixes a second do not fit through {faster} baud")
    if not (yield from _do(WANTED, baud)):
        return Outcome(baud, "it does not take PMTK314, the choice of sentences")
    now = yield from _change_baud(baud, faster)
    if now != faster:
        yield from _do(DEFAULTS, now or baud)
        return Outcome(now, f"it does not change to {faster} baud")
    interval_ms = round(1000.0 / rate_hz)
    if (yield from _set_interval(interval_ms, faster)):
        return Outcome(faster)
    yield from _set_interval(SLOWEST_MS, faster)
    yield from _do(DEFAULTS, faster)
    back = yield from _change_baud(faster, baud)
    return Outcome(back, f"it does not take {interval_ms} ms between fixes, neither by PMTK220 nor by PMTK300")


def patience_s(baud: int) -> float:
    """For an answer behind all that is still to be said."""
    return ANSWER_S + BACKLOG * BITS / baud


def _do(text: str, baud: int) -> Dialogue[bool]:
    """Send a command until it is acknowledged; whether it was done."""
    number = text.partition(",")[0]
    for _ in range(TRIES):
        flag = _flag((yield Exchange(command(text), patience_s(baud), partial(_answered, number=number))), number)
        if flag:
            return flag == DONE
    return False


def _flag(heard: bytes, number: str) -> str:
    """The acknowledgement of a command; empty: none."""
    answers = [s for s in sentences(heard) if s.kind == "MTK001" and s.field(1) == number]
    return answers[-1].field(2) if answers else ""


def _answered(heard: bytes, number: str) -> bool:
    return bool(_flag(heard, number))


def _set_interval(interval_ms: int, baud: int) -> Dialogue[bool]:
    for text in (f"220,{interval_ms}", f"300,{interval_ms},0,0,0,0"):
        if (yield from _do(text, baud)):
            return True
    return False


def _change_baud(old: int, new: int) -> Dialogue[int | None]:
    """Change the receiver's speed and our own; the one at which it is heard then, None if at neither.

    The answer comes at the old speed, if at all, so only what is heard at the new one counts.
    """
    if new == old:
        return new
    for _ in range(TRIES):
        answered = partial(_answered, number="251")
        flag = _flag((yield Exchange(command(f"251,{new}"), patience_s(old), answered)), "251")
        if flag in ("", DONE) and sentences((yield Exchange(baud=new, discard=True, listen_s=SETTLE_S, enough=_heard))):
            return new
        heard = yield Exchange(baud=old, discard=True, listen_s=SETTLE_S, enough=_heard)
        if flag and sentences(heard):
            return old
    return old if sentences(heard) else None


def _heard(heard: bytes) -> bool:
    return bool(sentences(heard))
