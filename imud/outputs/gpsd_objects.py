"""The text of gpsd's JSON objects: finite numbers, strings, times, the members that all objects begin with.

A number that is not finite is never printed: its key is left out.
"""

import functools
import json
import math
import time

from .view import View


class Numbers:
    """The members `,"key":number` of an object in a fixed order, without those that are not finite."""

    def __init__(self, **formats: str) -> None:
        self._members = tuple(f',"{key}":{form}' for key, form in formats.items())
        self._template = "".join(self._members)

    def __call__(self, *values: float) -> str:
        text = self._template % values
        if ":nan" not in text and "inf" not in text:
            return text
        return "".join(m % v for m, v in zip(self._members, values, strict=True) if math.isfinite(v))


def quoted(text: str, limit: int = 127) -> str:
    """A JSON string of at most `limit` ASCII characters: libgps loops for ever over longer paths."""
    return json.dumps(text[:limit].encode("ascii", "replace").decode())


@functools.lru_cache(maxsize=4)
def _iso_second(second: int) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(second))


def iso(utc_s: float | None) -> str:
    """Quoted ISO 8601 with microseconds of unix time; empty when unknown or outside the years 1970 to 9999."""
    if utc_s is None or not 0.0 <= utc_s < 253402300799.0:
        return ""
    second, micro = divmod(round(utc_s * 1e6), 1_000_000)
    return f'"{_iso_second(second)}.{micro:06d}Z"'


@functools.lru_cache(maxsize=16)
def _class_and_device(kind: str, path: str | None) -> str:
    device = "" if path is None else f',"device":{quoted(path)}'
    return f'{{"class":"{kind}"{device}'


def head(kind: str, view: View) -> str:
    """Class and device, with which each message begins."""
    return _class_and_device(kind, view.devices[0].path if view.devices else None)


def time_of(view: View) -> str:
    """The member; empty while UTC is not known."""
    text = iso(view.utc_s)
    return f',"time":{text}' if text else ""


def line(*objects: str) -> bytes:
    """Objects as bytes with CR LF: py-gps waits for ever for a message that ends in LF alone."""
    return "".join(f"{text}\r\n" for text in objects).encode("ascii")
