"""NMEA 0183 sentences, strictly: bytes to checked sentences, and their fields to values.

A sentence ends with CR, LF, or the `$` of the next one, and bytes after its checksum are ignored: a torn sentence does
not damage its neighbours. A sentence without a checksum is accepted only if the user allows it; CR or LF ends it. A
sentence with any syntax error is rejected with a reason; empty fields are `None`. Angles are computed from the digits
as one quotient of integers, so they are correctly rounded.
Source: NMEA 0183 v4.11, gpsd's NMEA.adoc.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import date
from functools import lru_cache, reduce
from operator import xor
from typing import NamedTuple

LENGTH_MAX = 512  # bytes; the standard has 82, receivers send more
LINE_END = re.compile(rb"[\r\n]")
BODY = re.compile(rb"[A-Z0-9]{2,}(?:,[\x20-\x7e]*)?")
ENDING = re.compile(rb"\*([0-9A-Fa-f]{2})")
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
TIME = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d*))?")
DATE = re.compile(r"(\d\d)(\d\d)(\d\d)")
DEGREES = {2: re.compile(r"(\d{2})(\d\d)(?:\.(\d*))?"), 3: re.compile(r"(\d{3})(\d\d)(?:\.(\d*))?")}


class RefusedError(ValueError):
    """A rejected sentence; the message is the reason under which it is counted."""


class Sentence(NamedTuple):
    """A sentence whose checksum is right, or which may lack it."""

    talker: str
    kind: str
    fields: tuple[str, ...]  # after the address
    arrival_ns: int  # of its `$`

    def field(self, i: int) -> str:
        """Field i, counted from 1 after the address; empty if the sentence is shorter."""
        return self.fields[i - 1] if 1 <= i <= len(self.fields) else ""

    def first(self, n: int) -> tuple[str, ...]:
        """Fields 1 to n; empty where the sentence is shorter."""
        return (*self.fields[:n], *[""] * (n - len(self.fields)))


class Splitter:
    """Bytes to sentences. Any chunking gives the same sentences. unchecked: they may lack a checksum."""

    def __init__(self, counters: Counter[str], unchecked: bool = False) -> None:
        self._counters, self._unchecked = counters, unchecked
        self._line = b""
        self._inside = False
        self._arrival_ns = 0

    def feed(self, data: bytes, arrival_ns: int) -> Iterator[Sentence]:
        """Split bytes; yields the sentences that they complete."""
        for i, text in enumerate(data.split(b"$")):
            if i > 0:
                if self._inside:
                    yield from self._end(torn=True)
                self._inside, self._arrival_ns = True, arrival_ns
            rest = text
            if self._inside:
                piece, *ended = LINE_END.split(text, maxsplit=1)
                self._line += piece[: LENGTH_MAX + 1 - len(self._line)]
                if not ended:
                    continue
                yield from self._end(torn=False)
                rest = ended[0]
            if noise := len(rest.translate(None, b"\r\n")):
                self._counters["noise bytes"] += noise

    def _end(self, torn: bool) -> Sequence[Sentence]:
        """The line is over; torn: by the `$` of the next one."""
        line, self._line, self._inside = self._line, b"", False
        if not line:  # `$$`
            self._counters["noise bytes"] += 1
            return ()
        try:
            return (self._checked(line, torn),)
        except RefusedError as reason:
            self._counters[str(reason)] += 1
            return ()

    def _checked(self, line: bytes, torn: bool) -> Sentence:
        ending = ENDING.search(line)
        if len(line) > LENGTH_MAX:
            raise RefusedError("too long")
        if ending is None and (torn or not self._unchecked):
            raise RefusedError("no checksum")
        body = line[: ending.start()] if ending else line.rstrip()
        if ending and checksum(body) != int(ending[1], 16):
            raise RefusedError("wrong checksum")
        if not BODY.fullmatch(body):
            raise RefusedError("garbage")
        address, *fields = body.decode("ascii").split(",")
        talker, kind = ("P", address[1:]) if address[0] == "P" else (address[:2], address[2:])
        return Sentence(talker, kind, tuple(fields), self._arrival_ns)


def checksum(body: bytes) -> int:
    """Exclusive or of all bytes between `$` and `*`."""
    return reduce(xor, body, 0)


def number(text: str, low: float, high: float, reason: str) -> float | None:
    """A decimal number within [low, high], correctly rounded."""
    if not text:
        return None
    if not NUMBER.fullmatch(text) or not low <= (value := float(text)) <= high:
        raise RefusedError(reason)
    return value


def quotient(text: str, numerator: int, denominator: int) -> float:
    """A decimal number times numerator / denominator, correctly rounded."""
    whole, _, fraction = text.partition(".")
    result: float = int(whole + fraction) * numerator / (10 ** len(fraction) * denominator)
    return result


def integer(text: str, high: int, reason: str) -> int | None:
    """A whole number from 0 to `high`."""
    if not text:
        return None
    if not text.isdecimal() or int(text) > high:
        raise RefusedError(reason)
    return int(text)


@lru_cache(maxsize=1)
def utc_ns(text: str) -> int | None:
    """hhmmss.sss as nanoseconds of the day. The sentences of an epoch repeat it."""
    if not text:
        return None
    parts = TIME.fullmatch(text)
    if parts is None:
        raise RefusedError("time")
    hours, minutes, seconds = map(int, parts.group(1, 2, 3))
    if hours > 23 or minutes > 59 or seconds > 60:
        raise RefusedError("time")
    fraction = int((parts[4] or "").ljust(9, "0")[:9])
    return (hours * 3600 + minutes * 60 + seconds) * 1_000_000_000 + fraction


@lru_cache(maxsize=1)
def calendar(text: str) -> date | None:
    """ddmmyy; years from 80 on belong to the last century."""
    if not text:
        return None
    parts = DATE.fullmatch(text)
    if parts is None:
        raise RefusedError("date")
    day, month, year = map(int, parts.groups())
    try:
        return date(year + (1900 if year >= 80 else 2000), month, day)
    except ValueError as error:
        raise RefusedError("date") from error


def angle(text: str, hemisphere: str, digits: int, signs: str, limit: int, reason: str) -> float | None:
    """[d]ddmm.mmm and its hemisphere (positive, negative letter in `signs`) as degrees, at most `limit`."""
    if not text and not hemisphere:
        return None
    parts = DEGREES[digits].fullmatch(text)
    if parts is None or len(hemisphere) != 1 or hemisphere not in signs:
        raise RefusedError(reason)
    fraction = parts[3] or ""
    scale = 10 ** len(fraction)
    minutes = int(parts[2] + fraction)
    units = int(parts[1]) * 60 * scale + minutes
    if minutes >= 60 * scale or units > limit * 60 * scale:
        raise RefusedError(reason)
    degrees: float = units / (60 * scale)
    return degrees if hemisphere == signs[0] else -degrees
