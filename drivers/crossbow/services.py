"""What a Crossbow DMU does on request: finds its gyro's zero, changes its speed. Both last until it is switched off."""

import math
from statistics import fmean, pstdev

from ..dialogue import Dialogue
from ..driver import Done, Identity, Service
from .packet import ACCEL, ACCEL_SCALE, RATE_SCALE, YAW_RATE, signed
from .protocol import ask_packets, change_baud, describe, find_zero
from .signatures import convention, scan

NAME = "crossbow"
HUNDRED_S = 0.35  # that a hundred samples take: VRPN found 3 to 4 ms each
LOOKS = 50  # packets
STILL_DPS, STILL_MPS2 = 1.5, 0.3  # standard deviations that a unit at rest stays below
TURNING_DPS = 10.0  # more is no zero of a gyro
ZEROED_DPS = 0.3  # several sigmas of the mean of so many packets
BAUDS = (9600, 19200, 38400, 57600)


def look() -> Dialogue[float | str]:
    """What the gyro reads at rest (deg/s), or in words why it cannot be told. Leaves the unit in polled mode."""
    heard = yield from ask_packets(LOOKS)
    summed = convention(heard)
    if summed is None:
        return "it does not answer requests for packets"
    starts = scan(heard, summed)
    rates = [math.degrees(RATE_SCALE) * signed(heard, p + YAW_RATE) for p in starts]
    forces = [math.hypot(*(ACCEL_SCALE * signed(heard, p + ACCEL + axis) for axis in (0, 2, 4))) for p in starts]
    if pstdev(rates) > STILL_DPS or pstdev(forces) > STILL_MPS2 or abs(fmean(rates)) > TURNING_DPS:
        return "it is not at rest: put it where nothing moves it, and try again"
    return fmean(rates)


def zero(seconds: int) -> Dialogue[Done]:
    """Have the gyro's zero found, at rest."""
    before = yield from look()
    if isinstance(before, str):
        return Done(False, before)
    if not (yield from find_zero(round(seconds / HUNDRED_S))):
        return Done(False, "it did not say that it has found its zero; switch it off and on to be rid of half a one")
    after = yield from look()
    if isinstance(after, str):
        return Done(False, f"it says that it has found its zero, but {after}")
    told = f"its gyro reads {after:+.2f} deg/s at rest; before, {before:+.2f}"
    good = abs(after) < ZEROED_DPS
    return Done(good, told if good else f"{told}; was it moved? Try again")


def baud(speed: int) -> Dialogue[Done]:
    """Go over to another speed, and see who answers there."""
    if not (yield from change_baud(speed)):
        return Done(False, f"it does not answer at {speed} baud; switch it off and on: it will be at its old speed")
    found = yield from describe(NAME)
    if not isinstance(found, Identity):
        return Done(False, f"something answers at {speed} baud, but not as before; switch it off and on")
    return Done(True, f"{found.model}, serial {found.serial}, answers: name its port DEV:{NAME}@{speed}")


SERVICES = {
    "zero": Service(
        "takes what its gyro reads for {} s for zero, until it is switched off; it must not be moved meanwhile.",
        "s",
        range(1, 90),
        60,
        zero,
    ),
    "baud": Service(
        "goes over to {} baud, until it is switched off; it is found there only by who names its port so.",
        "baud",
        BAUDS,
        None,
        baud,
    ),
}
