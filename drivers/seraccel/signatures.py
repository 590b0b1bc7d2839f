"""Recognition of the board's stream, or of its menu, in a piece of bytes, in plain Python."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from .ranges import FULL_COUNT

_NUMBER = rb"([+-]?\d{1,4}(?:\.\d{1,4})?)"
_BETWEEN, _END = rb"[ \t,;]", rb"[ \t]*[\r\n]+"
LABELLED = re.compile(
    rb"[ \t]*" + (_BETWEEN + rb"*").join(axis + rb" ?[=:] *" + _NUMBER for axis in (b"X", b"Y", b"Z")) + _END,
    re.IGNORECASE,
)
PLAIN = re.compile(rb"[ \t]*" + (_BETWEEN + rb"+").join([_NUMBER] * 3) + _END)
FORCE_MAX_G = 10.0  # 8.25 at the converter's end in the widest range, and an offset
PIECE = re.compile(rb"[^\r\n]*(?:[\r\n]+|\Z)")  # matches everywhere: a search that fails takes the square of the bytes
PLAIN_LINES = 3  # in sequence; one line with labels is enough
BINARY = re.compile(rb"(?:#[\0-\3].[\0-\3].[\0-\3].\$){5,}", re.DOTALL)
FRAME = 8
MENU = re.compile(
    rb"ser(?:ial)? ?accel|accelerometer|MMA7[23]6|output (?:mode|frequency)|sensor range|desired (?:output|baud)|"
    rb"calibrat(?:e|ion) (?:menu|[xyz] axis)|"
    rb"\d\W{1,3}(?:calibrat|(?:set |change |output )?(?:mode|frequency)|(?:set |change |sensor )?range)",
    re.IGNORECASE,
)
PROMPT = re.compile(rb"(?:selection|\[x\][^\r\n]*)[:\s]*$", re.IGNORECASE)
FIRMWARE = re.compile(rb"firmware version[: ]*([\w.]+)", re.IGNORECASE)
RANGE = re.compile(rb"range[^\r\n]*?(\d(?:\.\d)?) ?g", re.IGNORECASE)


@dataclass(frozen=True)
class StreamedSamples:
    """Samples received: numbers as sent, g or counts."""

    samples: tuple[tuple[float, float, float], ...]
    counts: bool
    bytes_each: float  # with line end


def stream_in(received: bytes) -> StreamedSamples | None:
    """The longest unbroken run of samples, if it is long enough to be sure."""
    if runs := [match[0] for match in BINARY.finditer(received)]:
        run = max(runs, key=len)
        frames = [run[i : i + FRAME] for i in range(0, len(run), FRAME)]
        words = [[float(frame[i] << 8 | frame[i + 1]) for i in (1, 3, 5)] for frame in frames]
        return StreamedSamples(tuple((x, y, z) for x, y, z in words), True, FRAME)
    best: list[re.Match[bytes]] = []
    for lines in _text_runs(received):
        if len(lines) >= (1 if lines[0].re is LABELLED else PLAIN_LINES):
            best = max(best, lines, key=len)
    if not best:
        return None
    values = tuple((float(line[1]), float(line[2]), float(line[3])) for line in best)
    width = sum(len(line[0]) for line in best) / len(best)
    return StreamedSamples(values, b"." not in best[0][1], width)


def _text_runs(received: bytes) -> Iterator[list[re.Match[bytes]]]:
    """Runs of whole text lines; the first and the last piece may be cut."""
    run: list[re.Match[bytes]] = []
    for piece in PIECE.findall(received)[1:]:
        line = LABELLED.fullmatch(piece) or PLAIN.fullmatch(piece)
        if line and _is_plausible(line[1], line[2], line[3]):
            run.append(line)
        elif run:
            yield run
            run = []
    if run:
        yield run


def _is_plausible(*numbers: bytes) -> bool:
    """Whether the board sends such numbers. Other devices send angles, or fields in microtesla, in the same form."""
    if all(b"." in number for number in numbers):
        return max(abs(float(number)) for number in numbers) <= FORCE_MAX_G
    return not any(b"." in number for number in numbers) and all(0 <= int(number) <= FULL_COUNT for number in numbers)


def menu_in(received: bytes) -> bytes:
    """The text up to the end of what resembles the menu or one of its prompts; empty if nothing does."""
    matches = list(MENU.finditer(received))
    return received[: matches[-1].end()] if matches else b""


def ends_in_prompt(received: bytes) -> bool:
    """Whether the last words ask for a choice, of whatever menu."""
    return PROMPT.search(received) is not None


def is_streaming(received: bytes) -> bool:
    """Whether samples were received, after the menu if that was received too."""
    return stream_in(received[len(menu_in(received)) :]) is not None


def firmware_in(received: bytes) -> str:
    """Version in the menu; empty if there is none."""
    match = FIRMWARE.search(received)
    return match[1].decode("ascii") if match else ""


def range_in(received: bytes) -> float | None:
    """Range in g in the menu; None if there is none."""
    match = RANGE.search(received)
    return float(match[1]) if match else None
