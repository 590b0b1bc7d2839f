"""What an Epson sensor in automatic mode says by itself, found in a piece of its stream in plain Python."""

from .registers import CR, HEADER

ENOUGH_FRAMES = 3  # in sequence: 1 in 2^48 of random bytes
FLAT_LENGTHS = (20, 22)  # without and with COUNT
WINDOWED_HEADER = 0x80  # M-G352, M-G362 and later
WINDOWED_LENGTHS = range(8, 74, 2)


def longest_run(heard: bytes, header: int, length: int) -> int:
    """Frames in the longest unbroken sequence of frames of `length` that begin with `header`."""
    best = 0
    for start in range(min(length, len(heard))):
        run = 0
        for p in range(start, len(heard) - length + 1, length):
            run = run + 1 if heard[p] == header and heard[p + length - 1] == CR else 0
            best = max(best, run)
    return best


def flat_frames(heard: bytes) -> tuple[int, int]:
    """Number and length of the frames of the flat dialect in sequence; (0, 20) if there are none."""
    runs = {length: longest_run(heard, HEADER, length) for length in FLAT_LENGTHS}
    length = max(runs, key=lambda key: runs[key])
    return runs[length], length


def is_windowed(heard: bytes) -> bool:
    """Whether this is the stream of a later model, with register windows."""
    if heard.count(WINDOWED_HEADER) < 3:
        return False
    return any(longest_run(heard, WINDOWED_HEADER, length) >= 3 for length in WINDOWED_LENGTHS)
