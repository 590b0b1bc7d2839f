"""Barometers and magnetometers of the kernel as aiding sources. A thread reads them, as a reading blocks."""

import contextlib
import json
import math
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator

from imud.drivers.errors import PortError
from imud.drivers.transport.iio_polled import BAROMETER, PolledSensor, find_polled
from imud.drivers.transport.reasons import reason

from .aiding_socket import LONGEST, Poller

_AT_ONCE = 32
_FAILING_S = 1.0  # a sensor of which no reading has succeeded for so long is taken for absent
_RETRY_S = 2.0  # until an absent sensor is looked for again


class IioReader:
    """Gives readings as the datagrams that another program would send. `close` ends the thread."""

    def __init__(self, names: tuple[str, ...], rate_hz: float, poller: Poller) -> None:
        self.messages: deque[str] = deque(maxlen=16)  # what is new, until the daemon has logged it
        self._names, self._period_s, self._poller = names, 1.0 / rate_hz, poller
        self._sensors: dict[str, list[PolledSensor]] = {}
        self._read_s: dict[str, float] = {}  # when a reading last succeeded
        self._retry_s: dict[str, float] = {}
        self._last_message: dict[str, str] = {}
        self._inside, self._outside = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._inside.setblocking(False)
        self._outside.setblocking(False)
        self.fd = self._inside.fileno()
        poller.register(self.fd, select.POLLIN)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="iio", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """As `imud status` shows it."""
        return ", ".join(f"iio:{name}" for name in self._names)

    def datagrams(self) -> Iterator[bytes | None]:
        """The readings that have come."""
        for _ in range(_AT_ONCE):
            try:
                yield self._inside.recv(LONGEST)
            except OSError:
                return

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._ended.wait(max(due_s - time.monotonic(), 0.0)):
            due_s = max(due_s + self._period_s, time.monotonic())
            for name in self._names:
                self._read(name)

    def _read(self, name: str) -> None:
        if time.monotonic() < self._retry_s.get(name, 0.0):
            return
        try:
            sensors = self._sensors.setdefault(name, []) or find_polled(name)
            self._sensors[name] = sensors
            for sensor in sensors:
                before_s = time.time()
                values = sensor.read()
                with contextlib.suppress(OSError):  # the socket is full: the daemon has more urgent work
                    self._outside.send(datagram(sensor.kind, values, 0.5 * (before_s + time.time())))
            self._read_s[name] = time.monotonic()
            self._report(name, f"{name}: {' and '.join(sensor.kind for sensor in sensors)} of the kernel")
        except Exception as error:  # whatever it is, the thread goes on
            if time.monotonic() - self._read_s.get(name, -math.inf) < _FAILING_S:
                return  # as a chip that does not answer once; a single reading is lost
            self._sensors.pop(name, None)
            self._retry_s[name] = time.monotonic() + _RETRY_S
            expected = isinstance(error, PortError | OSError | ValueError)
            self._report(name, f"iio:{name} cannot be read: {reason(error) if expected else repr(error)}")

    def _report(self, name: str, text: str) -> None:
        if self._last_message.get(name) != text:
            self._last_message[name] = text
            self.messages.append(text)

    def close(self) -> None:
        """End the thread; waits up to a second for a reading that has begun."""
        self._ended.set()
        self._thread.join(timeout=1.0)
        self._poller.unregister(self.fd)
        self._inside.close()
        self._outside.close()


def datagram(kind: str, values: tuple[float, ...], unix_s: float) -> bytes:
    """A reading, Pa or T, in the format of `DatagramDecoder`."""
    if kind == BAROMETER:
        return json.dumps({"class": "BARO", "pressure": values[0], "t": unix_s}).encode()
    x, y, z = (1e6 * value for value in values)
    return json.dumps({"class": "MAG", "x": x, "y": y, "z": z, "t": unix_s}).encode()
