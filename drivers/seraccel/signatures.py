"""What the board says by itself, found in a piece of it in plain Python: its stream, or its menu."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

_NUMBER = rb"([+-]?\d{1,4}(?:\.\d{1,4})?)"
_BETWEEN, _END = rb"[ \t,;]", rb"[ \t]*[\r\n]+"
LABELLED = re.compile(
    rb"[ \t]*" + (_BETWEEN + rb"*").join(axis + rb" ?[=:] *" + _NUMBER for axis in (b"X", b"Y", b"Z")) + _END,
    re.IGNORECASE,
)
PLAIN = re.compile(rb"[ \t]*" + (_BETWEEN + rb"+").join([_NUMBER] * 3) + _END)
PIECE = re.compile(rb"[^\r\n]*[\r\n]+")
PLAIN_LINES = 3  # in sequence; one with labels is telling enough
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
class Stream:
    """Samples heard: numbers as sent, g or counts."""

    samples: tuple[tuple[float, float, float], ...]
    counts: bool
    bytes_each: float  # with line end


def stream_in(heard: bytes) -> Stream | None:
    """The longest unbroken run of samples, if it is long enough to be sure."""
    if runs := [match[0] for match in BINARY.finditer(heard)]:
        run = max(runs, key=len)
        frames = [run[i : i + FRAME] for i in range(0, len(run), FRAME)]
        words = [[float(frame[i] << 8 | frame[i + 1]) for i in (1, 3, 5)] for frame in frames]
        return Stream(tuple((x, y, z) for x, y, z in words), True, FRAME)
    best: list[re.Match[bytes]] = []
    for lines in _text_runs(heard):
        if len(lines) >= (1 if lines[0].re is LABELLED else PLAIN_LINES):
            best = max(best, lines, key=len)
    if not best:
        return None
    values = tuple((float(line[1]), float(line[2]), float(line[3])) for line in best)
    width = sum(len(line[0]) for line in best) / len(best)
    return Stream(values, b"." not in best[0][1], width)


def _text_runs(heard: bytes) -> Iterator[list[re.Match[bytes]]]:
    """Runs of whole text lines; the first and the last piece may be cut."""
    run: list[re.Match[bytes]] = []
    for piece in PIECE.findall(heard)[1:]:
        line = LABELLED.fullmatch(piece) or PLAIN.fullmatch(piece)
        if line and len({b"." in line[axis] for axis in (1, 2, 3)}) == 1:
            run.append(line)
        elif run:
            yield run
            run = []
    if run:
        yield run


def menu_in(heard: bytes) -> bytes:
    """The text up to the end of what resembles the menu or one of its prompts; empty if nothing does."""
    matches = list(MENU.finditer(heard))
    return heard[: matches[-1].end()] if matches else b""


def ends_in_prompt(heard: bytes) -> bool:
    """Whether the last words ask for a choice, of whatever menu."""
    return PROMPT.search(heard) is not None


def is_streaming(heard: bytes) -> bool:
    """Whether samples were heard, after the menu if that was heard too."""
    return stream_in(heard[len(menu_in(heard)) :]) is not None


def firmware_in(heard: bytes) -> str:
    """Version as the menu tells it; empty if it does not."""
    match = FIRMWARE.search(heard)
    return match[1].decode("ascii") if match else ""


def range_in(heard: bytes) -> float | None:
    """Range in g as the menu tells it."""
    match = RANGE.search(heard)
    return float(match[1]) if match else None
