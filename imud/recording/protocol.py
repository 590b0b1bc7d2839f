"""How a daemon talks to the process that writes its recording: packets of items, each a header and bytes."""

import struct
from collections.abc import Iterator
from enum import IntEnum

HEADER = struct.Struct("<BBHIq")  # kind, port, -, bytes that follow, CLOCK_MONOTONIC in ns
STATE = "state"  # level of what is no line for the log but JSON: path, bytes and trouble
PACKET = 1 << 18  # bytes, more than any packet


class MessageKind(IntEnum):
    """Of an item; in brackets what its bytes are."""

    START = 0  # JSON
    RAW = 1  # as read from the port
    CONNECTION = 2  # JSON of `imud.drivers.capture_messages.Connection`
    SAMPLES = 3  # rows of SAMPLE
    SOLUTIONS = 4  # rows of SOLUTION
    FIX = 5  # a row of FIX
    INNOVATIONS = 6  # rows of INNOVATION
    EVENT = 7  # JSON
    SETTINGS = 8  # JSON
    PULSE = 9  # nothing: its time is that of the pulse per second before the RAW that follows
    CLOCK = 10  # a row of CLOCK_FIT
    DISCARD = 11  # nothing: the start was refused; a file in which no device has streamed is removed
    MEASUREMENT = 12  # JSON of a measurement of an aiding source
    STATES = 13  # a row of FILTER_STATES


def items(packet: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    """(kind, port, t_ns, data) of each item."""
    at = 0
    while at < len(packet):
        kind, port, _, size, t_ns = HEADER.unpack_from(packet, at)
        at += HEADER.size
        yield kind, port, t_ns, packet[at : at + size]
        at += size
