"""The daemon's one loop: waits on all descriptors at once, hands bytes to the sensors and solutions to the outputs.

It owns the descriptors and the order of things; it knows no register, no equation and no JSON key.
"""

import contextlib
import gc
import os
import select
import signal
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import structlog

from drivers.driver import AnyDriver, Identity, ImuConfigured
from drivers.errors import PortEndedError, PortLostError

from . import calibration, choices, compilation, realtime, runtime, vitals
from .announce import Announcer
from .config import adopt
from .cycle import FAILED, SHOW, Cycle
from .errors import ImudError, UsageError
from .estimators.records import ATTITUDE_VALID
from .fitting import Fitting
from .load import Load
from .notify import Notifier
from .outputs.all import Outputs
from .outputs.view import Device, Health, View
from .pipeline import BATCH
from .ports import Configured, Port
from .recording.control import Recordings
from .recording.recorder import Recorder
from .sensors import Inertial, Receiver, Records
from .settings import Settings
from .signals import caught

_SLOW_NS = 50_000_000  # what is not urgent is looked after this often
_SOON_NS = 20_000_000  # while a fix waits for the end of its epoch
_INTERRUPTED, _HUNG_UP = 130, 129
_PARTS = {"imu": "inertial sensor", "gnss": "receiver"}


class Daemon:
    """Runs until a signal ends it. One per process."""

    def __init__(
        self,
        settings: Settings,
        wait: bool = True,
        reread: Callable[[], Settings] | None = None,
        recordings: Recordings | None = None,
    ) -> None:
        """`wait` for devices that are absent at the start; `reread` is called on SIGHUP.

        `recordings` are closed by the caller.
        """
        self._settings = settings
        self._reread = reread
        self._log = structlog.get_logger()
        self._recordings = recordings or Recordings(settings)
        self._recordings.on_begin, self._recordings.on_end = self._introduce, self._read_directly
        self._fitting = Fitting(settings, self._log.warning)
        self._cycle = Cycle()
        self._ports = [Port(spec, options, self, patient=wait) for spec, options in choices.ports(settings)]
        self._pulse = choices.pulse(settings)
        self._by_fd: dict[int, Port] = {}
        self._imu: tuple[Port, Inertial] | None = None
        self._gnss: tuple[Port, Receiver] | None = None
        self._known = calibration.Calibration("")  # of the inertial sensor
        self._devices: tuple[Device, ...] = ()
        self._announcer = Announcer(self._log)
        self._troubles: dict[str, tuple[str, ...] | None] = {"imu": None, "gnss": None}  # None: no such sensor
        self._load = Load()
        self._innovations = vitals.Innovations()
        self._started_ns = time.monotonic_ns()
        self._exit: int | None = None
        self._reload_due = False
        self._compiling = False

    def run(self) -> int:
        """Serve until SIGTERM (returns 0) or Ctrl-C (130). Raises ImudError when there is no point in going on."""
        notifier = Notifier()
        with contextlib.closing(self._cycle), contextlib.ExitStack() as stack:
            self._wakeup = stack.enter_context(caught(self._actions()))
            self._cycle.others.register(self._wakeup, select.POLLIN)
            own = {"STATUS": self._tell_status, "RECORD": self._recordings.told}
            orders = {"RECORD": self._recordings.obey}
            outputs = Outputs(self._settings, self._cycle.others, BATCH, own, orders)
            self._outputs = stack.enter_context(contextlib.closing(outputs))
            notifier.say("STATUS=compiling", "EXTEND_TIMEOUT_USEC=300000000")
            self._compiling = True
            self._prepare_kernels()
            compilation.release_compiler()
            self._compiling = False
            gc.collect()
            gc.freeze()
            realtime.apply(self._settings.realtime)
            self._log.info("ready", gpsd=" ".join(self._outputs.gpsd.addresses), estimator=self._fitting.estimator.name)
            notifier.say("READY=1")
            stack.callback(self._farewell)
            stack.callback(notifier.say, "STOPPING=1")
            self._serve(notifier)
        assert self._exit is not None
        return self._exit

    def _prepare_kernels(self) -> None:
        estimators = self._fitting.choice.possible
        if missing := compilation.missing(estimators):
            name = self._fitting.estimator.name
            self._log.info("compiling the filter (the first start takes a while)", estimator=name)
            if not compilation.compile_apart(missing, self._settings):
                places = ", ".join(str(path) for path in runtime.candidates())
                self._log.warning(f"compiled kernels could not be kept, every start compiles anew: see {places}")
        compilation.warm_decoders()
        for estimator in estimators:
            compilation.warm(estimator, self._settings)

    def _actions(self) -> dict[signal.Signals, Callable[[], None]]:
        """What the signals mean. Without a file to read again a hang-up is the terminal's, and an end."""
        ends = {signal.SIGTERM: 0, signal.SIGINT: _INTERRUPTED, signal.SIGHUP: _HUNG_UP}
        actions: dict[signal.Signals, Callable[[], None]] = {n: partial(self._end, code) for n, code in ends.items()}
        if self._reread is not None:
            actions[signal.SIGHUP] = self._ask_for_reload
        return actions

    def _ask_for_reload(self) -> None:
        self._reload_due = True

    def _reload(self, notifier: Notifier) -> None:
        """Read the configuration again and take what is hot; one with an error changes nothing."""
        assert self._reread is not None
        self._reload_due = False
        notifier.say("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")
        try:
            self._settings, taken, waiting = adopt(self._settings, self._reread())
        except ImudError as error:
            self._log.error(f"the configuration stays as it was: {error}")
        else:
            self._outputs.configure(self._settings)
            if self._gnss:
                self._gnss[1].settings = self._settings.gnss
            if self._imu and self._imu[0].configured:
                settings = choices.settings_for(self._settings, self._imu[0].configured.identity)
                self._imu[1].stream.filter.configure(settings)
            if self._recorder:
                self._recorder.settings(self._settings)
            self._log.info("read the configuration again", changed=", ".join(taken) or "nothing")
            if waiting:
                self._log.warning(f"takes effect at the next start: {', '.join(waiting)}")
        notifier.say("READY=1")

    def _end(self, code: int) -> None:
        self._exit = code
        if self._compiling:  # no loop runs yet that would see it
            raise SystemExit(code)

    def _serve(self, notifier: Notifier) -> None:
        slow_ns = 0
        while self._exit is None:
            unpublished = self._turn(slow_ns)
            now_ns = time.monotonic_ns()
            if self._imu:
                self._on_turn(*self._imu, unpublished, now_ns)
            for fd, mask in self._cycle.others.poll(0):
                self._dispatch(fd, mask, now_ns)
            for port in self._ports:
                port.on_time(now_ns * 1e-9)
            if self._reload_due:
                self._reload(notifier)
            if now_ns >= slow_ns:
                pending = self._gnss and self._gnss[1].decoder.pending
                slow_ns = now_ns + (_SOON_NS if pending else _SLOW_NS)
                self._look_after(now_ns, notifier)

    def _turn(self, slow_ns: int) -> int:
        """Wait until something has happened that the cycle does not do by itself, or until something is due."""
        due_s = min([port.deadline_s for port in self._ports])
        until_ns = round(due_s * 1e9) if due_s < slow_ns * 1e-9 else slow_ns
        most = self._load.usual(self._imu[1].period_s) if self._imu else 0
        return self._cycle.turn(until_ns, self._outputs.binary, self._outputs.due_ns, most)

    def _on_turn(self, port: Port, inertial: Inertial, unpublished: int, now_ns: int) -> None:
        """What the cycle left to do: a reading that failed, a batch that is to be judged, a view that is due."""
        if unpublished == FAILED:
            self._dispatch(port.fd, 0, now_ns)
        elif unpublished > 0:
            self._solved(inertial, unpublished, now_ns)
        elif unpublished == SHOW:
            self._outputs.show(partial(self._view, inertial, now_ns), now_ns)

    def _solved(self, inertial: Inertial, n: int, now_ns: int) -> None:
        """There are n new solutions that nobody has seen."""
        stream = inertial.stream
        if self._recorder:
            self._recorder.stepped(stream.samples[:n], stream.solutions[:n])
        if self._load.leaves_time_to_publish(n, inertial.period_s, now_ns):
            self._outputs.binary.publish(stream.solutions, n, inertial.samples, now_ns)
            self._outputs.show(partial(self._view, inertial, now_ns), now_ns)

    def _dispatch(self, fd: int, mask: int, now_ns: int) -> None:
        port = self._by_fd.get(fd)
        if port is None:
            if fd == self._wakeup:
                os.read(fd, 64)  # its handler has run
            else:
                self._outputs.on_event(fd, mask, now_ns)
            return
        try:
            if self._imu and port is self._imu[0]:
                if n := self._imu[1].read(now_ns):
                    self._solved(self._imu[1], n, now_ns)
            elif self._gnss and port is self._gnss[0]:
                self._take(self._gnss[1].read(port.line, now_ns))
            else:
                port.on_event()
        except PortLostError as error:
            (port.retire if isinstance(error, PortEndedError) else port.lost)(str(error))

    def _take(self, fixes: list[Records]) -> None:
        if fixes and self._gnss:
            self._outputs.fixed(self._gnss[1].used_last, self._settings.gnss.latency_s)
        for fix in fixes:
            if self._fitting.inertial is not None:
                innovations = self._fitting.inertial.stream.filter.update(fix)
                self._innovations.take(innovations)
                if self._recorder:
                    self._recorder.updated(fix, innovations)

    def _hear(self) -> None:
        """What the filter has to tell without a fix."""
        if self._fitting.inertial is not None and len(told := self._fitting.inertial.stream.filter.told()):
            self._innovations.take(told)
            if self._recorder:
                self._recorder.told(told)

    def _view(self, inertial: Inertial, now_ns: int) -> View:
        solution = inertial.newest
        assert solution is not None
        t_ns = int(solution["t_ns"])
        return View(
            solution=solution.tobytes(),
            utc_s=(time.time_ns() - time.monotonic_ns() + t_ns) * 1e-9,
            t_mono_ns=t_ns,
            seq=inertial.samples,
            estimator=self._fitting.estimator.name,
            devices=self._devices,
            gnss=self._gnss[1].view(now_ns) if self._gnss else None,
            temperature=float(inertial.stream.samples[0]["temperature"]),
            sensed=inertial.sensed,
            health=Health(**self._troubles, clock=inertial.clock_fit()),
        )

    def _look_after(self, now_ns: int, notifier: Notifier) -> None:
        """What is due now and then: silence, unfinished epochs, slow clients, the watchdog, changes worth a line."""
        if self._gnss:
            self._take(self._gnss[1].flush(now_ns))
        self._hear()
        for pair in (self._imu, self._gnss):
            if pair and now_ns - pair[1].heard_ns > pair[1].silence_ns and not _is_readable(pair[0].fd):
                pair[0].lost("the device sends nothing more of use")
        for port in self._ports:
            port.pass_on()
        if self._imu is None:  # the clients must not take old news for new
            self._outputs.show(partial(View, devices=self._devices), now_ns)
        self._outputs.look_after(now_ns)
        self._tell_changes(now_ns)
        if news := self._load.news(self._fitting.inertial.lost if self._fitting.inertial else 0, now_ns):
            self._log.warning(news)
        if self._recorder and self._imu:
            self._recorder.looked(self._ports.index(self._imu[0]), self._imu[1], now_ns)
        for level, text in self._recordings.look_after():
            getattr(self._log, level)(text)
        notifier.status("; ".join(f"{port.spec.path}: {port.story}" for port in self._ports))
        notifier.alive(now_ns)

    def _pairs(self) -> dict[str, tuple[Port, Inertial] | tuple[Port, Receiver] | None]:
        return {"imu": self._imu, "gnss": self._gnss}

    def _tell_changes(self, now_ns: int) -> None:
        newest = self._fitting.inertial.newest if self._fitting.inertial else None
        status = 0 if newest is None else int(newest["status"])
        if self._announcer.status(status, now_ns) & ATTITUDE_VALID:
            self._doubt_the_axes()
        if self._gnss and (news := self._gnss[1].news):
            self._log.warning(news)
            self._gnss[1].news = ""
        for kind, pair in self._pairs().items():
            self._troubles[kind] = pair[1].troubles(now_ns) if pair else None
            if pair:
                pair[1].rate.look(pair[1].heard, now_ns)
                self._announcer.troubles(kind, self._troubles[kind] or (), now_ns)

    def _tell_status(self) -> str:
        """The answer to `imud status`."""
        now_ns = time.monotonic_ns()
        parts = {pair[0]: (pair[1], self._troubles[kind]) for kind, pair in self._pairs().items() if pair}
        return vitals.status_object(
            {
                **vitals.of_process(self._started_ns),
                "load": vitals.of_load(self._load),
                "filter": vitals.of_filter(self._fitting.inertial, self._fitting.estimator.name),
                "innovations": self._innovations.told(),
                "ports": {
                    str(i): vitals.of_port(port, now_ns, *parts.get(port, (None, None)))
                    for i, port in enumerate(self._ports)
                },
                "outputs": vitals.of_outputs(self._outputs.gpsd, self._outputs.binary),
            }
        )

    def _doubt_the_axes(self) -> None:
        """A sensor that seems upside down may have other axes than ours: nothing on the wire can tell."""
        if self._fitting.inertial is not None and self._fitting.inertial.stream.samples[0]["f"][2] > 0.0:
            self._log.warning(
                "the sensor is upside down; if it is not, its axes are others: imu.mount_rpy_deg = [180, 0, 0]"
            )

    def watch(self, port: Port, fd: int) -> None:
        """A port opened its device."""
        self._by_fd[fd] = port
        self._cycle.others.register(fd, select.POLLIN)

    def unwatch(self, fd: int) -> None:
        """A port closes its device."""
        del self._by_fd[fd]
        if fd == self._cycle.fd:
            self._cycle.detach()
        else:
            self._cycle.others.unregister(fd)

    def connected(self, port: Port, driver: AnyDriver, configured: Configured) -> None:
        """A device streams."""
        identity = configured.identity
        role = self._imu if driver.kind == "imu" else self._gnss
        if role is not None:
            port.retire(f"not used: {role[0].spec.path} is the {_PARTS[driver.kind]} already")
            return
        now_ns = time.monotonic_ns()
        facts: dict[str, Any] = {"port": port.spec.path, "device": identity.model or driver.name, "baud": identity.baud}
        if isinstance(configured, ImuConfigured) and driver.kind == "imu":
            known = self._calibration_of(identity)
            try:
                inertial = self._fitting.connect(port.line, driver, configured, known, self._settings, now_ns)
            except UsageError as error:
                if self._fitting.inertial is None:
                    raise
                port.refuse(str(error))  # who served once does not end because of what is plugged in later
                return
            self._imu, self._known = (port, inertial), known
            self._record(port, self._imu[1])
            self._read_directly()
            facts |= {"serial": identity.serial, "firmware": identity.firmware, "rate_hz": configured.rate_hz}
        elif driver.kind == "gnss":
            self._gnss = (port, Receiver(driver, self._settings.gnss, now_ns, self._pulse))
            self._record(port, self._gnss[1])
        self._log.info("streaming", **{name: value for name, value in facts.items() if value})
        if self._imu is None and all(port.configured for port in self._ports):
            self._log.warning("there is no inertial sensor on any port: nothing to estimate")
        self._describe()

    @property
    def _recorder(self) -> Recorder | None:
        return self._recordings.current

    def _introduce(self) -> None:
        """To a recording that begins: the sensors that stream already. Their bytes must pass through Python now."""
        if self._imu and self._imu[0].fd == self._cycle.fd:
            self._cycle.detach()
            self._cycle.others.register(self._imu[0].fd, select.POLLIN)
        for pair in self._pairs().values():
            if pair:
                self._record(*pair)

    def _read_directly(self) -> None:
        """Let the inertial sensor's line be read in compiled code, if nobody else wants to see its bytes."""
        for pair in self._pairs().values():
            if pair and self._recorder is None:
                pair[1].tap = None
        if self._imu and self._imu[0].line.plain and self._imu[1].tap is None and self._cycle.fd < 0:
            port, inertial = self._imu
            self._cycle.others.unregister(port.fd)
            self._cycle.attach(port.fd, inertial.stream)

    def _record(self, port: Port, sensor: Inertial | Receiver) -> None:
        """Have the sensor's bytes recorded, if anything is."""
        if self._recorder and port.configured:
            number = self._ports.index(port)
            known = self._known if isinstance(sensor, Inertial) else None
            self._recorder.connected(number, port.spec.path, port.configured, known)
            sensor.tap = self._recorder.tap(number)

    def disconnected(self, port: Port) -> None:
        """A device streams no more."""
        if self._recorder:
            self._recorder.disconnected(self._ports.index(port), port.spec.path)
        if self._imu and self._imu[0] is port:
            self._imu = None
        if self._gnss and self._gnss[0] is port:
            self._log.info("receiver ended", port=port.spec.path, **self._gnss[1].counters())
            self._gnss = None
        self._describe()

    def _describe(self) -> None:
        streaming = [pair[0] for pair in (self._imu, self._gnss) if pair and pair[0].configured]
        self._devices = tuple(_device(port) for port in streaming)

    def _calibration_of(self, identity: Identity) -> calibration.Calibration:
        """What is known of this very sensor."""
        try:
            found = calibration.of(identity)
        except ImudError as error:
            self._log.warning(f"uncalibrated: {error}")
            return calibration.Calibration("")
        if parts := found.parts:
            self._log.info("calibrated", sensor=found.serial, **parts)
        return found

    def _farewell(self) -> None:
        for port in self._ports:
            port.close()
        if self._fitting.inertial is not None:
            self._log.info("ended", samples=self._fitting.inertial.samples, **self._fitting.inertial.counters())


def _device(port: Port) -> Device:
    assert port.configured is not None
    identity = port.configured.identity
    return Device(
        path=port.spec.path,
        driver=identity.driver,
        bps=identity.baud or None,
        model=identity.model,
        serial=identity.serial,
        activated_s=time.time(),
    )


def _is_readable(fd: int) -> bool:
    """Whether bytes wait: it may be we who slept, not the device."""
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    return bool(poll.poll(0))
