"""A running daemon from Python: its states, from its stream or shared memory; and measurements for its filter.

    from imud.client import connect, latest

    with connect("/run/imud/front.stream", divisor=10) as states:   # every tenth
        for state in states:
            print(state.roll, state.pitch, state.sigma_rpy)

    state = latest("/dev/shm/imud-front")

What the filter estimates beside that (biases of the receiver, time offsets, scales, each with its sigma `s…`), as in
states.csv, from the daemon whose `gpsd.listen` is that address:

    filter_states("127.0.0.1:2947")["odometer_scale"]

Measurements for the daemon whose `aiding.listen` is that path, from any program:

    with AidingSender("/run/imud/aiding") as sender:
        sender.send("HDG", heading=123.4, sigma=0.3)   # degrees; of now, or of `t=` in Unix time

Needs nothing but the standard library. `FIELDS` describes the bytes on the wire; the C header (`imud reference c`) is
made from the same table. All numbers are little-endian.
"""

import contextlib
import json
import math
import os
import socket
import struct
import time
from collections.abc import Iterator, Sequence
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any, Final, NamedTuple

MAGIC: Final = b"IMUD"
VERSION: Final = 1
GPSD_ADDRESS: Final = "127.0.0.1:2947"  # the default of `gpsd.listen`
FIELDS: Final = (  # name, what C and `struct` call it, how many, what it is
    ("magic", "char", 4, '"IMUD"'),
    ("version", "uint16_t", 1, "of this layout: 1"),
    ("size", "uint16_t", 1, "bytes of this record"),
    ("seq", "uint64_t", 1, "number of the sample since the daemon's start; a gap is what this client missed"),
    ("utc_offset_ns", "int64_t", 1, "t_ns + utc_offset_ns is Unix time by the machine's clock, right or wrong"),
    ("t_ns", "int64_t", 1, "instant of the state on CLOCK_MONOTONIC"),
    ("status", "int64_t", 1, "bits: see IMUD_*"),
    ("lat", "double", 1, "rad, WGS-84; NaN without IMUD_POSITION_VALID, like lon, height and v"),
    ("lon", "double", 1, "rad"),
    ("height", "double", 1, "m above the ellipsoid; arbitrary without IMUD_HEIGHT_VALID"),
    ("v", "double", 3, "m/s, north east down"),
    ("q_nb", "double", 4, "Hamilton, scalar first, turns body (FRD) into NED vectors"),
    ("w", "double", 3, "rad/s, body, bias removed"),
    ("f", "double", 3, "m/s^2, specific force, body, bias removed"),
    ("bg", "double", 3, "rad/s, gyro bias"),
    ("ba", "double", 3, "m/s^2, accelerometer bias"),
    ("sigma_p", "double", 3, "m, 1 sigma, north east down"),
    ("sigma_v", "double", 3, "m/s"),
    ("sigma_rpy", "double", 3, "rad, of roll, pitch, yaw"),
    ("sigma_bg", "double", 3, "rad/s"),
    ("sigma_ba", "double", 3, "m/s^2"),
)
STATUS: Final = {
    "ATTITUDE_VALID": 1,
    "HEADING_VALID": 2,
    "POSITION_VALID": 4,
    "AT_REST": 8,
    "COASTING": 16,
    "REJECTING": 32,
    "SATURATED": 64,
    "HEIGHT_VALID": 128,
}
_CODES = {"char": "s", "uint16_t": "H", "uint64_t": "Q", "int64_t": "q", "double": "d"}
RECORD: Final = struct.Struct("<" + "".join(f"{count}{_CODES[kind]}" for _, kind, count, _ in FIELDS))
LIVENESS: Final = struct.Struct("<qQ16s")  # heartbeat on CLOCK_MONOTONIC (ns), pid and boot id of the daemon
_SHARED = struct.Struct(f"<Q{RECORD.size // 8}QQqQ16s")  # lock, record, exclusive or of its 64-bit words, LIFE
SHARED_SIZE: Final = _SHARED.size
_STATES, _LONGEST = "states.", 1 << 20  # of an answer: the names of these numbers, and bytes at most
STALE_NS: Final = 2_000_000_000  # a daemon with an older heartbeat does not run, or runs in another time namespace
DIVISOR: Final = struct.Struct("<I")  # what a client may send: one of so many states, from now on
_LOCKED_SINE = 1.0 - 1e-13  # of a pitch at which rounding decides what roll and yaw are
_WRITE_NS, _PAUSE_S = STALE_NS, 1e-3  # while a write is in progress: the daemon may have lost its processor in it

Vector = tuple[float, float, float]


class ProtocolError(Exception):
    """The other side is not imud, or speaks another version of the protocol."""


class StaleError(ProtocolError):
    """The daemon that wrote the shared memory crashed, was killed, is stopped, or has another clock."""


class State(NamedTuple):
    """One solution: SI units, radians, NED, body FRD. See `FIELDS`."""

    seq: int
    utc_offset_ns: int
    t_ns: int
    status: int
    lat: float
    lon: float
    height: float
    v: Vector
    q_nb: tuple[float, float, float, float]
    w: Vector
    f: Vector
    bg: Vector
    ba: Vector
    sigma_p: Vector
    sigma_v: Vector
    sigma_rpy: Vector
    sigma_bg: Vector
    sigma_ba: Vector

    @property
    def utc_s(self) -> float:
        """Unix time of the state, s."""
        return (self.t_ns + self.utc_offset_ns) * 1e-9

    @property
    def roll(self) -> float:
        """rad; 0 with the nose straight up or down, where only roll and yaw together mean something."""
        return euler(self.q_nb)[0]

    @property
    def pitch(self) -> float:
        """rad."""
        return euler(self.q_nb)[1]

    @property
    def yaw(self) -> float:
        """rad, clockwise from north if `heading_valid`, else from where it happened to start."""
        return euler(self.q_nb)[2]

    @property
    def attitude_valid(self) -> bool:
        return bool(self.status & STATUS["ATTITUDE_VALID"])

    @property
    def heading_valid(self) -> bool:
        return bool(self.status & STATUS["HEADING_VALID"])

    @property
    def position_valid(self) -> bool:
        return bool(self.status & STATUS["POSITION_VALID"])

    @property
    def height_valid(self) -> bool:
        return bool(self.status & STATUS["HEIGHT_VALID"])


def euler(q_nb: Sequence[float]) -> Vector:
    """Roll, pitch, yaw in rad, ZYX; with the nose straight up or down roll is 0."""
    w, x, y, z = q_nb
    sine = 2.0 * (w * y - x * z)
    if abs(sine) > _LOCKED_SINE:
        pitch = math.asin(max(-1.0, min(1.0, sine)))
        return 0.0, pitch, math.remainder(2.0 * math.atan2(z, w), 2.0 * math.pi)
    roll = math.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    yaw = math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    return roll, math.asin(sine), yaw


def decode(record: bytes) -> State:
    """The state in one record. Raises ProtocolError."""
    if len(record) != RECORD.size or record[:4] != MAGIC:
        raise ProtocolError(f"{len(record)} bytes starting with {record[:4]!r} are no state of imud")
    numbers = RECORD.unpack(record)
    if numbers[1] != VERSION:
        raise ProtocolError(f"the daemon speaks version {numbers[1]}, this client {VERSION}: install the same imud")
    return State(*numbers[3:10], *(numbers[i:j] for i, j in _VECTORS))


def _vectors() -> Iterator[tuple[int, int]]:
    at = 0
    for _, kind, count, _ in FIELDS:
        size = 1 if kind == "char" else count
        if size > 1:
            yield at, at + size
        at += size


_VECTORS = tuple(_vectors())


class Stream:
    """An iterator over states; ends when the daemon does. Not thread-safe."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._divisor = 1

    def set_divisor(self, divisor: int) -> None:
        """From now on one of `divisor` states: those whose `seq` it divides. Raises OSError, ValueError."""
        if not 0 < divisor < 1 << 32:
            raise ValueError(f"divisor = {divisor}: it must be from 1 to {(1 << 32) - 1}")
        self._socket.send(DIVISOR.pack(divisor))
        self._divisor = divisor

    def fileno(self) -> int:
        """For select and poll."""
        return self._socket.fileno()

    def __iter__(self) -> Iterator[State]:
        return self

    def __next__(self) -> State:
        """The next state. Raises StopIteration at the daemon's end, TimeoutError and ProtocolError."""
        with contextlib.suppress(ConnectionResetError):  # it ended before it had read the divisor
            while record := self._socket.recv(2 * RECORD.size):
                state = decode(record)
                if state.seq % self._divisor == 0:  # others were sent before the daemon knew
                    return state
        raise StopIteration

    def __enter__(self) -> "Stream":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()


def connect(path: str | Path, divisor: int = 1, timeout_s: float | None = None) -> Stream:
    """The states of the daemon whose `stream.listen` is `path`, one of `divisor`. Raises OSError, ValueError."""
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        sock.connect(str(path))
        sock.settimeout(timeout_s)
        stream = Stream(sock)
        if divisor != 1:
            stream.set_divisor(divisor)
    except OSError as error:
        sock.close()
        error.filename = str(path)  # which a socket's errors lack
        raise
    except BaseException:
        sock.close()
        raise
    return stream


def boot_id() -> bytes:
    """16 bytes that differ from one boot of this machine to the next."""
    return bytes.fromhex(Path("/proc/sys/kernel/random/boot_id").read_text().replace("-", ""))


class Shared:
    """The newest state of the daemon whose `shared_memory.path` is `path`, also of the next one. Raises OSError."""

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._file = self._path.open("rb", buffering=0)
        self._boot_id = boot_id()

    def read(self) -> State | None:
        """The newest state; None before the first and after the daemon's end. Raises StaleError, ProtocolError.

        Threads may read at once.
        """
        try:
            state = self._read()
        except ProtocolError:
            if not self._reopen():
                raise
            return self._read()
        return self._read() if state is None and self._reopen() else state

    def _reopen(self) -> bool:
        """Open the file that is at the path now, if it is another one: the old one was removed. The number stays."""
        try:
            if os.path.samestat(self._path.stat(), os.fstat(self._file.fileno())):
                return False
            with self._path.open("rb", buffering=0) as new:
                os.dup2(new.fileno(), self._file.fileno(), inheritable=False)
        except OSError:  # there is none yet
            return False
        return True

    def _read(self) -> State | None:
        """The state in the file that is open.

        The age of the state follows from its `t_ns`: the daemon may live while its sensor is silent. A lock that is
        odd, or changes meanwhile, is a write in progress. The check word makes this right on machines that reorder
        reads, which Python cannot forbid. The file is read, not mapped: to truncate it costs its reader nothing.
        """
        began_ns = time.monotonic_ns()
        pause_s = 0.0
        while time.monotonic_ns() - began_ns < _WRITE_NS:
            memory = os.pread(self._file.fileno(), SHARED_SIZE, 0)
            if len(memory) != SHARED_SIZE:
                raise ProtocolError(f"{self._file.name} has {len(memory)} bytes instead of {SHARED_SIZE}")
            lock, *words, check, heartbeat_ns, pid, boot = _SHARED.unpack(memory)
            if lock == 0:
                return None
            if lock % 2 == 0 and os.pread(self._file.fileno(), 8, 0) == memory[:8] and reduce(xor, words) == check:
                self._check_liveness(heartbeat_ns, pid, boot)
                return decode(memory[8 : 8 + RECORD.size])
            time.sleep(pause_s)
            pause_s = _PAUSE_S
        raise ProtocolError("the daemon ended in the middle of a write")

    def _check_liveness(self, heartbeat_ns: int, pid: int, boot: bytes) -> None:
        age_ns = time.monotonic_ns() - heartbeat_ns
        if boot != self._boot_id:
            raise StaleError(f"the daemon (pid {pid}) ran before this machine was started anew")
        if age_ns <= -STALE_NS:
            ahead = f"the clock of the daemon (pid {pid}) is {age_ns * -1e-9:.1f} s ahead of ours"
            raise StaleError(f"{ahead}: it runs in another time namespace, and its times mean nothing here")
        if age_ns >= STALE_NS:
            stopped = f"the daemon (pid {pid}) does not run, or runs in another time namespace"
            raise StaleError(f"{stopped}: its last heartbeat is {age_ns * 1e-9:.1f} s old")

    def close(self) -> None:
        self._file.close()


def latest(path: str | Path) -> State | None:
    """The newest state in shared memory; None before the first. For many reads keep a `Shared`. Raises OSError."""
    shared = Shared(path)
    try:
        return shared.read()
    finally:
        shared.close()


def filter_states(address: str | Path = GPSD_ADDRESS, timeout_s: float = 5.0) -> dict[str, float]:
    """What the daemon's filter estimates beside its solution now, by the columns of states.csv; empty: nothing.

    Raises OSError, ValueError for what is no address, ProtocolError.
    """
    where, family = _address(address)
    end_s = time.monotonic() + timeout_s
    with socket.socket(family, socket.SOCK_STREAM) as sock:
        sock.settimeout(timeout_s)
        sock.connect(where)
        sock.sendall(b"?STATUS;\n")
        rest = b""
        while len(rest) < _LONGEST and (left_s := end_s - time.monotonic()) > 0.0:
            sock.settimeout(left_s)
            if not (data := sock.recv(1 << 16)):
                break
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                if (found := _states_in(line)) is not None:
                    return found
    raise ProtocolError(f"{address} does not answer as imud")


def _states_in(line: bytes) -> dict[str, float] | None:
    """The states in a line; None: it is another message. Raises ProtocolError if it is none."""
    try:
        message = json.loads(line)
        if message["class"] != "STATUS":
            return None
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ProtocolError(f"{line[:60]!r} is no message of imud") from error
    found = {name[len(_STATES) :]: message[name] for name in message if name.startswith(_STATES)}
    return {name: value for name, value in found.items() if isinstance(value, int | float)}


def _address(address: str | Path) -> tuple[str | tuple[Any, ...], socket.AddressFamily]:
    """Where to send or connect; waits for the name server if a host has a name.

    Raises ValueError for what is no address, OSError for a host that there is not.
    """
    text = str(address).removeprefix("unix:")
    host, colon, port = text.rpartition(":")
    if "/" in text:
        return text, socket.AF_UNIX
    if colon and port.isdecimal() and int(port) < 1 << 16:
        found = socket.getaddrinfo(host.strip("[]") or None, int(port), type=socket.SOCK_STREAM)
        found.sort(key=lambda entry: entry[0] != socket.AF_INET)  # as the daemon, where `localhost` is 127.0.0.1
        return found[0][4], found[0][0]
    raise ValueError(f"{text!r} is no address: it must be /path or HOST:PORT")


class AidingSender:
    """Sends measurements to the daemon whose `aiding.listen` is `address`: /PATH or HOST:PORT. Sending never waits."""

    def __init__(self, address: str | Path) -> None:
        """Looks a host's name up, once. The daemon need not run yet.

        Raises ValueError for what is no address, OSError for a host that there is not.
        """
        self._where, family = _address(address)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, message: str, **values: float) -> bool:
        """Send one measurement: its class (`HDG`, …) and its numbers; t: its epoch, Unix s. False: nobody took it.

        There is no answer: what the daemon cannot use is in `imud status` and in its log.
        """
        try:
            self._socket.sendto(json.dumps({"class": message, **values}).encode(), self._where)
        except OSError:  # no daemon, or one that is behind; it may be back for the next one
            return False
        return True

    def __enter__(self) -> "AidingSender":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()
