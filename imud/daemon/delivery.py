"""Takes fixes to the filter, and what the filter makes to the recording and, if there is time, to the outputs."""

import time
from collections.abc import Callable

from ..math.arrays import Records
from ..outputs.all import Outputs
from ..outputs.view import Health, View
from ..recording.control import Recordings
from ..sensors.inertial import Inertial
from .devices import Devices
from .load import Load
from .vitals import Innovations


def _utc_s(t_ns: int) -> float:
    return (time.time_ns() - time.monotonic_ns() + t_ns) * 1e-9


class Delivery:
    """Keeps no state but counts. All times are monotonic nanoseconds; not thread-safe."""

    def __init__(
        self, devices: Devices, recordings: Recordings, outputs: Outputs, health: Callable[[], Health]
    ) -> None:
        """health: what is wrong with the sensors, for the clients."""
        self._devices, self._recordings, self._outputs, self._health = devices, recordings, outputs, health
        self.load = Load()
        self.innovations = Innovations()

    def most(self) -> int:
        """The largest batch of solutions that the cycle publishes by itself, without calling `solved`."""
        return self.load.usual(self._devices.imu[1].period_s) if self._devices.imu else 0

    def solved(self, inertial: Inertial, n: int, now_ns: int) -> None:
        """The stream has n new solutions: record them, and publish them if there is time."""
        stream = inertial.stream
        if recorder := self._recordings.current:
            recorder.stepped(stream.samples[:n], stream.solutions[:n])
        if self.load.leaves_time_to_publish(n, inertial.period_s, now_ns):
            self._outputs.binary.publish(stream.solutions, n, inertial.samples, now_ns)
            self.show(inertial, now_ns)

    def fixed(self, fixes: list[Records], latency_s: float) -> None:
        """The receiver brought fixes, each `latency_s` old on arrival."""
        if fixes and self._devices.gnss:
            self._outputs.publish_fix(self._devices.gnss[1].used_last, latency_s)
        if (inertial := self._devices.fitting.inertial) is None:
            return
        for fix in fixes:
            innovations = inertial.stream.filter.update(fix)
            self.innovations.take(innovations)
            if recorder := self._recordings.current:
                recorder.updated(fix, innovations)

    def tick(self, latency_s: float, now_ns: int) -> None:
        """Call now and then: takes fixes whose epoch ended by silence, and innovations that come without a fix."""
        if self._devices.gnss:
            self.fixed(self._devices.gnss[1].flush(now_ns), latency_s)
        inertial = self._devices.fitting.inertial
        if inertial is not None and len(innovations := inertial.stream.filter.pending_innovations()):
            self.innovations.take(innovations)
            if recorder := self._recordings.current:
                recorder.told(innovations)

    def show(self, inertial: Inertial, now_ns: int) -> None:
        """Show the newest solution to those clients whose message is due."""
        self._outputs.publish(lambda: self._view(inertial, now_ns), now_ns)

    def show_receiver(self, now_ns: int) -> None:
        """Without an inertial sensor: show what the receiver says, so that clients do not take old news for new."""
        self._outputs.publish(lambda: self._receivers_view(now_ns), now_ns)

    def _receivers_view(self, now_ns: int) -> View:
        view = View(devices=self._devices.described, health=self._health())
        if self._devices.gnss is None:
            return view
        receiver = self._devices.gnss[1]
        view = view._replace(gnss=receiver.view(now_ns))
        if (fix := receiver.fresh(now_ns)) is None:
            return view
        from .receiver_alone import solution  # with all of the navigation filter: not at every start

        t_ns = int(fix["t_ns"][0])
        return view._replace(solution=solution(fix).tobytes(), utc_s=_utc_s(t_ns), t_mono_ns=t_ns)

    def _view(self, inertial: Inertial, now_ns: int) -> View:
        solution = inertial.newest
        assert solution is not None
        t_ns = int(solution["t_ns"])
        return View(
            solution=solution.tobytes(),
            utc_s=_utc_s(t_ns),
            t_mono_ns=t_ns,
            seq=inertial.samples,
            estimator=self._devices.fitting.estimator.name,
            devices=self._devices.described,
            gnss=self._devices.gnss[1].view(now_ns) if self._devices.gnss else None,
            temperature=float(inertial.stream.samples[0]["temperature"]),
            sensed=inertial.sensed,
            health=self._health(),
        )
