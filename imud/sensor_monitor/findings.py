"""What the sensor monitor finds: the bits of its findings, and what they are in words."""

import numpy as np
from numpy.typing import NDArray

FROZEN, LIMITED, INVALID, ZERO, WEIGHT, TEMPERATURE = 0, 6, 12, 18, 19, 20  # the first three per axis
SPIKE = 21  # per axis of the gyro
UNITS = 24
FINDINGS = 25

_PER_AXIS = ((FROZEN, "frozen"), (LIMITED, "at the end of its range"), (INVALID, "impossible"), (SPIKE, "shows spikes"))
_WHOLE = (
    (ZERO, "accelerometer shows nothing, not even gravity"),
    (WEIGHT, "accelerometer shows a steady force far from gravity"),
    (UNITS, "rates are in deg/s instead of rad/s: gravity turns 57 times less than they say"),
    (TEMPERATURE, "temperature is impossible"),
)


def words(findings: int) -> tuple[str, ...]:
    """Findings in words; none: the sensor is well."""
    if not findings:
        return ()
    texts = []
    for kind, what in _PER_AXIS:
        for first, name in ((0, "gyro"), (3, "accelerometer"))[: 1 if kind == SPIKE else 2]:
            axes = "".join("xyz"[i] for i in range(3) if findings >> (kind + first + i) & 1)
            if axes:
                texts.append(f"{name} {axes} {what}")
    texts += [text for bit, text in _WHOLE if findings >> bit & 1]
    return tuple(texts)


def counted(health: NDArray[np.void]) -> list[str]:
    """All that was ever found, of a HEALTH record array, with the number of samples."""
    counts = health["found"][0].tolist()
    return [f"{text} ({count} samples)" for bit, count in enumerate(counts) if count for text in words(1 << bit)]
