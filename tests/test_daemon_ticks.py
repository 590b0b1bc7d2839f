"""When the daemon calls Python: once a second while all is settled, ten times otherwise; the filter's state is stored
by one thread at a time.
"""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from structlog.testing import capture_logs

from imud.configuration.settings import Settings
from imud.daemon.checkpoint_file import CheckpointFiles
from imud.daemon.load import Load
from imud.daemon.loop import Daemon
from imud.daemon.state_store import StateStore
from imud.drivers.driver import Identity, ImuConfigured
from imud.estimators.records import ATTITUDE_VALID, SOLUTION
from imud.sensor_errors.calibration import Calibration

MS, SECOND = 1_000_000, 1_000_000_000


@pytest.fixture
def daemon():
    """After a tick at 10 s, with an inertial sensor that the fast loop reads."""
    daemon = Daemon(Settings(ports=("/dev/imu",)))
    daemon._publisher = SimpleNamespace(load=Load())
    daemon._fast_loop._record["fd"] = 0
    daemon._soon_ns, daemon._quiet_ns = 10 * SECOND + 100 * MS, 11 * SECOND
    yield daemon
    daemon._fast_loop.close()


def test_settled_it_ticks_once_a_second(daemon):
    assert daemon._tick_ns == 11 * SECOND


def test_what_is_due_earlier_is_waited_for_a_tenth_of_a_second_at_least(daemon):
    for due_ms, at_ms in ((300, 300), (20, 100)):
        daemon._quiet_ns = 10 * SECOND + due_ms * MS
        assert daemon._tick_ns == 10 * SECOND + at_ms * MS


def without_a_fast_line(daemon):
    daemon._fast_loop.detach()


def with_a_change_of_the_status(daemon):
    daemon._status_reporter._change_logger.status(ATTITUDE_VALID, 10 * SECOND)


def with_late_batches(daemon):
    daemon._publisher.load.leaves_time_for_messages(200, 1e-3, 10 * SECOND)


def with_measurements_of_others(daemon):
    daemon._aiding = object()


def with_a_recording(daemon):
    daemon._recordings.current = object()


UNSETTLED = (
    without_a_fast_line,
    with_a_change_of_the_status,
    with_late_batches,
    with_measurements_of_others,
    with_a_recording,
)


@pytest.mark.parametrize("change", UNSETTLED)
def test_unsettled_it_ticks_ten_times_a_second(daemon, change):
    change(daemon)
    assert daemon._tick_ns == 10 * SECOND + 100 * MS


def broken():
    raise IndexError("list index out of range")


def test_a_reload_that_fails_in_whatever_way_ends_for_the_service_manager(daemon):
    sent = []
    daemon._notifier = SimpleNamespace(send=lambda *assignments: sent.append(assignments[0]))
    daemon._reread = broken
    with daemon._errors.contain("the reading of the configuration"):
        daemon._reload()
    assert sent == ["RELOADING=1", "READY=1"] and daemon._errors.count == 1


def test_without_a_thread_left_the_state_is_kept_as_soon_as_there_is_one(monkeypatch):
    saved = []

    def no_thread(*_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(CheckpointFiles, "save", lambda files, checkpoint: saved.append(checkpoint))
    newest = np.zeros(1, SOLUTION)
    newest["sigma_bg"] = newest["sigma_ba"] = 1.0
    filter_ = SimpleNamespace(checkpoint=lambda: b"state", correction=None)
    sensor = SimpleNamespace(newest=newest[0], pipeline=SimpleNamespace(filter=filter_))
    configured, store = ImuConfigured(Identity("epson", ""), 1000.0, 1_000_000, 0, 0), StateStore()
    store.load(configured, "/dev/imu", Calibration(""), Settings())
    with monkeypatch.context() as limited, capture_logs() as lines:
        limited.setattr("_thread.start_new_thread", no_thread)
        for second in range(1, 4):
            store.save_when_due(configured, sensor, [], second * SECOND)
    (line,) = lines
    assert "cannot be kept over a restart" in line["event"] and saved == []
    store.save_when_due(configured, sensor, [], 4 * SECOND)
    assert store._wait()
    assert saved == [b"state"]


def test_a_state_that_the_disk_refuses_is_named_with_its_file_once():
    store = StateStore()
    with capture_logs() as lines:
        for _ in range(2):
            store._warn(OSError(5, "Input/output error", "/var/lib/imud/biases-1.json"))
    (line,) = lines
    assert line["event"].endswith("over a restart: /var/lib/imud/biases-1.json: Input/output error")


def test_a_disk_that_stalls_gets_one_checkpoint_at_a_time(monkeypatch):
    stalls, saved = threading.Event(), []

    def save(files, checkpoint):
        stalls.wait(10.0)
        saved.append(checkpoint)

    monkeypatch.setattr(CheckpointFiles, "save", save)
    newest = np.zeros(1, SOLUTION)
    newest["sigma_bg"] = newest["sigma_ba"] = 1.0
    filter_ = SimpleNamespace(checkpoint=lambda: b"%d" % len(saved), correction=None)
    sensor = SimpleNamespace(newest=newest[0], pipeline=SimpleNamespace(filter=filter_))
    configured, store = ImuConfigured(Identity("epson", ""), 1000.0, 1_000_000, 0, 0), StateStore()
    store.load(configured, "/dev/imu", Calibration(""), Settings())
    for second in range(1, 6):
        store.save_when_due(configured, sensor, [], second * SECOND)
    stalls.set()
    assert store._wait()
    assert saved == [b"0"]
    store.save_when_due(configured, sensor, [], 6 * SECOND)
    store.save_when_due(configured, sensor, [], 6 * SECOND + 500 * MS)
    assert store._wait()
    assert saved == [b"0", b"1"]
