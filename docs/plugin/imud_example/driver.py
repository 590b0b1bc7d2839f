"""The driver of a sensor that sends frames by itself, and that cannot be asked (see `frames`)."""

from types import MappingProxyType

from imud.drivers.dialogue import Exchange
from imud.drivers.driver import Identity, ImuConfigured

RATE_HZ, FRAME = 100.0, 16
SURE = 5  # frames in a row


def is_frame(piece):
    """Whether the bytes are a whole frame."""
    return piece[:2] == b"\xa5\x5a" and sum(piece[2:-1]) & 255 == piece[-1]


def frames_in(received):
    """The number of whole frames."""
    return sum(is_frame(received[p : p + FRAME]) for p in range(len(received) - FRAME + 1))


class Example:
    """The driver (`imud.drivers.driver.ImuDriver`)."""

    name = "example"
    kind = "imu"
    bauds = (115200,)
    timeout_s = 0.5
    interrupts = False
    fault_texts = MappingProxyType({})

    def recognise(self, received):
        """Five whole frames."""
        return Identity(self.name, "Example 6-axis") if frames_in(received) >= SURE else None

    def identify(self):
        """It answers no question, so that a silent line is not its own."""
        return None
        yield

    def configure(self, identity, options):
        """Listen: there is nothing to set up."""
        received = yield Exchange(b"", 0.5, enough=lambda received: len(received) >= 2 * FRAME)
        if not frames_in(received):
            return None
        period_ns = round(1e9 / RATE_HZ)
        return ImuConfigured(identity, RATE_HZ, period_ns, delay_ns=round(FRAME * 10 / 115200 * 1e9), frame_bytes=FRAME)

    def new_state(self, configured):
        """See `ImuDriver`."""
        from .frames import new_state

        return new_state()

    @property
    def decode(self):
        """See `ImuDriver`."""
        from .frames import decode

        return decode


DRIVER = Example()
