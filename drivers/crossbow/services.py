"""Services of a Crossbow DMU: find the gyro's zero, change the baud rate. Both last until it is switched off."""

import math

from ..dialogue import Dialogue
from ..driver import Done, Identity, Service
from .packet import ACCEL, ACCEL_SCALE, RATE_SCALE, YAW_RATE, signed
from .protocol import ask_packets, change_baud, describe, find_zero
from .signatures import convention, scan

NAME = "crossbow"
HUNDRED_S = 0.35  # that a hundred samples take: VRPN found 3 to 4 ms each
PACKETS = 50  # packets
STILL_DPS, STILL_MPS2 = 1.5, 0.3  # standard deviations that a unit at rest stays below
ZERO_MAX_DPS = 10.0  # a larger mean rate is rotation
ZEROED_DPS = 0.3  # several sigmas of the mean of so many packets
BAUDS = (9600, 19200, 38400, 57600)


def gyro_at_rest() -> Dialogue[float | str]:
    """What the gyro reads at rest (deg/s), or a text: why it cannot be measured. Leaves the unit in polled mode."""
    received = yield from ask_packets(PACKETS)
    summed = convention(received)
    if summed is None:
        return "it does not answer requests for packets"
    starts = scan(received, summed)
    rates = [math.degrees(RATE_SCALE) * signed(received, p + YAW_RATE) for p in starts]
    forces = [math.hypot(*(ACCEL_SCALE * signed(received, p + ACCEL + axis) for axis in (0, 2, 4))) for p in starts]
    from statistics import fmean, pstdev  # for this service only

    if pstdev(rates) > STILL_DPS or pstdev(forces) > STILL_MPS2 or abs(fmean(rates)) > ZERO_MAX_DPS:
        return "it is not at rest: put it where nothing moves it, and try again"
    return fmean(rates)


def zero(seconds: int) -> Dialogue[Done]:
    """Have the gyro's zero found, at rest."""
    before = yield from gyro_at_rest()
    if isinstance(before, str):
        return Done(False, before)
    if not (yield from find_zero(round(seconds / HUNDRED_S))):
        return Done(
            False, "it did not report that it has found its zero; switch it off and on to discard a partial one"
        )
    after = yield from gyro_at_rest()
    if isinstance(after, str):
        return Done(False, f"it reports that it has found its zero, but {after}")
    message = f"its gyro reads {after:+.2f} deg/s at rest; before, {before:+.2f}"
    good = abs(after) < ZEROED_DPS
    return Done(good, message if good else f"{message}; was it moved? Try again")


def baud(speed: int) -> Dialogue[Done]:
    """Change the baud rate, and check that the same unit answers."""
    if not (yield from change_baud(speed)):
        return Done(False, f"it does not answer at {speed} baud; switch it off and on: it will be at its old baud rate")
    found = yield from describe(NAME)
    if not isinstance(found, Identity):
        return Done(False, f"something answers at {speed} baud, but not as before; switch it off and on")
    return Done(True, f"{found.model}, serial {found.serial}, answers: name its port DEV:{NAME}@{speed}")


SERVICES = {
    "zero": Service(
        "averages its gyro for {} s and subtracts the mean until it is switched off; it must not be moved meanwhile.",
        "s",
        range(1, 90),
        60,
        zero,
    ),
    "baud": Service(
        "changes to {} baud until it is switched off; it is found there only if its port is named with that baud rate.",
        "baud",
        BAUDS,
        None,
        baud,
    ),
}
