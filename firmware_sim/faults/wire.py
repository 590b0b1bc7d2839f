"""Faults of the line: damage to a message (a frame, a sentence, an answer) between the device and the host.

A message has at most one kind of damage, so that shares add up. The kind is drawn for every message, from a random
stream of the device's own.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from .spec import Fault

_DAMAGE_MAX = 3  # bits or bytes damaged at once
_JUNK_MAX = 16
_CR = b"\r"


def _flip(message: bytes, rng: np.random.Generator) -> bytes:
    damaged = bytearray(message)
    for bit in rng.choice(8 * len(message), min(_damaged_count(rng), 8 * len(message)), replace=False).tolist():
        damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def _drop(message: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(message)))
    return message[:at] + message[at + _damaged_count(rng) :]


def _duplicate(message: bytes, rng: np.random.Generator) -> bytes:
    at, end = int(rng.integers(len(message))), _damaged_count(rng)
    return message[: at + end] + message[at:]


def _replace(message: bytes, by: bytes, rng: np.random.Generator) -> bytes:
    """One byte between the first and the last, that is not so already, replaced."""
    offsets = [i for i in range(1, len(message) - 1) if message[i : i + 1] != by]
    if not offsets:
        return message
    at = int(rng.choice(offsets))
    return message[:at] + by + message[at + 1 :]


def _damaged_count(rng: np.random.Generator) -> int:
    return int(rng.integers(1, _DAMAGE_MAX + 1))


_DAMAGE: dict[str, Callable[[bytes, np.random.Generator], bytes]] = {
    "cut": lambda message, rng: message[: int(rng.integers(len(message)))],
    "flip": _flip,
    "drop": _drop,
    "dup": _duplicate,
    "header": lambda message, rng: _replace(message, message[:1], rng),
    "cr": lambda message, rng: _replace(message, _CR, rng),
    "junk": lambda message, rng: rng.bytes(int(rng.integers(1, _JUNK_MAX + 1))) + message,
    "lose": lambda message, rng: b"",
}


class WireLog:
    """All messages as sent and as arrived, as CSV. start: CLOCK_MONOTONIC of time 0 in s."""

    HEADER = "t_mono_s,device,fault,sent_hex,came_hex"

    def __init__(self, path: Path, start: float) -> None:
        self._file = path.open("w", encoding="ascii")
        self._start = start
        self._file.write(self.HEADER + "\n")

    def write(self, t: float, device: str, fault: str, sent: bytes, arrived: bytes) -> None:
        """One message; fault is empty where it arrives as it was sent."""
        self._file.write(f"{self._start + t:.6f},{device},{fault},{sent.hex()},{arrived.hex()}\n")

    def close(self) -> None:
        self._file.close()


class Wire:
    """The line of one device, for `Uart.damage`. Counts what it does to messages, by fault."""

    def __init__(
        self, device: str, faults: Sequence[Fault], rng: np.random.Generator, log: WireLog | None = None
    ) -> None:
        self.messages = 0
        self.counts: Counter[str] = Counter()
        self._device, self._rng, self._log = device, rng, log
        self._faults = sorted(faults, key=lambda fault: -fault.value)  # faults of all messages before those of shares

    def __call__(self, message: bytes, t: float) -> tuple[bytes, float]:
        """The arriving bytes of a message sent at time `t`, and until when it is delayed."""
        active = [fault for fault in self._faults if fault.span.holds(t)]
        draw = float(self._rng.random())
        arrived, until, name = message, -math.inf, ""
        for fault in active:
            if fault.name == "backlog":
                until = max(until, fault.span.after(t))
                continue
            if 0.0 <= draw < fault.value and not name:
                name = fault.name
                until = max(until, t + fault.second) if name == "delay" else until
                arrived = _DAMAGE[name](message, self._rng) if name in _DAMAGE else message
            draw -= fault.value
        self.messages += 1
        self.counts[name] += bool(name)
        if self._log is not None:
            self._log.write(t, self._device, name, message, arrived)
        return arrived, until

    def summary(self) -> str:
        """The counts of messages by kind of damage, as text."""
        kinds = ", ".join(f"{name} {n}" for name, n in sorted(self.counts.items()) if n)
        return f"{self.messages} messages sent, {sum(self.counts.values())} of them damaged{': ' * bool(kinds)}{kinds}"
