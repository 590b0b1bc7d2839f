"""Receives measurements of other programs and of the kernel's sensors, and has them decoded and counted."""

import time
from collections.abc import Iterable, Iterator
from typing import Any

from ..configuration.settings import Settings
from ..estimators.aiding_source import AidingSource
from ..math.arrays import Records
from ..process.log import get_logger
from ..sensors.aiding import DatagramDecoder
from .aiding_socket import LONGEST, AidingSocket, Poller
from .change_logger import ChangeLogger


class AidingInput:
    """What `aiding.listen` and `aiding.iio` open. Not thread-safe; times are monotonic ns. Raises as `AidingSocket`."""

    def __init__(self, settings: Settings, poller: Poller) -> None:
        self._inputs: list[Any] = []
        if settings.aiding.listen:
            self._inputs.append(AidingSocket(settings.aiding.listen, poller))
        if settings.aiding.iio:
            from .iio_reader import IioReader

            self._inputs.append(IioReader(settings.aiding.iio, settings.aiding.iio_rate_hz, poller))
        self._decoder = DatagramDecoder()
        self._log = get_logger().bind(aiding=self._address)
        self._change_logger = ChangeLogger(self._log)

    @property
    def _address(self) -> str:
        return ", ".join(each.address for each in self._inputs)

    def __contains__(self, fd: int) -> bool:
        return any(fd == each.fd for each in self._inputs)

    def measurements(self, known: Iterable[AidingSource] | None) -> Iterator[tuple[AidingSource, Records]]:
        """Source and measurement (array of one MEASUREMENT) of all that has come.

        known: the sources that the estimator takes; None: there is none yet, and what has come is refused.
        """
        for data in (data for each in self._inputs for data in each.datagrams()):
            now_ns, unix_ns = time.monotonic_ns(), time.time_ns()
            if data is None:
                self._decoder.refuse("length", f"a datagram of more than {LONGEST} bytes")
            elif known is None:
                self._decoder.refuse("lack of a sensor", "there is no inertial sensor yet")
            else:
                yield from self._decoder.decode(data, known, now_ns, unix_ns)

    def tick(self, now_ns: int) -> None:
        """Call several times a second: logs what is new."""
        self._decoder.update(now_ns)
        for text in self._decoder.messages:
            self._log.info(text)
        self._decoder.messages.clear()
        for each in self._inputs:
            while each.messages:
                self._log.info(each.messages.popleft())
        self._change_logger.faults("aiding", self._decoder.faults(now_ns), now_ns)

    def properties(self, now_ns: int) -> dict[str, Any]:
        """What `imud status` shows."""
        return {"address": self._address, **self._decoder.properties(now_ns)}

    def close(self) -> None:
        for each in self._inputs:
            each.close()
