"""The daemon's one loop: waits on all descriptors at once, hands bytes to the sensors, and solutions to the outputs.

It owns the order of things, from the start to the end; it knows no register, no equation and no JSON key.
"""

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from imud.drivers.registry import plugged_in

from .. import kernel_calls
from ..compile import library
from ..configuration.settings import Settings
from ..errors import ImudError
from ..estimators import registry
from ..outputs.all import Outputs
from ..outputs.connection import NEVER_NS
from ..process import garbage, realtime
from ..process.contained import ContainedErrors
from ..process.log import get_logger
from ..process.notify import Notifier
from ..process.signals import caught, endings
from ..recording.control import Recordings
from ..sensors.inertial import Inertial
from ..setup.config import adopt
from ..stages import BATCH
from .change_logger import LOGGED
from .devices import Devices
from .fast_loop import FAILED, PUBLISH_DUE, FastLoop
from .publisher import Publisher
from .status_reporter import StatusReporter
from .utc import Utc

if TYPE_CHECKING:
    from .aiding_input import AidingInput

_TICK_NS = 100_000_000  # period of what is not urgent,
_QUIET_TICK_NS = 1_000_000_000  # and while all is settled: then the fast loop notices changes
_FLUSH_NS = 20_000_000  # between two looks whether the epoch of a fix has ended by silence
_INTERRUPTED, _HUNG_UP = 130, 129


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
        self._log = get_logger()
        self._recordings = recordings or Recordings(settings)
        self._fast_loop = FastLoop(watched=LOGGED)
        self._errors = ContainedErrors()
        self._devices = Devices(settings, wait, self._fast_loop, self._recordings, self._errors)
        self._utc = Utc()
        self._status_reporter = StatusReporter(self._devices, self._errors, self._utc)
        self._notifier = Notifier()
        self._aiding: AidingInput | None = None
        self._exit: int | None = None
        self._reload_due = False
        self._serving = False
        self._soon_ns = self._quiet_ns = 0  # when the next tick is due: at the earliest, and while all is settled

    def run(self) -> int:
        """Serve until SIGTERM (returns 0) or Ctrl-C (130). Raises ImudError when there is no point in going on."""
        with contextlib.closing(self._fast_loop), contextlib.ExitStack() as stack:
            self._wakeup = stack.enter_context(caught(self._actions()))
            self._fast_loop.others.register(self._wakeup, select.POLLIN)
            self._outputs = stack.enter_context(contextlib.closing(self._open_outputs()))
            self._aiding = self._open_aiding(stack)
            self._publisher = Publisher(
                self._devices, self._recordings, self._outputs, self._status_reporter.health, self._utc
            )
            self._devices.check()
            self._prepare_kernels()
            garbage.set_aside()
            realtime.apply(self._settings.realtime)
            name = self._devices.selection.estimator.name
            self._log.info("ready", gpsd=" ".join(self._outputs.gpsd.addresses), estimator=name)
            self._notifier.send("READY=1")
            stack.callback(self._devices.close)
            stack.callback(self._notifier.send, "STOPPING=1")
            self._serving = True
            self._serve()
        assert self._exit is not None
        return self._exit

    def _open_outputs(self) -> Outputs:
        queries = {
            "STATUS": lambda: self._status_reporter.status(self._publisher, self._outputs, self._aiding),
            "RECORD": self._recordings.status,
        }
        commands = {"RECORD": self._recordings.handle_command}
        return Outputs(self._settings, self._fast_loop.others, BATCH, queries, commands, self._errors)

    def _open_aiding(self, stack: contextlib.ExitStack) -> "AidingInput | None":
        if not (self._settings.aiding.listen or self._settings.aiding.iio):
            return None
        from .aiding_input import AidingInput  # here, as few users need it: it would cost the others memory

        return stack.enter_context(contextlib.closing(AidingInput(self._settings, self._fast_loop.others)))

    def _prepare_kernels(self) -> None:
        """Have numba compile kernels, which takes minutes: all where there is no library, else those of plug-ins."""
        compiled = library.library() is not None
        estimators = [
            name for name in self._devices.possible_estimators() if not compiled or name not in registry.NAMES
        ]
        if by_numba := [*(plugged_in() if compiled else ()), *estimators]:
            self._log.info(
                "numba compiles kernels, which takes minutes if it has not done so before", of=" ".join(by_numba)
            )
            self._notifier.send("STATUS=compiling", "EXTEND_TIMEOUT_USEC=3600000000")
        kernel_calls.warm_loop()
        kernel_calls.warm_decoders(plugins_only=compiled)
        for name in estimators:
            kernel_calls.warm(registry.by_name(name), self._settings)

    def _serve(self) -> None:
        flush_ns = NEVER_NS
        self._fast_loop.note(time.monotonic_ns())
        while self._exit is None:
            unpublished = self._run_until_event(min(self._tick_ns, flush_ns))
            now_ns = time.monotonic_ns()
            if imu := self._devices.in_use.imu:
                with self._errors.contain("the publishing of a solution"):
                    self._on_event(imu.port.fd, imu.sensor, unpublished, now_ns)
            for fd, mask in self._fast_loop.others.poll(0):
                self._dispatch(fd, mask, now_ns)
            self._devices.on_time(now_ns * 1e-9)
            if self._reload_due:
                with self._errors.contain("the reading of the configuration"):
                    self._reload()
            if now_ns >= flush_ns:
                self._use_ended_epoch(now_ns)
            if now_ns >= self._tick_ns or self._fast_loop.check_failed(now_ns):
                self._tick_all(now_ns)
            gnss = self._devices.in_use.gnss
            if not (gnss and gnss.sensor.decoder.pending):
                flush_ns = NEVER_NS
            elif now_ns >= flush_ns or flush_ns == NEVER_NS:
                flush_ns = now_ns + _FLUSH_NS

    @property
    def _tick_ns(self) -> int:
        """When the next tick is due."""
        parts = (self._devices, self._status_reporter, self._publisher.load, self._recordings)
        settled = self._aiding is None and all(part.is_settled for part in parts)
        return max(self._soon_ns, self._quiet_ns) if settled else self._soon_ns

    def _run_until_event(self, tick_ns: int) -> int:
        """Wait until something happens that the fast loop does not handle by itself, or until something is due."""
        due_s = self._devices.deadline_s
        until_ns = round(due_s * 1e9) if due_s < tick_ns * 1e-9 else tick_ns
        return self._fast_loop.run_until_event(
            until_ns, self._outputs.binary, self._outputs.due_ns, self._publisher.max_batch()
        )

    def _on_event(self, fd: int, inertial: Inertial, unpublished: int, now_ns: int) -> None:
        """Handle what the fast loop returned for: a read that failed, a large batch, a message that is due."""
        if unpublished == FAILED:
            self._dispatch(fd, 0, now_ns)
        elif unpublished > 0:
            self._publisher.on_solutions(inertial, unpublished, now_ns)
        elif unpublished == PUBLISH_DUE:
            self._publisher.publish(inertial, now_ns)

    def _dispatch(self, fd: int, mask: int, now_ns: int) -> None:
        if fd in self._devices:
            n, fixes = self._devices.on_event(fd, now_ns)
            with self._errors.contain("the publishing of a solution"):
                if n and self._devices.in_use.imu:
                    self._publisher.on_solutions(self._devices.in_use.imu.sensor, n, now_ns)
            with self._errors.contain("the use of a fix"):
                self._publisher.on_fixes(fixes, self._settings.gnss.latency_s)
                self._publisher.on_readings()
        elif fd == self._wakeup:
            os.read(fd, 64)  # its handler has run
        elif self._aiding is not None and fd in self._aiding:
            with self._errors.contain("the use of a measurement"):
                self._publisher.on_measurements(self._aiding.measurements(self._publisher.known_sources()))
        else:
            if fd in self._outputs.gpsd:
                self._publish_newest(now_ns)  # the client may ask for it
            self._outputs.on_event(fd, mask, now_ns)

    def _publish_newest(self, now_ns: int) -> None:
        """Publish the present state, unless what was published last is fresh."""
        self._outputs.gpsd.want_newest(now_ns)
        with self._errors.contain("the publishing of a solution"):
            if self._devices.in_use.imu is None:
                self._publisher.publish_receiver(now_ns)
            elif self._devices.in_use.imu.sensor.newest is not None:
                self._publisher.publish(self._devices.in_use.imu.sensor, now_ns)

    def _tick_all(self, now_ns: int) -> None:
        """Do what is not urgent: unfinished epochs, silence, slow clients, the watchdog, lines for the log."""
        gap_ns = self._fast_loop.note(now_ns)
        self._soon_ns, self._quiet_ns = now_ns + _TICK_NS, now_ns + _QUIET_TICK_NS
        self._use_ended_epoch(now_ns)
        with self._errors.contain("the check of the devices"):
            self._quiet_ns = min(self._quiet_ns, self._devices.tick(gap_ns, now_ns))
        with self._errors.contain("the publishing of a fix"):
            if self._devices.in_use.imu is None:
                self._publisher.publish_receiver(now_ns)
        if self._aiding is not None:
            with self._errors.contain("the check of the measurements"):
                self._aiding.tick(now_ns)
        self._outputs.gpsd.announce(self._devices.described, now_ns)
        self._outputs.tick(now_ns)
        with self._errors.contain("the report of the state"):
            self._status_reporter.tick(self._publisher.load, gap_ns, now_ns)
        with self._errors.contain("the check of the recording"):
            for level, text in self._recordings.tick():
                getattr(self._log, level)(text)
        self._notifier.status("; ".join(f"{port.spec.path}: {port.description}" for port in self._devices.ports))
        self._notifier.alive(now_ns)
        self._quiet_ns = min(self._quiet_ns, self._notifier.due_ns)

    def _use_ended_epoch(self, now_ns: int) -> None:
        """Fuse the fix whose epoch has ended by silence."""
        with self._errors.contain("the use of a fix"):
            self._publisher.tick(self._settings.gnss.latency_s, now_ns)

    def _actions(self) -> dict[signal.Signals, Callable[[], None]]:
        """What each signal does. Without a configuration file to reread, SIGHUP ends the process."""
        codes = {signal.SIGTERM: 0, signal.SIGINT: _INTERRUPTED, signal.SIGHUP: _HUNG_UP}
        actions: dict[signal.Signals, Callable[[], None]] = {n: partial(self._end, codes[n]) for n in endings()}
        if self._reread is not None:
            actions[signal.SIGHUP] = self._ask_for_reload
        return actions

    def _end(self, code: int) -> None:
        self._exit = code
        if not self._serving:  # the loop that checks _exit does not run yet
            raise SystemExit(code)

    def _ask_for_reload(self) -> None:
        self._reload_due = True

    def _reload(self) -> None:
        """Read the configuration again and take over its hot keys; one with an error changes nothing."""
        assert self._reread is not None
        self._reload_due = False
        self._notifier.send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")
        try:
            self._settings, taken, waiting = adopt(self._settings, self._reread())
        except ImudError as error:
            self._log.error(f"the configuration stays as it was: {error}")
        else:
            self._outputs.configure(self._settings)
            self._devices.configure(self._settings)
            if self._recordings.current:
                self._recordings.current.record_settings(self._settings)
            self._log.info("read the configuration again", changed=", ".join(taken) or "nothing")
            if waiting:
                self._log.warning(f"takes effect at the next start: {', '.join(waiting)}")
        finally:
            self._notifier.send("READY=1")
