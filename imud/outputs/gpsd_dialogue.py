"""gpsd's requests and the messages that answer them: the protocol, not the connection.

A request ends at `;`, LF or CR; text that does not begin with `?` is ignored, except a request of HTTP, which any web
page can have a browser send across sites: a client that sends one is disconnected before anything after it is read. No
bytes raise an error: an invalid request is answered with ERROR. The protocol is gpsd's, with two more keys in ?WATCH,
both optional: `rate` (Hz) and `class` (names separated by commas) select the rate and the classes of messages. What a
client of `raw` gets (gpsmon, gpspipe -R) are the estimates as NMEA: of a receiver they are the bytes that it sends.
"""

import functools
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec

from .. import __version__
from ..configuration.fields import MESSAGE_RATE_HZ, number
from .gpsd_json import CLASSES, DEFAULT_CLASSES, Report
from .gpsd_objects import iso, quoted
from .view import Device

REQUEST_MAX = 1024  # bytes; gpsd's own limit is 80
_DEVICES_MAX = 4  # libgps loops for ever over a longer list
_ERROR_MAX = 255
_RAW_MAX = 2  # of ?WATCH: 1 differs from it only for binary data, which there is none of
_INT_MAX = 2**31 - 1  # a number of gpsd's clients
NOT_HTTP = "this port does not speak HTTP"


@dataclass(frozen=True, slots=True)
class Request:
    """`?COMMAND` or `?COMMAND=ARGUMENT`. text: the whole as printable ASCII."""

    command: str
    argument: bytes | None
    text: str


class ReceiveBuffer:
    """Splits received bytes into requests; buffers an incomplete request."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.has_other_text = False  # the client has sent text that is no request
        self.is_http = False  # a browser sends HTTP; no further request is parsed

    def feed(self, data: bytes) -> None:
        self._bytes += data

    @property
    def too_long(self) -> bool:
        """True when a request is longer than REQUEST_MAX: the sender is no gpsd client."""
        return len(self._bytes) > REQUEST_MAX and _END.search(self._bytes, 0, REQUEST_MAX + 1) is None

    def next_request(self) -> Request | None:
        """The next complete request, if there is one."""
        while not self.is_http and (end := _END.search(self._bytes)):
            text = bytes(self._bytes[: end.start()]).strip()
            del self._bytes[: end.end()]
            if text.startswith(b"?"):
                command, equals, argument = text[1:].partition(b"=")
                return Request(command.decode("latin-1"), argument if equals else None, _printable(text))
            self.has_other_text |= bool(text)
            self.is_http = _HTTP.match(text) is not None
        return None


_END = re.compile(rb"[;\r\n]")
_HTTP = re.compile(rb"(GET|HEAD|POST|PUT|DELETE|CONNECT|OPTIONS|TRACE|PATCH|PRI)([ \t]|\Z)|.*[ \t]HTTP/", re.IGNORECASE)


def _printable(text: bytes) -> str:
    return re.sub(r"[^ -~]", "?", text.decode("latin-1"))


class _WatchArgument(msgspec.Struct):
    """The keys of ?WATCH's argument; other keys are ignored. None: leave it as it is."""

    enable: bool = True
    json: bool | None = None
    nmea: bool | None = None
    raw: bool | Annotated[int, number(0, _INT_MAX, "")] | None = None  # some programs write true
    device: str | None = None
    rate: Annotated[float, number(*MESSAGE_RATE_HZ, "Hz")] | None = None
    classes: str | None = msgspec.field(name="class", default=None)


class _DeviceArgument(msgspec.Struct):
    path: str | None = None


_watch_argument = msgspec.json.Decoder(_WatchArgument, strict=False)
_device_argument = msgspec.json.Decoder(_DeviceArgument)


class RequestError(Exception):
    """A request that is answered with ERROR; the message is its text."""


@dataclass(frozen=True, slots=True)
class Policy:
    """What one client watches."""

    rate_hz: float
    enable: bool = False
    json: bool = False
    nmea: bool = False
    raw: int = 0
    device: str | None = None
    classes: tuple[str, ...] = DEFAULT_CLASSES

    @property
    def streaming(self) -> bool:
        return self.enable and (self.json or self.sends_nmea)

    @property
    def sends_nmea(self) -> bool:
        return self.nmea or self.raw > 0

    def updated(self, argument: bytes) -> "Policy":
        """This policy after ?WATCH=argument. Raises RequestError."""
        try:
            given = _watch_argument.decode(argument)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise RequestError(f"Invalid WATCH: {error}") from None
        return replace(
            self,
            enable=given.enable,
            json=self.json if given.json is None else given.json,
            nmea=self.nmea if given.nmea is None else given.nmea,
            raw=self.raw if given.raw is None else min(int(given.raw), _RAW_MAX),
            device=self.device if given.device is None else given.device,
            rate_hz=given.rate or self.rate_hz,
            classes=self.classes if given.classes is None else _selected_classes(given.classes),
        )


def _selected_classes(names: str) -> tuple[str, ...]:
    """The classes of a comma-separated list; `WATCH`, the request's own class, chooses nothing.

    Raises RequestError.
    """
    wanted = {name.strip().upper() for name in names.split(",")} - {"WATCH", ""}
    if unknown := wanted.difference(CLASSES):
        raise RequestError(f"Invalid WATCH: no class {', '.join(sorted(unknown))}; there are {', '.join(CLASSES)}")
    return tuple(kind for kind in CLASSES if kind in wanted) if wanted else DEFAULT_CLASSES


def _requested_path(argument: bytes | None) -> str | None:
    """The path in ?DEVICE's argument, None when it names none. Raises RequestError."""
    try:
        return _device_argument.decode(argument).path if argument else None
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise RequestError(f"Invalid DEVICE: {error}") from None


@functools.cache
def version_object() -> str:
    """Protocol 3.14, the one that gpsd 3.22 speaks."""
    name = quoted(f"imud-{__version__}", 63)
    return f'{{"class":"VERSION","release":{quoted(__version__, 63)},"rev":{name},"proto_major":3,"proto_minor":14}}'


def error_object(message: str) -> str:
    return f'{{"class":"ERROR","message":{quoted(_printable(message.encode()), _ERROR_MAX)}}}'


def device_object(device: Device, active: bool = True) -> str:
    """One DEVICE; without `activated` clients consider it removed."""
    optional = {"subtype": device.model, "sernum": device.serial}
    texts = "".join(f',"{key}":{quoted(text, 63)}' for key, text in optional.items() if text)
    activated = f',"activated":{text}' if active and (text := iso(device.activated_s)) else ""
    line = f',"bps":{device.bps},"parity":"N","stopbits":1' if device.bps is not None else ""
    return (
        f'{{"class":"DEVICE","path":{quoted(device.path)},"driver":{quoted(device.driver, 63)}{texts}{activated}'
        f',"flags":1,"native":0{line}}}'
    )


def devices_object(devices: Iterable[Device]) -> str:
    return f'{{"class":"DEVICES","devices":[{",".join(map(device_object, list(devices)[:_DEVICES_MAX]))}]}}'


def watch_object(policy: Policy) -> str:
    """The policy as it is: there are no streams of AIS or pulses to watch here."""
    words = {True: "true", False: "false"}
    device = f',"device":{quoted(policy.device)}' if policy.device is not None else ""
    return (
        f'{{"class":"WATCH","enable":{words[policy.enable]},"json":{words[policy.json]},"nmea":{words[policy.nmea]},"raw":{policy.raw}'
        f',"scaled":false,"timing":false,"split24":false,"pps":false{device}'
        f',"rate":{policy.rate_hz:.6g},"classes":"{",".join(policy.classes)}"}}'
    )


@dataclass(frozen=True, slots=True)
class Answer:
    """objects: the messages, in order. policy: what the client watches from now on."""

    objects: tuple[str, ...]
    policy: Policy
    refused: bool = False


def _find(devices: tuple[Device, ...], path: str | None) -> Device:
    for device in devices:
        if path in (None, device.path):
            return device
    raise RequestError("No devices attached" if path is None else f"No such device as {path}")


def _answer_version(_: bytes | None, policy: Policy, report: Report) -> Answer:
    return Answer((version_object(),), policy)


def _answer_devices(_: bytes | None, policy: Policy, report: Report) -> Answer:
    return Answer((devices_object(report.view.devices),), policy)


def _answer_device(argument: bytes | None, policy: Policy, report: Report) -> Answer:
    """The device unchanged: clients do not configure sensors here."""
    return Answer((device_object(_find(report.view.devices, _requested_path(argument))),), policy)


def _answer_watch(argument: bytes | None, policy: Policy, report: Report) -> Answer:
    if argument is not None:
        policy = policy.updated(argument)
        if policy.device is not None:
            _find(report.view.devices, policy.device)
    return Answer((devices_object(report.view.devices), watch_object(policy)), policy)


def _answer_poll(_: bytes | None, policy: Policy, report: Report) -> Answer:
    return Answer((report.poll(policy.enable),), policy)


_ANSWERS: dict[str, Callable[[bytes | None, Policy, Report], Answer]] = {
    "VERSION": _answer_version,
    "DEVICES": _answer_devices,
    "DEVICE": _answer_device,
    "WATCH": _answer_watch,
    "POLL": _answer_poll,
}
_WITH_ARGUMENT = ("DEVICE", "WATCH")


def answer(request: Request, policy: Policy, report: Report) -> Answer:
    """Answer one request of a client with `policy`, out of the newest report."""
    try:
        if request.command not in _ANSWERS or (request.argument is not None and request.command not in _WITH_ARGUMENT):
            raise RequestError(f"Unrecognized request '{request.text}'")
        return _ANSWERS[request.command](request.argument, policy, report)
    except RequestError as error_text:
        return Answer((error_object(str(error_text)),), policy, refused=True)
