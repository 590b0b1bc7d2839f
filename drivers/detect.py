"""Detection of the device on a line, and of its baud rate.

First listen: a device that streams is recognised without a byte written to it; unrecognised data are listened to at all
baud rates. Only a silent line is queried, by every driver at the baud rates that its devices use. A line with
unrecognised data is queried only if the user named a driver whose queries may interrupt a stream. All this is done in
three rounds, since a device may be starting up. Late answers are waited for at the likeliest baud rate; at all baud
rates in a fourth round, if any byte was received that was no answer. If there is nothing but a little garbage, it may
be a device that sends so rarely that the right baud rate was silent: those of NMEA, in which instruments send single
sentences, are listened to once more, longer. That takes long: it is done once until the line is plugged in anew. A line
on which a common protocol is recognised is listened to a little longer, in case the device also sends one of its own;
of both, the one with its fixes counts.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest

from .dialogue import Dialogue, Exchange
from .driver import AnyDriver, Identity, NativeProtocol, SpiDriver, Unsupported
from .findings import DATA_MIN, Echo, Finding, NoAnswer, NoGreeting, Silence, UnrecognisedData, is_garbage
from .registry import by_name, drivers
from .transport.portspec import IIO_DRIVER, SERVER_DRIVER, PortSpec

ROUNDS = 3  # and a fourth on a line with activity
LATE_SPEEDS = (1, 0, 1, 99)  # for each round, at how many of a driver's speeds late answers are waited for
RECEIVED_MAX = 1024  # bytes in which any driver recognises its device
LISTENING_ORDER = (38400, 460800, 4800, 57600, 230400, 9600, 115200, 19200, 921600)  # of equally likely speeds
ECHOES = 3  # in a row are no answers
GREETING_S = 5.0  # also for making the connection
NATIVE_S = 1.1  # in which a device that sends two protocols sends both: once a second
RARE_S = 2.3  # a sentence each second second, a little late
BITS = 10  # on the wire per byte
START_S = 0.4  # between rounds on SPI: a device may be starting up

Found = Identity | Unsupported


@dataclass
class Activity:
    """What was received while the line was queried: a device there may answer late, or in a way that is not known."""

    seen: bool = False  # any byte, also an echo
    answers: dict[int, bytes] = field(default_factory=dict)  # other bytes, by baud rate; the first ones

    def add(self, baud: int, sent: bytes, received: bytes) -> None:
        """What was received after `sent`."""
        self.seen |= bool(received)
        before = self.answers.get(baud, b"")
        if received != sent and len(before) < RECEIVED_MAX:
            self.answers[baud] = before + received

    def recognised(self, candidates: Sequence[AnyDriver]) -> Found | None:
        """The device that streams so rarely that it was heard only now."""
        for baud, answers in self.answers.items():
            if found := _recognised(candidates, answers, baud):
                return found
        return None

    def unrecognised(self, bauds: Sequence[int]) -> UnrecognisedData | None:
        """The answers as data of no known device; None if there were hardly any."""
        data = [UnrecognisedData(answers, baud, tuple(bauds)) for baud, answers in self.answers.items()]
        best = max(data, key=lambda one: one.rank, default=None)
        return best if best and len(best.received) >= DATA_MIN else None


def search(
    spec: PortSpec, readonly: bool = False, last_baud: int = 0, patient: bool = True
) -> Dialogue[Found | Finding]:
    """The device on the port as the user named it, or why there is none; `last_baud` and `patient` as in `detect`."""
    if spec.server:
        return detect_server()
    if spec.iio:
        return detect_iio()
    if spec.spi:
        return detect_spi(spec.driver, readonly)
    return detect(spec.driver, spec.baud, readonly, last_baud, patient)


def detect_server() -> Dialogue[Found | Finding]:
    """The gpsd at the other end of a connection. It greets first."""
    driver = by_name(SERVER_DRIVER)
    received = yield Exchange(listen_s=GREETING_S, enough=lambda received: driver.recognise(received) is not None)
    return driver.recognise(received) or NoGreeting()


def detect_iio() -> Dialogue[Found | Finding]:
    """The device that the kernel has; it is known by name."""
    return (yield from by_name(IIO_DRIVER).identify()) or NoAnswer(readonly=False)


def detect_spi(driver: str | None = None, readonly: bool = False) -> Dialogue[Found | Finding]:
    """The device on an SPI line. It sends nothing by itself, so every driver queries it."""
    candidates = (by_name(driver),) if driver else drivers()
    for _ in range(0 if readonly else ROUNDS):
        for one in candidates:
            if isinstance(one, SpiDriver) and (found := (yield from one.identify_spi())):
                return found
        yield Exchange(listen_s=START_S)
    return NoAnswer(readonly)


def detect(
    driver: str | None = None,
    baud: int | None = None,
    readonly: bool = False,
    last_baud: int = 0,
    patient: bool = True,
) -> Dialogue[Found | Finding]:
    """The device on the line, or why there is none; `driver` and `baud` as far as the user named them.

    readonly: only listen. last_baud: the speed at which a device was found here before, tried first; 0: none was.
    patient: listen longer after a little garbage.
    """
    candidates = (by_name(driver),) if driver else drivers()
    speeds = {one.name: (baud,) if baud else _from(last_baud, one.bauds) for one in candidates}
    bauds = _from(last_baud, tuple(_merged(speeds.values())))
    last: UnrecognisedData | None = None
    activity = Activity()
    for number, late_speeds in enumerate(LATE_SPEEDS):
        if number == ROUNDS and not activity.seen:
            break
        first = bauds[number % len(bauds)]
        received = yield from _listen(candidates, first)
        found = _recognised(candidates, received, first)
        if found is not None and first not in (baud, last_baud):
            found = yield from _at_likeliest_speed(candidates, found)
        data = None
        if found is None and len(received) >= DATA_MIN:
            last = UnrecognisedData(received, first, bauds)
            found, data = yield from _listen_at_all(candidates, bauds, first)
        if found is None and not readonly:
            queried = [one for one in candidates if driver or not isinstance(one, NativeProtocol)]
            if data is not None:
                queried = [one for one in queried if driver and one.interrupts]
            answer = yield from _query({one: speeds[one.name] for one in queried}, late_speeds, activity)
            if isinstance(answer, Echo):
                return answer
            found = answer or activity.recognised(candidates)
        if found is not None:
            yield Exchange(baud=found.baud)
            return (yield from _of_protocols(candidates, found, readonly))
        if data is not None:
            last = data
            break
    last = last or activity.unrecognised(bauds)
    if patient and last is not None and last.is_sparse:
        rare = {baud for one in candidates if _sends_rarely(one) for baud in speeds[one.name]}
        found = yield from _listen_longer(candidates, [baud for baud in bauds if baud in rare])
        if found is not None:
            return (yield from _of_protocols(candidates, found, readonly))
    return Silence(bauds, not readonly) if last is None else _of_another_driver(driver, last) or last


def _of_another_driver(named: str | None, data: UnrecognisedData) -> Unsupported | None:
    """The device whose data they are, if the user named the driver of another one."""
    found = _recognised(drivers(), data.received, data.baud) if named else None
    if not isinstance(found, Identity):
        return None
    why = f"its port is named with the driver {named}: name {found.driver}, or no driver"
    return Unsupported(found.driver, found.model, why, data.baud)


def _from(first: int, bauds: Sequence[int]) -> tuple[int, ...]:
    """The same speeds, `first` ahead of the others if it is among them."""
    return tuple(sorted(bauds, key=lambda baud: baud != first))


def _merged(lists: Iterable[Sequence[int]]) -> Iterator[int]:
    """Every driver's likeliest, then every driver's second, without repetition, whatever the order of the drivers."""
    ranks = (sorted(filter(None, rank), key=_listening_order) for rank in zip_longest(*lists))
    return iter(dict.fromkeys(baud for rank in ranks for baud in rank))


def _listening_order(baud: int) -> tuple[int, int]:
    """The place of a speed among those that are as likely; a speed that only a new driver has comes behind them."""
    return (LISTENING_ORDER.index(baud) if baud in LISTENING_ORDER else len(LISTENING_ORDER)), baud


def _recognised(candidates: Sequence[AnyDriver], received: bytes, baud: int) -> Found | None:
    for driver in candidates:
        if found := driver.recognise(received):
            found = replace(found, baud=baud)
            return replace(found, streaming=True) if isinstance(found, Identity) else found
    return None


def _of_protocols(candidates: Sequence[AnyDriver], found: Found, readonly: bool) -> Dialogue[Found]:
    """The device by the one of its two protocols that brings its fixes, or by its own if it can be set up in that."""
    both = [one for one in candidates if isinstance(one, NativeProtocol)]
    natives = [one for one in both if found.driver in (one.name, one.also_speaks)]
    if not natives or len(candidates) == 1:
        return found
    received = yield Exchange(
        listen_s=NATIVE_S, enough=lambda received: any(one.sends_fixes(received) for one in natives)
    )
    for native in natives:
        common = [one for one in candidates if one.name == native.also_speaks]
        own = found if found.driver == native.name else _recognised([native], received, found.baud)
        other = found if found.driver == native.also_speaks else _recognised(common, received, found.baud)
        if own and (other is None or native.sends_fixes(received)):
            return own
        if own and other:
            return own if not readonly and (yield from _answers(native, found.baud)) else other
    return found


def _answers(driver: AnyDriver, baud: int) -> Dialogue[bool]:
    """Whether its device answers on a line that carries other data, too."""
    found = yield from _unless_echoed(driver.identify(), baud, hurry=False, activity=Activity())
    return isinstance(found, Identity)


def _at_likeliest_speed(candidates: Sequence[AnyDriver], found: Found) -> Dialogue[Found]:
    """The device that was recognised at a speed that its driver does not know: at the driver's likeliest one, if it is
    recognised there, too. Then the line has no speed, as a pseudo-terminal.
    """
    bauds = by_name(found.driver).bauds
    if found.baud in bauds:
        return found
    received = yield from _listen(candidates, bauds[0])
    return _recognised(candidates, received, bauds[0]) or found


def _sends_rarely(driver: AnyDriver) -> bool:
    """Whether there are such devices: instruments that send single sentences. Sensors and native protocols do not."""
    return driver.kind == "gnss" and not isinstance(driver, NativeProtocol)


def _listen_longer(candidates: Sequence[AnyDriver], bauds: Sequence[int]) -> Dialogue[Found | None]:
    for baud in bauds:
        if found := _recognised(candidates, (yield from _listen(candidates, baud, RARE_S)), baud):
            return found
    return None


def _listen(candidates: Sequence[AnyDriver], baud: int, least_s: float = 0.0) -> Dialogue[bytes]:
    def enough(received: bytes) -> bool:
        return (
            len(received) >= RECEIVED_MAX or is_garbage(received) or _recognised(candidates, received, baud) is not None
        )

    timeout_s = max(least_s, *(driver.timeout_s for driver in candidates))
    return (yield Exchange(baud=baud, listen_s=timeout_s, enough=enough, discard=True))


def _listen_at_all(
    candidates: Sequence[AnyDriver], bauds: Sequence[int], first: int
) -> Dialogue[tuple[Found | None, UnrecognisedData | None]]:
    """Listen at all speeds to a line with unrecognised data, at the `first` one last; the device, or the best data.

    Neither if the line is silent meanwhile, as after the start message of a device.
    """
    data = UnrecognisedData(b"", first, tuple(bauds))
    for baud in (*(other for other in bauds if other != first), first):
        received = yield from _listen(candidates, baud)
        if found := _recognised(candidates, received, baud):
            return found, None
        if not received:
            return None, None
        data = max(data, replace(data, received=received, baud=baud), key=lambda data: data.rank)
    return None, data


def _query(
    speeds: Mapping[AnyDriver, Sequence[int]], late_speeds: int, activity: Activity
) -> Dialogue[Found | Echo | None]:
    """Every driver at its likeliest speed, then its second, and so on; wait for late answers at the first few."""
    for rank, of_rank in enumerate(zip_longest(*speeds.values())):
        for driver, speed in zip(speeds, of_rank, strict=True):
            if speed:
                yield Exchange(baud=speed, discard=True)
                found = yield from _unless_echoed(driver.identify(), speed, rank >= late_speeds, activity)
                if isinstance(found, Echo):
                    return found
                if found:
                    return (yield from _at_any_speed(driver, speeds[driver][0], speed)) or replace(found, baud=speed)
    return None


def _at_any_speed(driver: AnyDriver, likeliest: int, speed: int) -> Dialogue[Found | None]:
    """The device that answered at `speed`, if it answers at the likeliest speed, too: then the line has no speed.

    On such a line (a pseudo-terminal) the device was not ready yet when the likeliest speed was tried. A lower speed
    would lower its sample rate without need.
    """
    if speed == likeliest:
        return None
    yield Exchange(baud=likeliest, discard=True)
    found = yield from _unless_echoed(driver.identify(), likeliest, hurry=True, activity=Activity())
    if found and not isinstance(found, Echo):
        return replace(found, baud=likeliest)
    yield Exchange(baud=speed, discard=True)
    return None


def _unless_echoed(
    dialogue: Dialogue[Found | None], baud: int, hurry: bool, activity: Activity
) -> Dialogue[Found | Echo | None]:
    """The dialogue, ended once `ECHOES` commands in a row were echoed. hurry: without optional exchanges."""
    echoes = 0
    try:
        exchange = next(dialogue)
        while echoes < ECHOES:
            listen_s = exchange.listen_s + exchange.answer_bytes * BITS / baud
            received = b"" if hurry and exchange.optional else (yield replace(exchange, listen_s=listen_s))
            activity.add(baud, exchange.send, received)
            if exchange.send and received:
                echoes = echoes + 1 if received == exchange.send else 0
            exchange = dialogue.send(received)
    except StopIteration as finding:
        return finding.value  # type: ignore[no-any-return]
    return Echo(baud)
