"""Linux's Industrial I/O as a port: `iio:NAME`, one device or the two parts of a chip. Reading never blocks.

A dialogue sends lines of text, which are carried out in sysfs; each is answered with a line of JSON:

    list                        the attributes of the devices and triggers
    set FOLDER/ATTRIBUTE VALUE  an error in words, empty: none
    stream LAYOUT               nothing; from then on the scans are what is received

A scan is preceded by one byte, the number of its device. Those of the second device are put between those of the first
by their time stamps: a scan of the first comes once one of the second is as late. When the kernel stamps scans with
CLOCK_MONOTONIC, that stamp of the last scan of the first device is the time of a reading; so a late wake-up does no
harm.

Sources: Documentation/iio/iio_devbuf.rst of the kernel; industrialio-buffer.c: a read takes whole scans, ENODEV after
the device is gone, EBUSY when another process has it.
"""

import contextlib
import json
import os
import select
import sys
import time
from collections import deque
from collections.abc import Mapping

from ..errors import NotSerialError, PortAbsentError, PortBusyError, PortDeniedError, PortLostError
from . import iio_sysfs as sysfs
from .portspec import PortSpec
from .reasons import ABSENT, BUSY, DENIED, reason
from .timer import timer_and_epoll

CHUNK = 65536
STAMP_BYTES = 8
WAITING_MAX = 4096  # scans of one device without any of the other


class _Buffer:
    """The scans of one device. Raises OSError."""

    def __init__(self, folder: str, number: int) -> None:
        self.folder = folder
        self.fd = os.open(sysfs.node(folder), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        self.enabled = False  # by us
        self.newest_ns = -1  # stamp of the newest scan
        self.waiting: deque[tuple[int, bytes]] = deque()  # stamps and scans, numbered
        self._number, self._rest = bytes([number]), b""
        self._size, self._stamp_at = 0, -1

    def lay_out(self, size: int, stamp_at: int) -> None:
        """size: bytes of a scan; stamp_at: where its stamp is, -1: it has none."""
        self._size, self._stamp_at = size, stamp_at

    def read(self) -> None:
        """Take what is there."""
        try:
            received = os.read(self.fd, CHUNK // self._size * self._size)
        except BlockingIOError:
            return
        if not received:
            raise OSError("it has ended")
        data = self._rest + received
        whole = len(data) - len(data) % self._size
        self._rest = data[whole:]
        for at in range(0, whole, self._size):
            scan = data[at : at + self._size]
            if self._stamp_at >= 0:
                stamp = scan[self._stamp_at : self._stamp_at + STAMP_BYTES]
                self.newest_ns = int.from_bytes(stamp, sys.byteorder, signed=True)
            self.waiting.append((self.newest_ns, self._number + scan))

    def close(self) -> None:
        if self.enabled:
            sysfs.write(f"{self.folder}/buffer/enable", "0")
        os.close(self.fd)


class IioPort:
    """The open devices. Not thread-safe. Raises the errors of `imud.drivers.errors`."""

    warning, plain = "", False

    def __init__(self, spec: PortSpec) -> None:
        assert spec.iio is not None
        self.path = spec.path
        self._folders = sysfs.find(spec.path, spec.iio)
        self._buffers: list[_Buffer] = []
        with contextlib.ExitStack() as opened:
            for number, folder in enumerate(self._folders):
                try:
                    self._buffers.append(_Buffer(folder, number))
                except OSError as error:
                    raise _refusal(self.path, folder, error) from error
                opened.callback(self._buffers[-1].close)
            self._timer, self._epoll = timer_and_epoll(self.path)
            opened.pop_all()
        self.fd: int = self._epoll.fileno()  # readable when an answer, or scans, are there
        self._answers = bytearray()
        self._streaming = self._monotonic = False
        self._ready: deque[tuple[int, bytes]] = deque()  # stamps and scans in their order
        self._delivered_ns = -1  # stamp of the second device's newest among them
        self._unmatched = 0

    @property
    def counters(self) -> Mapping[str, int]:
        """unmatched: scans of one device that were thrown away, because the other one sent none."""
        return {"unmatched": self._unmatched} if len(self._buffers) > 1 else {}

    def set_baud(self, baud: int) -> None:
        """See `DialoguePort`: there is no speed."""

    def discard(self) -> None:
        """Discard answers, and scans that wait here."""
        self._answers.clear()
        self._ready.clear()
        self._timer.clear()

    def write(self, data: bytes) -> int:
        """Carry out the lines of a dialogue."""
        for line in data.decode().splitlines():
            command, _, rest = line.partition(" ")
            if command == "list":
                self._answer({"devices": {f: sysfs.attributes(f) for f in self._folders}, "triggers": sysfs.triggers()})
            elif command == "set":
                self._answer(self._set(*rest.split(" ", 1)))
            else:
                self._stream(json.loads(rest))
        return len(data)

    def _set(self, name: str, value: str) -> str:
        for buffer in self._buffers:
            if name == f"{buffer.folder}/buffer/enable":
                buffer.enabled = value == "1"
        return sysfs.write(name, value)

    def _answer(self, value: object) -> None:
        self._answers += json.dumps(value).encode() + b"\n"
        self._timer.set(1)

    def _stream(self, layout: Mapping[str, list[int]]) -> None:
        self._monotonic = bool(layout["monotonic"])
        for buffer, size, stamp_at in zip(self._buffers, layout["sizes"], layout["stamps"], strict=True):
            buffer.lay_out(size, stamp_at)
            if not self._streaming:
                self._epoll.register(buffer.fd, select.EPOLLIN)
        self._streaming = True

    def read(self) -> bytes:
        """Answers, or scans."""
        if self._answers:
            answers = bytes(self._answers)
            self.discard()
            return answers
        buffer = memoryview(bytearray(CHUNK))
        size, _ = self.receive(buffer, time.monotonic_ns())
        return bytes(buffer[:size])

    def receive(self, buffer: memoryview, now_ns: int) -> tuple[int, int]:
        """The scans that came, and when the last of them was taken; the time of reading if the kernel does not say."""
        self._timer.clear()
        if not self._streaming:
            return 0, now_ns
        for each in self._buffers:
            try:
                each.read()
            except OSError as error:
                raise PortLostError(
                    self.path, f"the kernel delivers no more of {each.folder}: {reason(error)}: was it removed?"
                ) from error
        self._order()
        filled, taken_ns = 0, -1
        while self._ready and filled + len(self._ready[0][1]) <= len(buffer):
            stamp_ns, scan = self._ready.popleft()
            buffer[filled : filled + len(scan)] = scan
            filled += len(scan)
            taken_ns = stamp_ns if scan[0] == 0 else taken_ns
        if self._ready:
            self._timer.set(1)
        now_ns = time.monotonic_ns()
        return filled, min(taken_ns, now_ns) if self._monotonic and taken_ns >= 0 else now_ns

    def _order(self) -> None:
        """Move to `_ready` what may be delivered."""
        first, *others = self._buffers
        if not others:
            self._ready.extend(first.waiting)
            first.waiting.clear()
            return
        second = others[0]
        while first.waiting and first.waiting[0][0] <= second.newest_ns:
            while second.waiting and self._delivered_ns < first.waiting[0][0]:
                self._delivered_ns = second.waiting[0][0]
                self._ready.append(second.waiting.popleft())
            self._ready.append(first.waiting.popleft())
        for waiting in (first.waiting, second.waiting):
            while len(waiting) > WAITING_MAX:
                waiting.popleft()
                self._unmatched += 1

    def close(self) -> None:
        """Stop the buffers that this port started, and close. May be called twice."""
        if self._epoll.closed:
            return
        self._epoll.close()
        self._timer.close()
        for buffer in self._buffers:
            with contextlib.suppress(OSError):
                buffer.close()


def _refusal(path: str, folder: str, error: OSError) -> Exception:
    node = sysfs.node(folder)
    if error.errno in ABSENT:
        return PortAbsentError(path, f"{node} is not there, although sysfs has the device: is udev running?")
    if error.errno in DENIED:
        return PortDeniedError(path, f"no permission to open {node}: `imud doctor` prints a udev rule for it")
    if error.errno in BUSY:
        return PortBusyError(path, f"{node} is in use by another program (iiod, iio-sensor-proxy): stop it first")
    return NotSerialError(path, f"{node} cannot be used: {reason(error)}")
