"""Gives fixes to the filter, and its solutions to the recording and the outputs."""

import math
import time
from collections.abc import Callable, Iterable

from ..estimators.aiding_source import AidingSource
from ..estimators.filter_states import OncePerPeriod
from ..math.arrays import Records
from ..outputs.all import Outputs
from ..outputs.view import Health, View
from ..recording.control import Recordings
from ..sensors.inertial import Inertial
from .devices import Devices
from .load import Load
from .sigma_shares import RECEIVER, SigmaShares
from .status_tables import InnovationStatistics, of_filter_states
from .utc import Utc

_DAY_S = 86_400.0


class Publisher:
    """All times are monotonic nanoseconds; not thread-safe."""

    def __init__(
        self, devices: Devices, recordings: Recordings, outputs: Outputs, health: Callable[[int], Health], utc: Utc
    ) -> None:
        """health: what is wrong with the sensors at a time, for the clients."""
        self._utc = utc
        self._devices, self._recordings, self._outputs, self._health = devices, recordings, outputs, health
        self.load = Load()
        self.innovations, self.shares = InnovationStatistics(), SigmaShares()
        self._states_period = OncePerPeriod()

    def max_batch(self) -> int:
        """The largest batch of solutions that the fast loop publishes by itself, without calling `on_solutions`."""
        return self.load.max_batch(self._devices.in_use.imu.sensor.period_s) if self._devices.in_use.imu else 0

    def on_solutions(self, inertial: Inertial, n: int, now_ns: int) -> None:
        """The stream has n new solutions: record and publish them. Messages, which take longer, wait in an overload."""
        pipeline = inertial.pipeline
        if recorder := self._recordings.current:
            recorder.record_solutions(pipeline.samples[:n], pipeline.solutions[:n])
        self._outputs.binary.publish(pipeline.solutions, n, inertial.samples, now_ns)
        if self.load.leaves_time_for_messages(n, inertial.period_s, now_ns):
            begin_ns = time.thread_time_ns()
            self.publish(inertial, now_ns)
            self.load.published(n, inertial.period_s, time.thread_time_ns() - begin_ns)

    def on_fixes(self, fixes: list[Records], latency_s: float) -> None:
        """The receiver brought fixes, each `latency_s` old on arrival."""
        if fixes and self._devices.in_use.gnss:
            self._utc.add(self._devices.in_use.gnss.sensor)
            self._outputs.publish_fix(self._devices.in_use.gnss.sensor.last_used_fix, latency_s)
        if (inertial := self._devices.selection.inertial) is None:
            return
        for fix in fixes:
            filter_ = inertial.pipeline.filter
            innovations = self.shares.fuse(RECEIVER, filter_, filter_.update, fix)
            self.innovations.add(innovations)
            if recorder := self._recordings.current:
                recorder.record_fix(fix, innovations)

    def on_readings(self) -> None:
        """Fuse what receivers and other sensors have measured beside positions."""
        inertial = self._devices.selection.inertial
        for receiver in self._devices.in_use.receivers():
            if inertial is None:
                receiver.measured.clear()
                continue
            for source, row in receiver.take_measured(inertial.pipeline.filter.estimator.sources):
                innovations = self._fuse(source, inertial, row)
                if (recorder := self._recordings.current) and len(innovations):
                    recorder.record_innovations(innovations)

    def known_sources(self) -> tuple[AidingSource, ...] | None:
        """The aiding sources that the filter takes; None: there is no filter yet."""
        inertial = self._devices.selection.inertial
        return None if inertial is None else inertial.pipeline.filter.estimator.sources

    def on_measurements(self, measurements: Iterable[tuple[AidingSource, Records]]) -> None:
        """Fuse and record measurements of `known_sources` that came as datagrams."""
        for source, row in measurements:
            if (inertial := self._devices.selection.inertial) is not None:
                innovations = self._fuse(source.name, inertial, row)
                if recorder := self._recordings.current:
                    recorder.record_measurement(source.name, row, innovations)

    def _fuse(self, source: str, inertial: Inertial, measurement: Records) -> Records:
        """Its innovations."""
        filter_ = inertial.pipeline.filter
        innovations = self.shares.fuse(source, filter_, filter_.aid, measurement)
        self.innovations.add(innovations)
        return innovations

    def tick(self, latency_s: float, now_ns: int) -> None:
        """Handle fixes whose epoch ended by silence, innovations without a fix, and what is recorded once a second."""
        if self._devices.in_use.gnss:
            self.on_fixes(self._devices.in_use.gnss.sensor.flush(now_ns), latency_s)
            self.on_readings()
        if (inertial := self._devices.selection.inertial) is None:
            return
        recorder = self._recordings.current
        if len(innovations := inertial.pipeline.filter.pending_innovations()):
            self.innovations.add(innovations)
            if recorder:
                recorder.record_innovations(innovations)
        if recorder and self._states_period.is_due(now_ns):
            recorder.record_states(inertial.pipeline.filter.filter_states())

    def publish(self, inertial: Inertial, now_ns: int) -> None:
        """Send the newest solution to those clients whose message is due."""
        self._outputs.publish(lambda: self._view(inertial, now_ns), now_ns)

    def publish_receiver(self, now_ns: int) -> None:
        """Without an inertial sensor: send the receiver's fix, so that clients do not take an old solution for new."""
        self._outputs.publish(lambda: self._receivers_view(now_ns, self._health(now_ns)), now_ns)

    def _receivers_view(self, now_ns: int, health: Health) -> View:
        if self._devices.in_use.gnss is None:
            return View(devices=self._devices.described, health=health)
        view = View(devices=self._devices.described[-1:], health=health)
        receiver = self._devices.in_use.gnss.sensor
        view = view._replace(gnss=receiver.view(now_ns))
        if (fix := receiver.fresh_fix(now_ns)) is None:
            return view
        from .receiver_solution import solution  # here, as it imports the whole navigation filter

        t_ns, reported = int(fix["t_ns"][0]), receiver.last_used_fix
        utc_s = self._utc.at(t_ns)
        if reported.utc_s is not None:
            utc_s += math.remainder(reported.utc_s - utc_s, _DAY_S)  # exactly the receiver's
        return view._replace(solution=solution(fix).tobytes(), utc_s=utc_s, t_mono_ns=t_ns)

    def _view(self, inertial: Inertial, now_ns: int) -> View:
        solution = inertial.newest
        assert solution is not None
        t_ns, health = int(solution["t_ns"]), self._health(now_ns)
        selected = self._devices.selection.estimator
        has_no_position = selected.update is None and self._devices.in_use.gnss is not None
        return View(
            solution=solution.tobytes(),
            utc_s=self._utc.at(t_ns),
            t_mono_ns=t_ns,
            seq=inertial.samples,
            estimator=selected.name,
            devices=self._devices.described,
            gnss=self._devices.in_use.gnss.sensor.view(now_ns) if self._devices.in_use.gnss else None,
            temperature=float(inertial.pipeline.samples[0]["temperature"]),
            sensed=inertial.sensed,
            health=health,
            receiver=self._receivers_view(now_ns, health) if has_no_position else None,
            states=lambda: of_filter_states(inertial),
        )
