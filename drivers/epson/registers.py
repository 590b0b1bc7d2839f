"""How a register is read and written over a UART, and the bits that mean the same in both dialects.

A write is address | 0x80, value, CR and is not answered; a read is address, any, CR and answered with address, high
byte, low byte, CR. Where registers are spread over windows, the window is selected first. Sources: Epson's public
drivers (ess_imu_driver, py_esensorlib), and rtedwards' code for the G350.
"""

from dataclasses import dataclass

CR = 0x0D
WIN_CTRL = 0x7E  # without effect where there are no windows

SAMPLE, CONFIGURE = 0x01, 0x02  # MODE_CTRL, high byte
CONFIGURING = 1 << 10  # MODE_CTRL
RESET = 0x80  # GLOB_CMD, low byte
NOT_READY = 1 << 10  # GLOB_CMD
AUTO, POLLED = 0x01, 0x00  # UART_CTRL, low byte
AUTO_START = 0x02  # UART_CTRL: it streams after a power-on, by itself
ALL_NEW = 0xFE  # SIG_CTRL, high byte: flags in FLAG for temperature, gyros, accelerometers not read yet
DATA_READY = 0x06  # MSC_CTRL, low byte: that line is on, and high when a sample is there; no external trigger
HARD_ERROR = 0x0060  # DIAG_STAT
TEST = 0x04  # MSC_CTRL, high byte
TESTING = 1 << 10  # MSC_CTRL
TEST_FAILED = 0x7802  # DIAG_STAT: a gyro or the accelerometers, and the summary


@dataclass(frozen=True)
class Register:
    """A 16-bit register: its low byte at the even `address`, its high byte at the next. No window: there are none."""

    address: int
    window: int | None = None

    def answer(self, reply: bytes) -> int | None:
        """The word in the reply to a read; None unless the reply is exactly that answer."""
        if len(reply) != 4 or reply[0] != self.address or reply[3] != CR:
            return None
        return reply[1] << 8 | reply[2]


Setting = tuple[Register, int | None, int | None]  # what its low and its high byte shall be; None: left as they are


def read(register: Register) -> bytes:
    """The command that reads the word."""
    return bytes((register.address, 0, CR))


def burst(header: int) -> bytes:
    """The command that has one frame sent, in polled mode; window 0 must be open."""
    return bytes((header, 0, CR))


def write(address: int, value: int) -> bytes:
    """The command that writes one byte."""
    return bytes((address | 0x80, value, CR))
