"""A running daemon as other programs' servers need it: its states, paced, its receiver's fixes, and its status.

The states are those of the binary stream, fixes and status come from the gpsd socket. The daemon may come and go.
"""

import argparse
import contextlib
import json
import math
import select
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from typing import Any, Protocol

import numpy as np

from .. import client
from ..estimators.records import FIX, SOLUTION
from ..outputs.addresses import PORT, Address
from .arguments import address_of

_RETRY_S = 1.0
_DIVISOR_MAX = 2**32 - 1  # what the stream's request has room for
_FIX_HZ = 20.0  # receivers are slower
_RATE_STATES = 50  # from which the sensor's rate follows
_NOT_IMUD = "it does not speak imud's protocol"
_NOT_CONVERTIBLE = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, struct.error)
_LINE_MAX = 1 << 20  # bytes
_RECEIVE_BYTES = 1 << 16


class Listener(Protocol):
    """What is done with the data. Times are Unix time, ns."""

    def on_solution(self, solution: np.void, unix_ns: int) -> None:
        """A row of SOLUTION."""

    def on_fix(self, fix: np.void, unix_ns: int, utc_ns: int | None) -> None:
        """A row of FIX; utc_ns: the same instant by the receiver's clock; None: not known."""

    def on_status(self, status: Mapping[str, Any], unix_ns: int) -> None:
        """The flat table of `imud status --json`, each second."""


def solution_of(state: client.State) -> np.void:
    """A row of SOLUTION."""
    row: np.void = np.array([tuple(state[2:])], SOLUTION)[0]
    return row


def fix_of(message: Mapping[str, Any]) -> np.void:
    """A row of FIX, of the gpsd socket's class FIX. Raises KeyError, TypeError, ValueError."""

    def numbers(*names: str) -> list[float]:
        return [float(message.get(name, math.nan)) for name in names]

    row = np.zeros(1, FIX)
    row["t_ns"], row["arrival_ns"] = message["t_mono_ns"], message["arrival_mono_ns"]
    row["lat"], row["lon"], row["course"] = map(math.radians, numbers("lat_deg", "lon_deg", "course_deg"))
    row["height"], row["hdop"], row["speed"] = numbers("height_m", "hdop", "speed_mps")
    row["sigma"] = numbers("sn_m", "se_m", "sd_m")
    row["v"] = numbers("vn_mps", "ve_mps", "vd_mps")
    row["sigma_v"] = numbers("svn_mps", "sve_mps", "svd_mps")
    row["quality"], row["satellites"] = message["quality"], message["uSat"]
    fix: np.void = row[0]
    return fix


@contextlib.contextmanager
def _converted(what: str) -> Iterator[None]:
    """Raises ConnectionError if the listener cannot convert it, as that of another version or with impossible times."""
    try:
        yield
    except _NOT_CONVERTIBLE as error:
        raise ConnectionError(f"it sends a {what} that this version of imud cannot convert ({error!r})") from error


class Decimator:
    """Lets one state of each period pass, and asks the daemon for no more states than that needs."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._slot = -1
        self._first: client.State | None = None
        self._asked = False

    def accepts(self, state: client.State) -> bool:
        slot = int(state.t_ns * 1e-9 * self._rate_hz)
        is_new, self._slot = slot != self._slot, slot
        return is_new

    def divisor(self, state: client.State) -> int | None:
        """Once, after the first states: the divisor to ask for."""
        if self._first is None:
            self._first = state
        elif not self._asked and (states := state.seq - self._first.seq) >= _RATE_STATES:
            self._asked = True
            sensor_hz = states * 1e9 / max(state.t_ns - self._first.t_ns, 1)
            return min(max(1, int(sensor_hz / self._rate_hz)), _DIVISOR_MAX)
        return None


class _States:
    """The stream."""

    def __init__(self, path: str, rate_hz: float, listener: Listener) -> None:
        self._path, self._rate_hz, self._listener = path, rate_hz, listener
        self._stream: client.Stream | None = None
        self._decimator = Decimator(rate_hz)
        self.offset_ns = time.time_ns() - time.monotonic_ns()

    def connect(self) -> int:
        self._decimator = Decimator(self._rate_hz)
        self._stream = client.connect(self._path, timeout_s=_RETRY_S)
        return self._stream.fileno()

    def read(self) -> None:
        """Raises OSError at the daemon's end."""
        assert self._stream is not None
        try:
            state = next(self._stream)
        except TimeoutError:
            return
        except StopIteration:
            raise ConnectionError("the daemon ended the connection") from None
        except client.ProtocolError as error:
            raise ConnectionError(str(error)) from error
        self.take(state)
        if (divisor := self._decimator.divisor(state)) is not None:
            self._stream.set_divisor(divisor)

    def take(self, state: client.State) -> None:
        """Raises ConnectionError for one that cannot be converted."""
        self.offset_ns = state.utc_offset_ns
        if self._decimator.accepts(state):
            with _converted("state"):
                self._listener.on_solution(solution_of(state), state.t_ns + state.utc_offset_ns)

    def tick(self) -> None:
        """Once a second."""

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()


class _Fixes:
    """The gpsd socket."""

    def __init__(self, address: Address, states: _States, listener: Listener) -> None:
        self._address, self._states, self._listener = address, states, listener
        self._socket: socket.socket | None = None
        self._received = b""
        self._t_ns: int | None = None  # of the newest fix

    def connect(self) -> int:
        self._socket, self._received = socket.socket(self._address.family), b""
        self._socket.settimeout(_RETRY_S)
        self._socket.connect(self._address.where)
        watch = json.dumps({"enable": True, "json": True, "class": "FIX", "rate": _FIX_HZ})
        self._socket.sendall(f"?WATCH={watch}\n".encode())
        return self._socket.fileno()

    def read(self) -> None:
        """Raises OSError at the daemon's end."""
        assert self._socket is not None
        data = self._socket.recv(_RECEIVE_BYTES)
        if not data:
            raise ConnectionError("the daemon ended the connection")
        *lines, self._received = (self._received + data).split(b"\n")
        if len(self._received) > _LINE_MAX:
            raise ConnectionError(_NOT_IMUD)
        for line in lines:
            self.take(line)

    def take(self, line: bytes) -> None:
        """Raises ConnectionError for what is not imud's."""
        try:
            message = json.loads(line)
            kind, t_ns = message.get("class"), message.get("t_mono_ns", self._t_ns)
            fix = fix_of(message) if kind == "FIX" and t_ns != self._t_ns else None
            utc_ns = round(datetime.fromisoformat(message["time"]).timestamp() * 1e9) if "time" in message else None
        except (ValueError, TypeError, AttributeError, KeyError, OverflowError, RecursionError):
            raise ConnectionError(_NOT_IMUD) from None
        with _converted(kind):
            if kind == "STATUS":
                self._listener.on_status(message, time.time_ns())
            elif fix is not None:
                self._t_ns = t_ns
                self._listener.on_fix(fix, t_ns + self._states.offset_ns, utc_ns)

    def tick(self) -> None:
        """Once a second."""
        if self._socket is not None:
            self._socket.sendall(b"?STATUS;\n")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


class _Source:
    """A connection that is made again after each failure, which is printed when it is another than before."""

    def __init__(self, command: str, what: str, connection: _States | _Fixes, poller: select.poll) -> None:
        self._command, self._what, self._connection, self._poller = command, what, connection, poller
        self.fd = -1
        self._printed = ""

    def guard(self, act: Callable[[], object]) -> None:
        """Run it; a failure ends the connection."""
        try:
            act()
        except OSError as error:
            self.close()
            self._tell(f"{self._what}: {(error.strerror or str(error)).lower()}; trying again")

    def connect(self) -> None:
        def connected() -> None:
            fd = self._connection.connect()
            self._poller.register(fd, select.POLLIN)
            self.fd = fd
            self._tell(f"{self._what}: connected")

        self.guard(connected)

    def _tell(self, text: str) -> None:
        if text != self._printed:
            print(f"imud {self._command}: {text}", file=sys.stderr, flush=True)
        self._printed = text

    def tick(self) -> None:
        """Once a second."""
        if self.fd < 0:
            self.connect()
        else:
            self.guard(self._connection.tick)

    def read(self) -> None:
        self.guard(self._connection.read)

    def close(self) -> None:
        if self.fd >= 0:
            self._poller.unregister(self.fd)
            self.fd = -1
        self._connection.close()


def follow(command: str, args: argparse.Namespace, rate_hz: float, listener: Listener, wake: int) -> None:
    """Pass the daemon's data on until the descriptor `wake` is readable. args: of `arguments.add_live`.

    Raises UsageError.
    """
    address, poller = address_of("--gpsd", args.gpsd, PORT), select.poll()
    states = _States(args.stream, rate_hz, listener)
    sources = (
        _Source(command, f"the stream {args.stream} (the daemon's stream.listen)", states, poller),
        _Source(command, f"the gpsd socket {address.text}", _Fixes(address, states, listener), poller),
    )
    poller.register(wake, select.POLLIN)
    due_s = 0.0
    try:
        while True:
            if (now_s := time.monotonic()) >= due_s:
                due_s = now_s + _RETRY_S
                for source in sources:
                    source.tick()
            ready = [fd for fd, _ in poller.poll(max(0.0, due_s - time.monotonic()) * 1e3)]
            if wake in ready:
                return
            for source in sources:
                if source.fd in ready:
                    source.read()
    finally:
        for source in sources:
            source.close()
