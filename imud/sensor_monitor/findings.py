"""What the sensor monitor can find: a bit for each finding, and its words."""

from ..math.arrays import Records

FROZEN, LIMITED, INVALID, SPIKE = 0, 6, 12, 21  # six bits each, for the axes
ZERO, WEIGHT, TEMPERATURE, UNITS, REPEATED = 18, 19, 20, 27, 28
FINDINGS = 29

_PER_AXIS = ((FROZEN, "frozen"), (LIMITED, "at the end of its range"), (INVALID, "impossible"), (SPIKE, "shows spikes"))
_WHOLE = (
    (ZERO, "accelerometer shows nothing, not even gravity"),
    (WEIGHT, "accelerometer shows a steady force far from gravity"),
    (UNITS, "rates are in deg/s instead of rad/s: gravity turns 57 times less than they say"),
    (REPEATED, "inertial sensor sends the same sample again and again"),
    (TEMPERATURE, "temperature is impossible"),
)


def words(findings: int) -> tuple[str, ...]:
    """Findings in words; empty where there are none."""
    if not findings:
        return ()
    texts = []
    for kind, what in _PER_AXIS:
        for first, name in ((0, "gyro"), (3, "accelerometer")):
            axes = "".join("xyz"[i] for i in range(3) if findings >> (kind + first + i) & 1)
            if axes:
                texts.append(f"{name} {axes} {what}")
    texts += [text for bit, text in _WHOLE if findings >> bit & 1]
    return tuple(texts)


def counted(health: Records) -> list[str]:
    """All findings since the start with their numbers of samples, of a HEALTH record array."""
    counts = health["found_count"][0].tolist()
    return [f"{text} ({count} samples)" for bit, count in enumerate(counts) if count for text in words(1 << bit)]
