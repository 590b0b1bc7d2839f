"""The decoder of the board's stream in all its modes: bytes to samples.

    X=-0.501 Y=-0.007 Z= 0.082     calculated gravity in g; the sign column of a positive number is blank
     0.01<TAB>-0.02<TAB> 1.00      the same by the successor's firmware
    0512<TAB>0498<TAB>0760         raw counts
    # xh xl yh yl zh zl $          binary: three counts, high byte first, without a line end

A text line ends with any run of CR and LF, or where the next one's X begins. What is no line is skipped; behind
damage a line begins after a line end or with an X, never in the middle. Lines have a fixed width, so a line of another
width has lost or gained a byte without breaking the grammar: it is delivered as suspect. Exceptions: the widths vary
anyway, or minus signs have explained such differences before (a board without a sign column has one byte more for each
minus). There is no counter: a line is one tick, and so is the length of a line of junk before it, or a part of it.

The board reports +1 g on the axis that points up: z, when it lies level with its parts up. That is specific force in
axes x forward, y left, z up, turned to FRD here. For z it is sure: the successor's factory test demands 0.8 to 1.2 g of
a board on the table, and the sensor's data sheet says so. That x and y follow the same rule in right-handed axes is
inferred; a unit that does not needs a mounting of its own.

Every decision is a function of the bytes alone, never of the chunks in which they came.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import kernel
from ..sample import SATURATED, STANDARD_GRAVITY, SUSPECT
from ..spikes import SPIKES, count_frame, is_spike
from ..words import Bytes, move_to_front, word
from .ranges import FULL_COUNT, Range
from .text import LETTER_X, MINUS, NO_NUMBER, read_line, skip_blanks

FRAME = 8  # bytes of a binary frame
LINE_MAX = 64  # bytes of a line
STRAY_BYTES = 2  # bytes of junk that are not counted as a lost line
HASH, DOLLAR, CR, LF = ord("#"), ord("$"), 13, 10
WIDTH_VOTES_MIN = 8  # lines that establish a width
DEVIATION_VOTES = 4  # by how many a line of another width reduces them
EXPLAINED_MIN = 3  # lines of another width that signs explained, after which signs always explain it
SPIKE_MG = 500.0  # per sample: a larger step that the next sample does not confirm is damage

STATE = np.dtype(
    [
        ("count_scale", "<f8"),  # m/s^2 per count
        ("end", "<f8"),  # m/s^2, of the range
        ("leftover", "<i8"),  # bytes kept at the front of the buffer
        ("synchronous", "<i8"),  # 1: the bytes follow a line end
        ("numbers", "<i8", (3,)),  # of a line
        ("force", "<f8", (3,)),  # m/s^2, x forward, y left, z up
        ("width", "<i8"),  # bytes of a text line
        ("unsigned_width", "<i8"),  # the same without minus signs
        ("width_votes", "<i8"),  # lines of that width, less those of others
        ("explained", "<i8"),  # lines of another width, but as long without minus signs
        ("gap", "<i8"),  # junk bytes since the last sample
        ("tick", "<i8"),
        ("spikes", SPIKES),
        ("frames", "<i8"),  # delivered
        ("junk", "<i8"),  # bytes that belong to no sample
        ("bad", "<i8"),  # pieces of text that are no line
        ("lost", "<i8"),  # samples that did not arrive whole
        ("suspect", "<i8"),
        ("errors", "<i8"),  # always 0: the board reports no faults
        ("status", "<i8"),  # likewise
    ],
    align=True,
)


def new_state(row: Range) -> NDArray[np.void]:
    """A decoder state (array of one `STATE`)."""
    state = np.zeros(1, STATE)
    state["count_scale"], state["end"] = row.scale, row.end_g * STANDARD_GRAVITY
    state["spikes"]["floor"] = SPIKE_MG
    return state


@kernel
def is_frame(rx: Bytes, p: int) -> bool:
    """Whether the eight bytes at p are a binary frame."""
    ends = rx[p] == HASH and rx[p + FRAME - 1] == DOLLAR
    return bool(ends and rx[p + 1] < 4 and rx[p + 3] < 4 and rx[p + 5] < 4)


@kernel
def piece_end(rx: Bytes, p: int, fill: int) -> int:
    """Where the text at p ends: at CR, LF, the next X or #, or at its longest; -1: not yet."""
    for at in range(p, min(p + LINE_MAX, fill)):
        byte = rx[at]
        if byte in (CR, LF) or (at > p and byte in (LETTER_X, HASH)):
            return at
    return p + LINE_MAX if p + LINE_MAX <= fill else -1


@kernel
def skip(s: Any, size: int) -> None:
    """Bytes that are no sample."""
    s.junk += size
    s.gap += size


@kernel
def force_from_counts(s: Any, x: int, y: int, z: int) -> bool:
    """Raw counts as force; False if no converter gives them."""
    if not (0 <= x <= FULL_COUNT and 0 <= y <= FULL_COUNT and 0 <= z <= FULL_COUNT):
        return False
    s.force[0] = (x - 0.5 * FULL_COUNT) * s.count_scale
    s.force[1] = (y - 0.5 * FULL_COUNT) * s.count_scale
    s.force[2] = (z - 0.5 * FULL_COUNT) * s.count_scale
    return True


@kernel
def force_from_text(s: Any, rx: Bytes, p: int, end: int) -> bool:
    """The line rx[p:end] as force; False if it is none."""
    decimals = read_line(rx, p, end, s.numbers)
    if decimals == NO_NUMBER:
        return False
    if decimals == 0:
        return force_from_counts(s, s.numbers[0], s.numbers[1], s.numbers[2])
    unit = 1
    for _ in range(decimals):
        unit *= 10
    for i in range(3):
        s.force[i] = s.numbers[i] / unit * STANDARD_GRAVITY
    return True


@kernel
def has_wrong_width(s: Any, rx: Bytes, p: int, end: int) -> bool:
    """Whether the line rx[p:end] has lost or gained a byte: its width is not the established one."""
    width = unsigned_width = end - p
    for at in range(p, end):
        unsigned_width -= rx[at] == MINUS
    fits = width == s.width
    if not fits and unsigned_width == s.unsigned_width:
        s.explained += 1
        fits = s.explained > EXPLAINED_MIN
    if fits:
        s.width_votes = min(s.width_votes + 1, 2 * WIDTH_VOTES_MIN)
        return False
    wrong = s.width_votes >= WIDTH_VOTES_MIN
    s.width_votes = max(s.width_votes - DEVIATION_VOTES, 0)
    if s.width_votes == 0:
        s.width, s.unsigned_width = width, unsigned_width
    return bool(wrong)


@kernel
def emit(s: Any, sample: Any, size: int, wrong: bool) -> None:
    """s.force as a sample that took `size` bytes."""
    missing = 0
    count_frame(s.spikes, s.frames > 0 and s.gap > STRAY_BYTES)
    if s.frames > 0:
        missing = (s.gap + size // 2) // size
        if missing == 0 and s.gap > STRAY_BYTES:
            missing = 1
        s.tick += 1 + missing
        s.lost += missing
    end, raw = s.end, s.spikes.raw
    saturated = False
    for i in range(3):
        raw[3 + i] = int(np.rint(s.force[i] * (1e3 / STANDARD_GRAVITY)))
        saturated |= abs(s.force[i]) >= end
    if is_spike(s.spikes, 1 + missing) or wrong:
        sample.flags = SUSPECT
        s.suspect += 1
    else:
        sample.flags = SATURATED if saturated else 0
    w, f, down = sample.w, sample.f, sample.down
    f[0], f[1], f[2] = s.force[0], -s.force[1], -s.force[2]
    for i in range(3):
        w[i] = down[i] = 0.0
    sample.temperature = np.nan
    sample.tick = s.tick
    s.frames += 1
    s.gap = 0


@kernel
def decode_piece(s: Any, rx: Bytes, p: int, end: int, fill: int, sample: Any) -> bool:
    """The text rx[p:end] as a sample; False if it is none."""
    if skip_blanks(rx, p, end) == end:
        return False
    last = rx[end] if end < fill else HASH
    ended = last in (CR, LF) or (last == LETTER_X and rx[p] == LETTER_X)
    if (s.synchronous or rx[p] == LETTER_X) and ended and end - p < LINE_MAX and force_from_text(s, rx, p, end):
        emit(s, sample, end - p, has_wrong_width(s, rx, p, end))
        return True
    skip(s, end - p)
    s.bad += 1
    return False


@kernel
def decode(rx: NDArray[np.uint8], fill: int, state: NDArray[np.void], samples: NDArray[np.void]) -> int:
    """See `ImuDriver.decode`. rx must hold 64 bytes more than one read brings; samples at least one row."""
    s: Any = state[0]
    p, n = 0, 0
    while n < len(samples) and p < fill:
        byte = rx[p]
        if byte in (CR, LF):
            s.synchronous = 1
            p += 1
            continue
        if byte == HASH:
            if p + FRAME > fill:
                break
            if is_frame(rx, p) and force_from_counts(s, word(rx, p + 1), word(rx, p + 3), word(rx, p + 5)):
                emit(s, samples[n], FRAME, False)
                n += 1
                p += FRAME
                s.synchronous = 0
                continue
        end = piece_end(rx, p, fill)
        if end < 0:
            break
        if decode_piece(s, rx, p, end, fill, samples[n]):
            n += 1
        s.synchronous = 0
        p = end
    s.leftover = fill - p
    move_to_front(rx, p, s.leftover)
    return n
