"""What the fields of settings are made of: numbers with unit and range, texts, and types that several tables use."""

from typing import Annotated

import msgspec
from msgspec import Meta

replace = msgspec.structs.replace  # for those who would otherwise be the first to import msgspec


def number(least: float, most: float, unit: str, what: str = "", *, hot: bool = False, or_zero: bool = False) -> Meta:
    """A number of this unit (empty: a plain count) from `least` to `most`.

    Every number has a finite range, in which the whole program computes without overflow, underflow or division by
    zero. or_zero: 0 is allowed as well, with a meaning of its own (`config` checks what lies between).
    """
    extra = {"unit": unit, "hot": hot, "least": least, "or_zero": or_zero}
    return Meta(ge=0 if or_zero else least, le=most, description=what, extra=extra)


def text(
    what: str = "", *, form: str = r"^[^\x00-\x1f\x7f\ud800-\udfff]*\Z", example: str = "", longest: int = 4000
) -> Meta:
    """Text without control characters, which no path, address or name has, and without undecodable bytes.

    form: what else it must match; example: such a text, for messages.
    """
    extra = {
        "rule": f" like {example}" if example else f" without control characters, in UTF-8, at most {longest} long"
    }
    return Meta(pattern=form, max_length=longest, description=what, extra=extra)


Quality = Annotated[int, number(1, 8, "")]
Angle = Annotated[float, number(-360.0, 360.0, "deg")]
Length = Annotated[float, number(-1000.0, 1000.0, "m")]
Acceleration = Annotated[float, number(-100.0, 100.0, "m/s^2")]
Processor = Annotated[int, number(0, 8191, "")]
Name = Annotated[str, text()]
MESSAGE_RATE_HZ = (0.001, 1000.0)
HOT = {"hot": True}
RightAngle = Annotated[float, number(-90.0, 90.0, "deg")]
Height = Annotated[float, number(-1e4, 1e6, "m")]
Speed = Annotated[float, number(-1e4, 1e4, "m/s")]
