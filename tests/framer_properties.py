"""What every framer must do, whatever its device: any chunking gives the same samples, garbage neither raises nor
grows, and a good frame is neither lost nor held back because of bad bytes before it. Devices bring the streams.
"""

import numpy as np
from hypothesis import strategies as st
from in_c import in_c

from imud.drivers.sample import SAMPLE

SIZES = st.lists(st.integers(1, 60), min_size=1, max_size=20)
CAPACITY = st.integers(1, 7)
KEPT = 64  # bytes that a kernel may keep


def with_damage(frame, kind, at, inserted=0x55):
    """A frame with its byte `at` deleted, one `inserted` before it, or a bit of it flipped ("delete", "insert", …)."""
    middle = bytearray(frame)
    if kind == "delete":
        del middle[at]
    elif kind == "insert":
        middle.insert(at, inserted)
    else:
        middle[at] ^= 0x40
    return bytes(middle)


class Decoder:
    """A driver's kernel with its buffers; collects samples."""

    def __init__(self, driver, configured, capacity=256, room=1 << 17):
        self._decode, self.state = in_c(driver.decode), driver.new_state(configured)
        self.rx = np.zeros(room, np.uint8)
        self.batch = np.zeros(capacity, SAMPLE)
        self.samples = []

    def feed(self, data):
        fill = self["leftover"]
        self.rx[fill : fill + len(data)] = np.frombuffer(data, np.uint8)
        fill += len(data)
        while True:
            n = self._decode(self.rx, fill, self.state, self.batch)
            self.samples += [sample.copy() for sample in self.batch[:n]]
            fill = self["leftover"]
            if n < len(self.batch):
                return self

    def __getitem__(self, counter):
        return int(self.state[counter][0])

    @property
    def ticks(self):
        return [int(sample["tick"]) for sample in self.samples]

    @property
    def flags(self):
        return [int(sample["flags"]) for sample in self.samples]


def identical(a, b):
    return np.array(a, SAMPLE).tobytes() == np.array(b, SAMPLE).tobytes()


def is_subsequence(some, whole):
    rest = iter(whole)
    return all(item in rest for item in some)


def damaged(draw, frame):
    """`frame` cut, shortened, flipped in one bit, or with noise inside."""
    piece = bytearray(frame)
    at, what = draw(st.integers(0, len(piece) - 1)), draw(st.sampled_from(["cut", "drop", "flip", "noise"]))
    if what == "cut":
        del piece[at:]
    elif what == "drop":
        del piece[at]
    elif what == "flip":
        piece[at] ^= 1 << draw(st.integers(0, 7))
    else:
        piece[at:at] = draw(st.binary(max_size=50))
    return bytes(piece)


@st.composite
def damaged_streams(draw, frames):
    """Streams of `frames` (a strategy of lists of bytes) of which one in five is damaged."""
    return b"".join(damaged(draw, one) if draw(st.integers(0, 4)) == 0 else one for one in draw(frames))


def check_any_chunking(make, stream, sizes, capacity):
    """`make(capacity)` gives a fresh `Decoder`."""
    whole, bytewise, chunked = make(256).feed(stream), make(256), make(capacity)
    for byte in stream:
        bytewise.feed(bytes([byte]))
    at = k = 0
    while at < len(stream):
        chunked.feed(stream[at : at + sizes[k % len(sizes)]])
        at += sizes[k % len(sizes)]
        k += 1
    for other in (bytewise, chunked):
        assert identical(other.samples, whole.samples)
        assert other.state.tobytes() == whole.state.tobytes()


def check_garbage(decoder, noise, good, held_back=0):
    """After `noise`, of the frames `good` all but the first `held_back` come through."""
    decoder.feed(noise)
    assert decoder["leftover"] <= KEPT
    assert 0 <= decoder["junk"] <= len(noise)
    before = decoder["frames"]
    decoder.feed(b"".join(good))
    assert decoder["frames"] - before >= len(good) - held_back
    assert decoder["leftover"] <= KEPT


def check_last_byte(decoder, frames, content):
    """Each frame is delivered with its last byte; frames: pairs of a frame and the content(sample) it must give."""
    for frame, expected in frames:
        before = decoder.feed(frame[:-1])["frames"]
        decoder.feed(frame[-1:])
        assert decoder["frames"] == before + 1
        assert content(decoder.samples[-1]) == expected
