"""The angle-mode packet of the DMU RGA300CA: layout, scale factors, and what a checksum may be.

    0-1    2-3   4-5    6-7       8-13         14-15  16-17        18-19  20-21  22-23
    AA 55  roll  pitch  yaw rate  accel x y z  timer  temperature  part   BIT    checksum      words, big endian

Sources: Prasanna, Vehicle Localisation Using GPS and IMU (2009), tables "Data Packet Format" and "IMU Data Processing",
whose "divide by 0xFFFF" may be read in four ways; VRPN's vrpn_Tracker_Crossbow, written against a real unit, sums
bytes. The timer (a down-counter of 0.79 us in relatives) and the temperature follow the maker's other DMUs.
"""

import math

from ..sample import STANDARD_GRAVITY

HEADER = b"\xaa\x55"
LENGTH = 24
BODY = slice(2, 22)  # what the checksum covers
ROLL, PITCH, YAW_RATE, ACCEL, TIMER, TEMPERATURE, PART, BIT, CHECKSUM = 2, 4, 6, 8, 14, 16, 18, 20, 22

TICK_NS = 790  # of the timer
ANGLE_SCALE = math.pi / 32768.0  # rad per LSB
RATE_SCALE = math.radians(100.0 * 1.5) / 32768.0  # rad/s per LSB, AR = 100 deg/s
ACCEL_SCALE = 2.0 * 1.5 / 32768.0 * STANDARD_GRAVITY  # m/s^2 per LSB, GR = 2 g
RANGE_LSB = 21845  # rated range: the word holds 1.5 times as much
VOLTS, VOLTS_0_DEGC, DEGC_PER_VOLT = 5.0 / 4096.0, 1.375, 44.44

ACCEL_FAILED, ZERO_INVALID, ZEROING = 1 << 2, 1 << 4, 1 << 5  # bits of BIT in a relative; 0 in the healthy RGA known
FAULT_TEXTS = {
    ACCEL_FAILED: "the sensor reports a failed accelerometer (BIT bit 2)",
    ZERO_INVALID: "the sensor reports an invalid gyro zero (BIT bit 4)",
    ZEROING: "the sensor is finding its gyro's zero (BIT bit 5)",
}

CONVENTIONS = (
    "sum of bytes",
    "sum of words modulo 65536",
    "sum of words modulo 65535",
    "sum of bytes modulo 256",
)
SURE = 20  # packets in sequence before another convention than the first is accepted


def word(data: bytes, at: int) -> int:
    """Unsigned big-endian word."""
    return int.from_bytes(data[at : at + 2], "big")


def signed(data: bytes, at: int) -> int:
    """Two's complement big-endian word."""
    return int.from_bytes(data[at : at + 2], "big", signed=True)


def checksums(body: bytes) -> tuple[int, int, int, int]:
    """The checksum of an even number of bytes by each of `CONVENTIONS`."""
    total, words = sum(body), sum(word(body, i) for i in range(0, len(body), 2))
    return total, words & 0xFFFF, words % 0xFFFF, total & 0xFF


def is_packet(data: bytes, convention: int = 0) -> bool:
    """Whether this is one packet, whole and nothing else."""
    if len(data) != LENGTH or not data.startswith(HEADER):
        return False
    return checksums(data[BODY])[convention] == word(data, CHECKSUM)
