"""Registers and commands of the flat dialect (M-G350, M-V340) on a UART, and the bytes that read and write them.

A write is address | 0x80, value, CR and is not answered; a read is address, any, CR and answered with address, high
byte, low byte, CR. Low bytes have even addresses. Sources: Epson's public V340 driver (sensor_epsonV340.h), and
rtedwards' code for the G350.
"""

CR = 0x0D
HEADER = 0x20  # of a burst and of an automatic frame

SMPL_CTRL = 0x36
MODE_CTRL = 0x38  # low byte: filter; high byte: mode
UART_CTRL = 0x3A
DIAG_STAT = 0x3C
GLOB_CMD = 0x3E
COUNT_CTRL = 0x50
PRODUCT_ID = (0x6A, 0x6C, 0x6E, 0x70)
VERSION = 0x72
SERIAL_NUMBER = (0x74, 0x76, 0x78, 0x7A)
WINDOWED_ID = 0x4C  # of M-G362 and later, window 0
WINDOWED_ID_VALUE = 0x5345

CONFIGURING = 1 << 10  # MODE_CTRL
NOT_READY = 1 << 10  # GLOB_CMD
HARD_ERROR = 0x60  # DIAG_STAT


def write(address: int, value: int) -> bytes:
    """The command that writes one byte."""
    return bytes((address | 0x80, value, CR))


def read(address: int) -> bytes:
    """The command that reads one word."""
    return bytes((address & 0x7E, 0, CR))


def answer(address: int, reply: bytes) -> int | None:
    """The word in the reply to `read(address)`; None unless the reply is exactly that answer."""
    if len(reply) != 4 or reply[0] != address & 0x7E or reply[3] != CR:
        return None
    return reply[1] << 8 | reply[2]


TO_CONFIGURATION = write(MODE_CTRL + 1, 0x02)
TO_SAMPLING = write(MODE_CTRL + 1, 0x01)
SOFT_RESET = write(GLOB_CMD, 0x80)
COUNT_ON = write(COUNT_CTRL, 0x01)
AUTO_ON = write(UART_CTRL, 0x01)
WINDOW_0 = write(0x7E, 0x00)  # without effect on the flat dialect
WINDOW_1 = write(0x7E, 0x01)
