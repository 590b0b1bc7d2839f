"""Ticks of a wheel sensor on a GPIO line, as speeds to a running imud. Needs `pip install 'imud[spi]'` (libgpiod 2).

    imud --port /dev/ttyUSB0 --port /dev/ttyUSB1 --set aiding.listen=/run/imud/aiding
    python gpio_ticks.py gpiochip0 17 0.0215 /run/imud/aiding

0.0215: metres of way per tick. The kernel stamps each tick, so that the speeds have their own times.
"""

import sys
from collections.abc import Iterable, Iterator

from imud.client import AidingSender

PERIOD_S = 0.1  # between speeds
STANDING_S = 0.5  # without a tick for so long it stands


def speeds(ticks: Iterable[float | None], metres_per_tick: float) -> Iterator[tuple[float, float]]:
    """(epoch, speed m/s) from the times of ticks, Unix s; None: PERIOD_S went by without one.

    A speed is that between the first and the last tick of at least PERIOD_S, and of the middle of their time.
    """
    first, last, count, silent_s = 0.0, 0.0, 0, 0.0
    for tick in ticks:
        if tick is None:
            silent_s += PERIOD_S
            if count and silent_s >= STANDING_S:
                yield last + silent_s, 0.0
        elif not count or silent_s >= STANDING_S:
            first, last, count, silent_s = tick, tick, 1, 0.0
        else:
            last, count, silent_s = tick, count + 1, 0.0
            if last - first >= PERIOD_S:
                yield 0.5 * (first + last), (count - 1) * metres_per_tick / (last - first)
                first, count = last, 1


def edges(chip: str, line: int) -> Iterator[float | None]:
    """The times of the line's rising edges, Unix s; None after each PERIOD_S without one."""
    import gpiod
    from gpiod.line import Clock, Edge

    settings = gpiod.LineSettings(edge_detection=Edge.RISING, event_clock=Clock.REALTIME)
    with gpiod.request_lines(f"/dev/{chip}", consumer="imud", config={line: settings}) as request:
        while True:
            if not request.wait_edge_events(PERIOD_S):
                yield None
                continue
            for event in request.read_edge_events():
                yield event.timestamp_ns * 1e-9


def main() -> None:
    """Sends until it is stopped."""
    if len(sys.argv) != 5:
        sys.exit("usage: gpio_ticks.py CHIP LINE METRES_PER_TICK ADDRESS")
    chip, line, metres, address = sys.argv[1:]
    with AidingSender(address) as sender:
        for epoch, speed in speeds(edges(chip, int(line)), float(metres)):
            sender.send("ODO", speed=speed, sigma=max(0.03 * speed, 0.05), t=epoch)


if __name__ == "__main__":
    main()
