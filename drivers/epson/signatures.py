"""Recognition of an Epson sensor's automatic frames in a piece of its stream, in plain Python."""

from collections.abc import Sequence

from .dialects import Dialect, Layout
from .registers import CR

ENOUGH_FRAMES = 3  # in sequence: 1 in 2^48 of random bytes


def is_frame(frame: bytes, header: int, checked: bool = False) -> bool:
    """Whether header and CR are at the ends, and the sum fits if there is one.

    Lines of text may begin with a blank, which is the flat header, and end in CR. A frame is no text: FLAG is 0xFE00,
    and where another host has cleared that, the temperature of an M-G350 is a negative word, whatever it measures.
    """
    if frame[0] != header or frame[-1] != CR or frame.isascii():
        return False
    words = [int.from_bytes(frame[i : i + 2]) for i in range(1, len(frame) - 2, 2)]
    return not checked or sum(words[:-1]) & 0xFFFF == words[-1]


def longest_run(received: bytes, header: int, length: int, checked: bool = False) -> int:
    """Frames in the longest unbroken sequence of frames of `length`."""
    runs: dict[int, int] = {}  # frames in sequence, by where the last of them ends
    p = received.find(header)
    while 0 <= p <= len(received) - length:
        if is_frame(received[p : p + length], header, checked):
            runs[p + length] = runs.get(p, 0) + 1
        p = received.find(header, p + 1)
    return max(runs.values(), default=0)


def is_stream_of(received: bytes, dialect: Dialect) -> bool:
    """Whether this is a stream of the dialect, in whatever layout."""
    if received.count(dialect.header) < ENOUGH_FRAMES:
        return False
    return any(longest_run(received, dialect.header, length) >= ENOUGH_FRAMES for length in dialect.lengths)


def layout_of(received: bytes, layouts: Sequence[Layout]) -> Layout | None:
    """The layout of which most frames came in sequence, if enough did."""
    runs = [longest_run(received, layout.header, layout.length, layout.checked) for layout in layouts]
    return layouts[runs.index(max(runs))] if max(runs) >= ENOUGH_FRAMES else None
