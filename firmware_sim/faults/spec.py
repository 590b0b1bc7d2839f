"""The language of `--faults`: which faults there are, of which devices, how they are written.

    SPEC   = GROUP;GROUP…            GROUP = [DEVICE:]FAULT,FAULT…      without DEVICE: of all that can have it
    FAULT  = NAME[=VALUE[xVALUE2]][@FROM[-[TO]][/PERIOD]]               seconds since the start; without: always

`flip=0.01,cut=0.01;gnss:loss@20-40;imu:frozen=gx+gy@30-35;unplug@10-12/30`
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..device import OTHERS, POLLED, PROGRAMS, RECEIVERS
from ..iio_chips import CHIPS

AXES = ("gx", "gy", "gz", "ax", "ay", "az")
IMU, GNSS, IIO, OTHER = "imu", "gnss", "iio", "other"  # IIO: an inertial sensor behind the kernel
SYSFS = "sysfs"  # a barometer or magnetometer behind the kernel
PROGRAM = "program"  # of another system, which sends datagrams
BOTH, SENSORS = (IMU, GNSS, OTHER), (IMU, IIO)
MESSAGES = (*BOTH, PROGRAM)
READINGS, MEASURING = (*MESSAGES, SYSFS), (OTHER, SYSFS, PROGRAM)
ROLES = {GNSS: RECEIVERS, OTHER: OTHERS, IIO: CHIPS, SYSFS: POLLED, PROGRAM: PROGRAMS}
_FAULT = re.compile(r"(?P<name>[a-z]+)(?:=(?P<value>[^@]*))?(?:@(?P<span>.*))?")
_SPAN = re.compile(r"(?P<begin>[\d.]+)(?P<dash>-(?P<end>[\d.]+)?)?(?:/(?P<period>[\d.]+))?")


EXAMPLE = "flip=0.01,cut=0.01;gnss:loss@20-40;imu:frozen=gx+gy@30-35;unplug@10-12/30"


class SpecError(ValueError):
    """A --faults that makes no sense; the message says which part, and which faults there are."""


@dataclass(frozen=True)
class Span:
    """Times from `begin` on and before `end`, in s since the start, again every `period`."""

    begin: float = 0.0
    end: float = math.inf
    period: float = math.inf

    def holds(self, t: float) -> bool:
        """Whether time `t` lies within."""
        return self.begin <= t and (t < self.end or self.since(t) < self.end - self.begin)

    def since(self, t: float) -> float:
        """Time from the latest beginning to `t`; negative before the first."""
        return t - self.begin if t < self.begin or math.isinf(self.period) else (t - self.begin) % self.period

    def after(self, t: float) -> float:
        """The first beginning or end later than `t`; infinite if there is none."""
        if t < self.begin:
            return self.begin
        start = t - self.since(t)
        return next(x for x in (start + self.end - self.begin, start + self.period, math.inf) if x > t)

    def nth(self, n: int) -> float:
        """When it begins after `n` beginnings; infinite if never again."""
        return self.begin + n * self.period if n else self.begin

    def beginnings(self, t: float) -> int:
        """How often it has begun at time `t`."""
        if t < self.begin:
            return 0
        return 1 if math.isinf(self.period) else 1 + math.floor((t - self.begin) / self.period + 1e-9)


@dataclass(frozen=True)
class Fault:
    """One fault as it was asked for. What the values mean says its row in `KINDS`."""

    name: str
    value: float
    second: float
    axes: tuple[int, ...]
    span: Span


@dataclass(frozen=True)
class FaultKind:
    """One row of the language. needs: a beginning; closed: an end as well."""

    layer: str
    of: tuple[str, ...]
    meaning: str
    default: float | None = None  # of the value; None: it must be given
    second: float | None = None  # default of the second value; None: there is none
    most: float = math.inf
    axes: bool = False  # the value names axes
    needs: bool = False
    closed: bool = False


SHARE = "share of the messages"
KINDS: dict[str, FaultKind] = {
    "cut": FaultKind("wire", MESSAGES, f"{SHARE} that lose their end", most=1.0),
    "flip": FaultKind("wire", MESSAGES, f"{SHARE} with 1 to 3 bits inverted", most=1.0),
    "drop": FaultKind("wire", MESSAGES, f"{SHARE} that lose 1 to 3 bytes inside", most=1.0),
    "dup": FaultKind("wire", MESSAGES, f"{SHARE} with 1 to 3 bytes repeated", most=1.0),
    "header": FaultKind("wire", MESSAGES, f"{SHARE} with a byte inside replaced by their first", most=1.0),
    "cr": FaultKind("wire", MESSAGES, f"{SHARE} with a byte inside replaced by CR", most=1.0),
    "junk": FaultKind("wire", MESSAGES, f"{SHARE} with 1 to 16 stray bytes before them", most=1.0),
    "lose": FaultKind("wire", READINGS, f"{SHARE} lost whole (sysfs: not readable); all: lose@FROM-TO", 1.0, most=1.0),
    "delay": FaultKind(
        "wire", READINGS, f"{SHARE} delayed by the second value in s (0.1), with all later ones", second=0.1
    ),
    "backlog": FaultKind("wire", MESSAGES, "messages are delayed and arrive together at the end", 1.0, closed=True),
    "frozen": FaultKind("sensor", SENSORS, "axes (gx+gy+gz+ax+ay+az, or all) keep their value", 0.0, axes=True),
    "saturated": FaultKind("sensor", SENSORS, "axes at the end of their range", 0.0, axes=True),
    "zero": FaultKind("sensor", SENSORS, "axes show 0", 0.0, axes=True),
    "bias": FaultKind("sensor", SENSORS, "deg/s on top of each gyro's bias, as after another power-on", needs=True),
    "reset": FaultKind("device", BOTH, "restarts, settings lost", 0.0, needs=True),
    "count": FaultKind("device", (IMU,), "its counter jumps by so many (not seraccel)", needs=True),
    "unplug": FaultKind("plug", (*BOTH, SYSFS, IIO), "the port is removed, and returns at the end", 0.0, closed=True),
    "trigger": FaultKind("buffer", (IIO,), "its trigger is gone, and returns at the end", 0.0, closed=True),
    "overflow": FaultKind("buffer", (IIO,), "the kernel's buffer loses so many scans", needs=True),
    "held": FaultKind("reading", MEASURING, "the reading stays as it is", 0.0),
    "offset": FaultKind("reading", MEASURING, "m/s, Pa, deg, uT of each axis, m north on top: a jump, a door, iron"),
    "scale": FaultKind("reading", MEASURING, "the reading (of a pose: its height) times so much: a slip, wrong units"),
    "clock": FaultKind("reading", (PROGRAM,), "s by which its clock, from which its messages have their time, is late"),
    "untimed": FaultKind("reading", (PROGRAM,), "its messages have no time, and count as of their arrival", 0.0),
    "loss": FaultKind("fixes", (GNSS,), "the receiver reports no fix", 0.0),
    "jump": FaultKind("fixes", (GNSS,), "m beside the truth, towards the second value in deg (0)", second=0.0),
    "ramp": FaultKind("fixes", (GNSS,), "m/s away from the truth, towards the second value in deg (0)", second=0.0),
}


def parse(spec: str, devices: Sequence[str]) -> list[list[Fault]]:
    """The faults of each of `devices`, by name. Raises SpecError."""
    faults: list[list[Fault]] = [[] for _ in devices]
    for group in filter(None, (part.strip() for part in spec.split(";"))):
        target, colon, rest = group.rpartition(":")
        chosen = _chosen(target if colon else None, devices, group)
        for text in rest.split(","):
            fault = _fault(text.strip())
            fits = [i for i in chosen if _can_have(devices[i], fault.name)]
            if not fits:
                raise SpecError(
                    f"{text.strip()!r}: not a fault of {', '.join(devices[i] for i in chosen)}; {_known_faults()}"
                )
            for i in fits:
                faults[i].append(fault)
    return faults


def of_layer(layer: str, faults: Sequence[Fault]) -> list[Fault]:
    """Those of one layer: wire, sensor, device, plug, buffer or fixes."""
    return [fault for fault in faults if KINDS[fault.name].layer == layer]


def help_text() -> str:
    """How a SPEC is written, and all faults, a line each."""
    rows = "\n".join(f"  {name:10} {kind.meaning}" for name, kind in KINDS.items())
    return f"""--faults "[DEVICE:]FAULT,FAULT…;[DEVICE:]FAULT…"
  DEVICE     {IMU}, {GNSS}, {OTHER}, or a name such as g350; without: each that can have the fault
  FAULT      NAME[=VALUE[xVALUE2]][@FROM[-[TO]][/PERIOD]], times in s since the start; without: always
  example    "{EXAMPLE}"

faults:
{rows}"""


def _role(device: str) -> str:
    return next((role for role, devices in ROLES.items() if device in devices), IMU)


def _can_have(device: str, name: str) -> bool:
    return _role(device) in KINDS[name].of and (device, name) != ("seraccel", "count")


def _chosen(target: str | None, devices: Sequence[str], group: str) -> list[int]:
    also = {IIO: IMU, SYSFS: OTHER, PROGRAM: OTHER}
    chosen = [i for i, one in enumerate(devices) if target in (None, one, _role(one), also.get(_role(one), _role(one)))]
    if not chosen:
        raise SpecError(
            f"{group!r}: no device {target!r} here; there are {', '.join(devices)}, or {IMU}, {GNSS}, {OTHER}"
        )
    return chosen


def _known_faults() -> str:
    return f"there are {', '.join(KINDS)}"


def _fault(text: str) -> Fault:
    parts = _FAULT.fullmatch(text)
    if not parts or parts["name"] not in KINDS:
        raise SpecError(f"{text!r}: no fault of that name; {_known_faults()}")
    name, kind = parts["name"], KINDS[parts["name"]]
    span = _span(parts["span"], kind, text)
    if kind.axes:
        return Fault(name, 0.0, 0.0, _axes(parts["value"], text), span)
    value, _, second = (parts["value"] or "").partition("x")
    if second and kind.second is None:
        raise SpecError(f"{text!r}: {name} has one value: {kind.meaning}")
    first = _number(value, kind.default, text, f"{name} needs a value: {kind.meaning}")
    if math.isfinite(kind.most) and not 0.0 <= first <= kind.most:
        raise SpecError(f"{text!r}: {kind.meaning}: 0 to {kind.most:g}")
    return Fault(name, first, _number(second, kind.second or 0.0, text, ""), (), span)


def _number(text: str, default: float | None, where: str, otherwise: str) -> float:
    if not text:
        if default is None:
            raise SpecError(f"{where!r}: {otherwise}")
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SpecError(f"{where!r}: {text!r} is no number")
    return value


def _axes(text: str | None, where: str) -> tuple[int, ...]:
    names = AXES if text in (None, "", "all") else tuple(str(text).split("+"))
    wrong = [name for name in names if name not in AXES]
    if wrong:
        raise SpecError(f"{where!r}: no axis {wrong[0]!r}; there are {'+'.join(AXES)}, or all")
    return tuple(AXES.index(name) for name in names)


def _span(text: str | None, kind: FaultKind, where: str) -> Span:
    if text is None:
        if kind.needs or kind.closed:
            raise SpecError(f"{where!r}: when? write @FROM{'-TO' if kind.closed else ''}, in s since the start")
        return Span()
    parts = _SPAN.fullmatch(text)
    if not parts:
        raise SpecError(f"{where!r}: {text!r} is no time; write @FROM, @FROM-TO or @FROM-TO/PERIOD, in s")
    begin, end, period = (_number(parts[name] or "", math.inf, where, "") for name in ("begin", "end", "period"))
    if end <= begin or (math.isinf(end) and kind.closed) or period < (end if math.isfinite(end) else begin) - begin:
        raise SpecError(f"{where!r}: FROM must lie before TO, and PERIOD be no shorter than the time between")
    if period <= 0.0 or (math.isfinite(period) and math.isinf(end) and not kind.needs):
        raise SpecError(f"{where!r}: what repeats needs an end: @FROM-TO/PERIOD")
    return Span(begin, end, period)
