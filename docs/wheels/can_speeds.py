"""Wheel speeds on a CAN bus, as speeds to a running imud. SocketCAN of the kernel, no package.

    sudo ip link set can0 up type can bitrate 500000
    imud --port /dev/ttyUSB0 --port /dev/ttyUSB1 --set aiding.listen=/run/imud/aiding
    python can_speeds.py can0 /run/imud/aiding

Identifier, place and unit of the speeds differ from vehicle to vehicle: they are in SIGNAL, as in a row of a DBC file.
`vcan0` (`ip link add vcan0 type vcan`) instead of `can0` is a bus without hardware, for trying it.
"""

import socket
import struct
import sys
import time
from dataclasses import dataclass

from imud.client import AidingSender

FRAME = struct.Struct("=IB3x8s")  # struct can_frame of linux/can.h: identifier and flags, length, data
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000


@dataclass(frozen=True)
class Signal:
    """Two unsigned numbers of 16 bits in one frame: the left and the right wheel of an axle."""

    identifier: int
    left: int  # first byte
    right: int
    big_endian: bool
    mps: float  # m/s of one count
    invalid: int = 0xFFFF  # what the bus says where there is none

    def decode(self, frame: bytes) -> tuple[float, float] | None:
        """Left and right speed, m/s; None: another frame, a damaged one, or no speeds in it."""
        if len(frame) != FRAME.size:
            return None
        identifier, length, data = FRAME.unpack(frame)
        if identifier & (REMOTE | ERROR) or identifier & ~EXTENDED != self.identifier:
            return None
        if length < max(self.left, self.right) + 2:
            return None
        order = ">" if self.big_endian else "<"
        left, right = (struct.unpack_from(f"{order}H", data, first)[0] for first in (self.left, self.right))
        return None if self.invalid in (left, right) else (left * self.mps, right * self.mps)


SIGNAL = Signal(identifier=0x4B0, left=0, right=2, big_endian=True, mps=0.01 / 3.6)  # 0.01 km/h: change it


def forward(bus: socket.socket, sender: AidingSender, signal: Signal) -> None:
    """Send the speeds of each frame of the bus; returns when the bus is closed.

    The daemon estimates how late they are: what a control unit averages, and how long it waits, no bus says.
    """
    while frame := bus.recv(FRAME.size):
        if speeds := signal.decode(frame):
            sender.send("ODO", left=speeds[0], right=speeds[1], t=time.time())


def main() -> None:
    """Sends until it is stopped."""
    if len(sys.argv) != 3:
        sys.exit("usage: can_speeds.py INTERFACE ADDRESS")
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus, AidingSender(sys.argv[2]) as sender:
        bus.bind((sys.argv[1],))
        forward(bus, sender, SIGNAL)


if __name__ == "__main__":
    main()
