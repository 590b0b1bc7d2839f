"""MediaTek receivers: PMTK commands for fewer sentences, a higher baud rate and a higher fix rate.

PMTK001 acknowledges every command (flag 3: done); without an answer a command is repeated twice. PMTK220, the fix
interval, is not known to all of them; PMTK300 is tried after it. Nothing here survives a power cycle. If any step
fails, all changes are undone. Source: MTK NMEA packet user manual; docs/protocols.md 4.3.
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
BACKLOG = 2048  # bytes that the receiver may send before it answers
BITS = 10  # on the wire per byte
SETTLE_S = 2.5  # time in which sentences at a new speed must arrive: one burst a second, and one may be torn
SENTENCES = "314,0,1,1,1,5,0,0,0,0,0,0,0,0,0,0,0,0,0,0"  # RMC VTG GGA at each fix, GSA at every fifth
DEFAULTS = "314,-1"
FIX_BYTES = 220  # of those per fix: GGA 82, RMC 76, VTG 40, a fifth of GSA 60, and a little
LOAD_MAX = 0.8  # of the line, at most
FAST_BAUD = 57600
SLOWEST_MS = 1000


@dataclass(frozen=True)
class Outcome:
    """The result. baud: the receiver's, now; None: nothing is received any more."""

    baud: int | None
    problem: str = ""


def command(text: str) -> bytes:
    """The sentence for a command such as `220,200`."""
    body = f"PMTK{text}".encode("ascii")
    return b"$%s*%02X\r\n" % (body, checksum(body))


def sentences(received: bytes) -> Sequence[Sentence]:
    """Those with the right checksum."""
    return list(Splitter(Counter()).feed(received, 0))


def speaks_mtk(received: bytes) -> bool:
    """Whether a sentence of MediaTek's own protocol was received."""
    return any(sentence.talker == "P" and sentence.kind.startswith("MTK") for sentence in sentences(received))


def is_mtk(baud: int) -> Dialogue[bool]:
    """Query the firmware's version. Any answer in PMTK counts, also that the query is unknown."""
    for _ in range(TRIES):
        if speaks_mtk((yield Exchange(command("605"), answer_timeout_s(baud), speaks_mtk))):
            return True
    return False


def speed_up(baud: int, rate_hz: float) -> Dialogue[Outcome]:
    """Set up a MediaTek receiver that talks at `baud` for `rate_hz` fixes a second."""
    faster = max(baud, FAST_BAUD)
    if rate_hz * FIX_BYTES * BITS > LOAD_MAX * faster:
        return Outcome(baud, f"{rate_hz:g} fixes a second do not fit through {faster} baud")
    if not (yield from _execute(SENTENCES, baud)):
        return Outcome(baud, "it rejects PMTK314, the choice of sentences")
    actual = yield from _change_baud(baud, faster)
    if actual != faster:
        yield from _execute(DEFAULTS, actual or baud)
        return Outcome(actual, f"it does not change to {faster} baud")
    interval_ms = round(1000.0 / rate_hz)
    if (yield from _set_interval(interval_ms, faster)):
        return Outcome(faster)
    yield from _set_interval(SLOWEST_MS, faster)
    yield from _execute(DEFAULTS, faster)
    back = yield from _change_baud(faster, baud)
    return Outcome(back, f"it rejects {interval_ms} ms between fixes, both by PMTK220 and by PMTK300")


def answer_timeout_s(baud: int) -> float:
    """For an answer after all pending sentences."""
    return ANSWER_S + BACKLOG * BITS / baud


def _execute(text: str, baud: int) -> Dialogue[bool]:
    """Send a command until it is acknowledged; whether it was done."""
    number = text.partition(",")[0]
    for _ in range(TRIES):
        flag = _flag((yield Exchange(command(text), answer_timeout_s(baud), partial(_answered, number=number))), number)
        if flag:
            return flag == DONE
    return False


def _flag(received: bytes, number: str) -> str:
    """The acknowledgement of a command; empty: none."""
    answers = [s for s in sentences(received) if s.kind == "MTK001" and s.field(1) == number]
    return answers[-1].field(2) if answers else ""


def _answered(received: bytes, number: str) -> bool:
    return bool(_flag(received, number))


def _set_interval(interval_ms: int, baud: int) -> Dialogue[bool]:
    for text in (f"220,{interval_ms}", f"300,{interval_ms},0,0,0,0"):
        if (yield from _execute(text, baud)):
            return True
    return False


def _change_baud(old: int, new: int) -> Dialogue[int | None]:
    """Change the receiver's speed and that of the line; returns the one at which it is received, None if at neither.

    The answer comes at the old speed, if at all, so only what is received at the new one counts.
    """
    if new == old:
        return new
    for _ in range(TRIES):
        answered = partial(_answered, number="251")
        flag = _flag((yield Exchange(command(f"251,{new}"), answer_timeout_s(old), answered)), "251")
        if flag in ("", DONE) and sentences(
            (yield Exchange(baud=new, discard=True, listen_s=SETTLE_S, enough=_has_sentences))
        ):
            return new
        received = yield Exchange(baud=old, discard=True, listen_s=SETTLE_S, enough=_has_sentences)
        if flag and sentences(received):
            return old
    return old if sentences(received) else None


def _has_sentences(received: bytes) -> bool:
    return bool(sentences(received))
