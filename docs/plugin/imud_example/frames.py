"""The decoder of its frames: a kernel, compiled by numba.

A frame is 16 bytes: A5 5A, a counter, six signed big-endian words (rates x y z in 0.01 deg/s, then specific forces
x y z in mg; axes forward, right, down), and the low byte of the sum of bytes 2 to 14.
"""

import math

import numpy as np

from imud.drivers.jit import kernel

FRAME = 16
RADPS, MPS2 = math.radians(0.01), 9.80665e-3  # per digit
_COUNTERS = ("leftover", "frames", "junk", "bad", "lost", "suspect", "errors", "status")
STATE = np.dtype([(name, "<i8") for name in (*_COUNTERS, "tick")], align=True)


def new_state():
    """A fresh state (array of one `STATE`)."""
    return np.zeros(1, STATE)


@kernel
def word(rx, p):
    """The signed word at p."""
    value = (int(rx[p]) << 8) | int(rx[p + 1])
    return value - 65536 if value >= 32768 else value


@kernel
def is_whole(rx, p):
    """Whether a whole frame is at p."""
    total = 0
    for i in range(2, FRAME - 1):
        total += int(rx[p + i])
    return rx[p] == 0xA5 and rx[p + 1] == 0x5A and total & 255 == rx[p + FRAME - 1]


@kernel
def decode(rx, fill, state, samples):
    """See `imud.drivers.driver.ImuDriver.decode`."""
    s = state[0]
    p, n = 0, 0
    while n < len(samples) and p + FRAME <= fill:
        if not is_whole(rx, p):
            s.junk += 1
            p += 1
            continue
        counter = int(rx[p + 2])
        step = (counter - s.tick) & 255 if s.frames > 0 else counter
        if s.frames > 0:
            s.lost += max(step, 1) - 1
        s.tick += step
        sample = samples[n]
        for i in range(3):
            sample.w[i] = word(rx, p + 3 + 2 * i) * RADPS
            sample.f[i] = word(rx, p + 9 + 2 * i) * MPS2
            sample.down[i] = 0.0
        sample.tick, sample.flags, sample.temperature = s.tick, 0, np.nan
        s.frames += 1
        n += 1
        p += FRAME
    for i in range(p, fill):
        rx[i - p] = rx[i]
    s.leftover = fill - p
    return n
