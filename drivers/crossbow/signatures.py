"""Recognition of a Crossbow DMU in a piece of its stream, in plain Python: the RGA's packets, and related models'.

A relative is named, not decoded: its ranges follow from its order number, which a stream does not contain.
Sources: Moog Crossbow VG700MB manual (7430-0280-01); public drivers of the AHRS400, VG and 440 series.
"""

from collections.abc import Callable
from dataclasses import dataclass

from .packet import CONVENTIONS, HEADER, LENGTH, SURE, is_packet, word

ENOUGH = 3  # packets with the usual checksum: each is 1 in 2^32 of random bytes
ENOUGH_ODD = 6  # in sequence, with another


def scan(received: bytes, convention: int = 0) -> list[int]:
    """Where packets begin."""
    found = []
    p = received.find(HEADER)
    while p >= 0:
        good = is_packet(received[p : p + LENGTH], convention)
        if good:
            found.append(p)
        p = received.find(HEADER, p + (LENGTH if good else 1))
    return found


def without_packets(received: bytes) -> bytes:
    """The bytes of `received` that are no packets."""
    rest, at = b"", 0
    for p in scan(received):
        rest += received[at:p]
        at = p + LENGTH
    return rest + received[at:]


def convention(received: bytes, enough: int = SURE) -> int | None:
    """By which of `CONVENTIONS` these packets are summed; None if there are none.

    Any but the first only by `enough` packets without a gap, while the first does not fit a single one.
    """
    if scan(received):
        return 0
    for other in range(1, len(CONVENTIONS)):
        starts = scan(received, other)
        run = 1
        for i in range(1, len(starts)):
            run = run + 1 if starts[i] - starts[i - 1] == LENGTH else 1
            if run >= enough:
                return other
    return None


def is_stream(received: bytes) -> bool:
    """Whether this is the stream of an RGA."""
    return len(scan(received)) >= ENOUGH or bool(convention(received, ENOUGH_ODD))


@dataclass(frozen=True)
class Relative:
    """A packet of another DMU, of fixed length. checked: whether its checksum is right."""

    name: str
    header: bytes
    length: int
    checked: Callable[[bytes], bool]

    def is_packet(self, data: bytes) -> bool:
        """Whether this is one packet, whole and nothing else."""
        return len(data) == self.length and data.startswith(self.header) and self.checked(data)


def _low_sum(data: bytes) -> bool:
    return sum(data[1:-1]) & 0xFF == data[-1]


def _byte_sum(data: bytes) -> bool:
    return sum(data[2:-2]) == word(data, len(data) - 2)


RELATIVES = (
    Relative("Crossbow VG700MB", HEADER, 26, _byte_sum),
    Relative("Crossbow AHRS or relative (30-byte packets)", b"\xff", 30, _low_sum),
    Relative("Crossbow VG or relative (22-byte packets)", b"\xff", 22, _low_sum),
    Relative("Crossbow IMU or relative (18-byte packets)", b"\xff", 18, _low_sum),
)
ENOUGH_RELATIVE = 4  # in sequence, no two the same: each is 1 in 2^16 of random bytes, or fewer
SERIES_440 = "Crossbow 440 series"


def relative(received: bytes) -> str:
    """The name of the related model that streams here; empty: none."""
    for kind in RELATIVES:
        p = received.find(kind.header)
        while p >= 0 and _sequence(kind, received[p:]) < ENOUGH_RELATIVE:
            p = received.find(kind.header, p + 1)
        if p >= 0:
            return kind.name
    return SERIES_440 if _is_440(received) else ""


def _sequence(kind: Relative, received: bytes) -> int:
    """Packets, each unlike the others, with which `received` begins."""
    seen: set[bytes] = set()
    while kind.is_packet(one := received[len(seen) * kind.length :][: kind.length]) and one not in seen:
        seen.add(one)
    return len(seen)


def _is_440(received: bytes) -> bool:
    """Two packets: U U, type (2 letters or digits), length, data, CRC of all from the type on."""
    found = 0
    p = received.find(b"UU")
    while 0 <= p < len(received) - 6:
        end = p + 5 + received[p + 4]
        body, crc = received[p + 2 : end], received[end : end + 2]
        good = body[:2].isalnum() and len(crc) == 2 and _crc(body) == word(crc, 0)
        found += good
        p = received.find(b"UU", end + 2 if good else p + 1)
    return found >= 2


def _crc(data: bytes) -> int:
    """CRC-16/AUG-CCITT."""
    crc = 0x1D0F
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return crc
