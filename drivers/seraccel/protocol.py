"""Starting the board's stream, and measuring its rate: a dialogue that never writes while it streams.

Any byte stops a running stream and brings up the menu, so nothing is sent before the line has been listened to. A
silent board may be waiting in its menu: 0xFF, which is no menu choice at whatever speed it is misheard, makes it print
the menu again. `x` leaves the menu; it is sent only after text that resembles the menu, once that text has ended.
"""

from ..dialogue import Dialogue, Exchange
from .signatures import ends_in_prompt, is_streaming, menu_in, stream_in

PROBE, LEAVE = b"\xff", b"x"
LISTEN_S = 0.04  # before a silent line is probed; the detection has listened for longer
ANSWER_S, MENU_S = 0.08, 1.0  # to the first bytes of the menu; to its end, 600 bytes at 9600 baud
QUIET_S = 0.15  # within a menu there is no pause of that length
START_S = 2.5
TIMEOUT_S = 1.3
ATTEMPTS = 6
SPAN_S, LINES, SPANS = 2.0, 40, 3  # of listening for the rate: so many times, until there are enough lines
WHOLE_HZ = 12.0  # slower rates are whole numbers, as the menu sets them


def probe() -> Dialogue[bytes]:
    """The bytes on the line; a line that is silent, or only showed a prompt, is asked for the menu."""
    received = yield Exchange(listen_s=LISTEN_S, enough=lambda received: len(received) > 0)
    if received:
        received = yield from listen_until_silent(received)
        if menu_in(received) or not ends_in_prompt(received):
            return received
    received = yield Exchange(PROBE, ANSWER_S, enough=lambda received: len(received) > 0)
    return (yield from listen_until_silent(received)) if received else b""


def listen_until_silent(received: bytes) -> Dialogue[bytes]:
    """Listen until the line is quiet, or streams."""
    spent_s = 0.0
    while spent_s < MENU_S and not is_streaming(received):
        more = yield Exchange(listen_s=QUIET_S)
        if not more:
            break
        received += more
        spent_s += QUIET_S
    return received


def reach_stream(readonly: bool) -> Dialogue[tuple[bool, bytes]]:
    """Whether the board streams now, left from its menu if need be, and what was received meanwhile."""
    everything = received = yield Exchange(
        listen_s=TIMEOUT_S, enough=lambda received: is_streaming(received) or bool(menu_in(received))
    )
    for _ in range(ATTEMPTS):
        if is_streaming(received):
            return True, everything
        if readonly:
            break
        if menu_in(received):
            received = yield from leave_menu(received)
        elif received:
            received = yield from listen_until_silent(b"")
        else:
            received = yield from probe()
        everything += received
    return is_streaming(received), everything


def leave_menu(received: bytes) -> Dialogue[bytes]:
    """Once the menu's text has ended, leave it; returns what comes then."""
    text = yield from listen_until_silent(received)
    if is_streaming(text):
        return text
    return (
        yield Exchange(
            LEAVE, START_S, enough=lambda received: is_streaming(received) or bool(menu_in(received)), discard=True
        )
    )


def measure_rate() -> Dialogue[tuple[float, bytes]]:
    """Samples per second of the running stream, 0 if it ended, and what was received of it."""
    received = yield Exchange(listen_s=SPAN_S, discard=True)
    spans = 1
    while (stream := stream_in(received)) and len(received) < LINES * stream.bytes_each and spans < SPANS:
        received += yield Exchange(listen_s=SPAN_S)
        spans += 1
    if stream is None:
        return 0.0, received
    rate_hz = len(received) / stream.bytes_each / (spans * SPAN_S)
    return (rate_hz if rate_hz > WHOLE_HZ else max(1.0, round(rate_hz))), received
