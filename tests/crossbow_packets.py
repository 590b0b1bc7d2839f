"""The angle-mode packets of a Crossbow DMU, made anew from the tables of docs/protocols.md 2."""

import struct

SPACING = 12658  # ticks of 0.79 us in 10 ms
STILL = (91, -105, -18, 95, 92, 10841)

SUMS = {  # of the 20 bytes between header and checksum
    "bytes": sum,
    "words 65536": lambda body: sum(struct.unpack(">10H", body)) % 65536,
    "words 65535": lambda body: sum(struct.unpack(">10H", body)) % 65535,
    "bytes 256": lambda body: sum(body) % 256,
}


def packet(words=STILL, clock=0, temperature=1569, part=300, bit=0, checksum=sum):
    """words: roll, pitch, yaw rate, accelerations, LSB."""
    body = struct.pack(">6h4H", *words, clock & 0xFFFF, temperature, part, bit)
    return b"\xaa\x55" + body + struct.pack(">H", checksum(body))


def packets(n, first=0, spacing=-SPACING, words=STILL, **fields):
    return [packet(words, (first + k) * spacing, **fields) for k in range(n)]
