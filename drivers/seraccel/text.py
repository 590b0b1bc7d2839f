"""One line of the board's text to three whole numbers: a grammar that is tolerant of layout, not of damage.

    line   = 3 * ([label] number), separated by blanks, tabs or commas
    label  = X, Y, Z in their order, then = or :
    number = [+|-] digits [. digits], with equally many decimals in all three

Digits are kept as integers, so that a value is one quotient, correctly rounded.
"""

from typing import Any

from ..jit import kernel
from ..words import Bytes

TAB, BLANK, COMMA, SEMICOLON, COLON, EQUALS = 9, 32, 44, 59, 58, 61
PLUS, MINUS, POINT, ZERO, LETTER_X = 43, 45, 46, 48, 88
DIGITS_MAX = 9  # in one number
NO_NUMBER = -1


@kernel
def skip_blanks(rx: Bytes, at: int, end: int) -> int:
    """Where the next byte is that separates nothing."""
    while at < end and (rx[at] == BLANK or rx[at] == TAB or rx[at] == COMMA or rx[at] == SEMICOLON):
        at += 1
    return at


@kernel
def skip_label(rx: Bytes, at: int, end: int, axis: int) -> int:
    """Behind the label of `axis`, if one stands at `at`; `end` if it is not followed by a value."""
    if at == end or rx[at] & 0xDF != LETTER_X + axis:
        return at
    at = skip_blanks(rx, at + 1, end)
    if at == end or (rx[at] != EQUALS and rx[at] != COLON):
        return end
    return skip_blanks(rx, at + 1, end)


@kernel
def is_digit(rx: Bytes, at: int, end: int) -> bool:
    """Whether a digit stands at `at`."""
    return bool(at < end and ZERO <= rx[at] < ZERO + 10)


@kernel
def read_number(rx: Bytes, at: int, end: int) -> tuple[int, int, int]:
    """Digits with sign, decimals (NO_NUMBER: it is none), and where it ends."""
    negative = at < end and rx[at] == MINUS
    if at < end and (negative or rx[at] == PLUS):
        at += 1
    value, digits, decimals = 0, 0, 0
    if not is_digit(rx, at, end):
        return 0, NO_NUMBER, at
    while is_digit(rx, at, end) and digits <= DIGITS_MAX:
        value = 10 * value + (rx[at] - ZERO)
        digits += 1
        at += 1
    if at < end and rx[at] == POINT:
        at += 1
        while is_digit(rx, at, end) and digits <= DIGITS_MAX:
            value = 10 * value + (rx[at] - ZERO)
            digits += 1
            decimals += 1
            at += 1
        if decimals == 0:
            return 0, NO_NUMBER, at
    if digits > DIGITS_MAX:
        return 0, NO_NUMBER, at
    return -value if negative else value, decimals, at


@kernel
def read_line(rx: Bytes, start: int, end: int, numbers: Any) -> int:
    """Read rx[start:end] into `numbers` (3); returns their decimals, NO_NUMBER if that is no line."""
    at, common = start, 0
    for axis in range(3):
        before = at
        at = skip_blanks(rx, at, end)
        labelled = at < end and rx[at] & 0xDF == LETTER_X + axis
        if axis > 0 and at == before and not labelled:
            return NO_NUMBER
        at = skip_label(rx, at, end, axis)
        value, decimals, at = read_number(rx, at, end)
        if axis == 0:
            common = decimals
        if decimals == NO_NUMBER or decimals != common:
            return NO_NUMBER
        numbers[axis] = value
    return common if skip_blanks(rx, at, end) == end else NO_NUMBER
