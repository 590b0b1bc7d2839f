"""The daemon's cycle: what it does by itself, bit for bit as the same code called by Python; when it comes back."""

import contextlib
import os
import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imud import client
from imud.commands.bench import signals
from imud.commands.bench.throughput import attitude_pipeline
from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.configuration.settings import Stream as StreamSettings
from imud.daemon.fast_loop import CHECK_NS, FAILED, PAUSE_NS, PUBLISH_DUE, FastLoop, _run_until_event
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.registry import by_name
from imud.estimators import registry
from imud.estimators.records import AT_REST, ATTITUDE_VALID
from imud.outputs.binary import BinaryOutputs
from imud.pipeline import Filter, InertialPipeline
from imud.sensors.byte_sink import READ_BYTES
from imud.stages import BATCH

WIRE = signals.frames(2000).tobytes()
NEVER_NS = (1 << 63) - 1
SOON_NS, LONG_NS = 20_000_000, 60_000_000_000
STALE_NS = LONG_NS
PARTIAL = 64  # bytes of a frame that has only begun, at most


@pytest.fixture
def rig(tmp_path):
    with contextlib.ExitStack() as stack:
        yield Rig(stack, tmp_path / "stream")


class Rig:
    """A cycle that reads from a pipe, and a subscriber to what it publishes."""

    def __init__(self, stack, path):
        self.fast_loop = stack.enter_context(contextlib.closing(FastLoop(watched=ATTITUDE_VALID)))
        outputs = Settings(stream=StreamSettings(listen=str(path)))
        self.outputs = stack.enter_context(contextlib.closing(BinaryOutputs(outputs, self.fast_loop.others, 256)))
        self.states = stack.enter_context(client.connect(path, timeout_s=5.0))
        self.outputs.stream.on_event(self.fast_loop.others.poll(0)[0][0])
        self.reader, self.writer = os.pipe()
        os.set_blocking(self.reader, False)
        stack.callback(os.close, self.reader)
        self.pipeline = attitude_pipeline()
        self.fast_loop.attach(self.reader, self.pipeline, STALE_NS)
        self.fast_loop.note(time.monotonic_ns())
        self._at = 0

    def begin(self):
        """The decoder believes a first frame when it has seen the second."""
        self.frames(2)
        self.turn()
        assert [next(self.states).seq for _ in range(2)] == [1, 2]

    def frames(self, n):
        """The next n."""
        self.write(WIRE[22 * self._at : 22 * (self._at + n)])
        self._at += n

    def turn(self, for_ns=SOON_NS, publish_ns=NEVER_NS, max_batch=99):
        return self.fast_loop.run_until_event(time.monotonic_ns() + for_ns, self.outputs, publish_ns, max_batch)

    def write(self, data):
        os.write(self.writer, data)

    @property
    def samples(self):
        return int(self.pipeline.record["count"][0])


def test_what_comes_is_published_and_python_is_not_returned_to(rig):
    rig.begin()

    def write():
        for _ in range(100):
            rig.frames(1)
            time.sleep(1e-3)

    writing = threading.Thread(target=write)  # the cycle lets other threads run
    writing.start()
    assert rig.turn(for_ns=500_000_000, max_batch=BATCH) == 0
    writing.join()
    rig.turn(max_batch=BATCH)
    assert rig.samples == 102
    assert [next(rig.states).seq for _ in range(100)] == list(range(3, 103))


def test_solutions_are_those_of_the_same_bytes_given_by_python(rig):
    other = attitude_pipeline()
    for at in range(0, 22_000, 50):
        rig.write(WIRE[at : at + 50])
        assert rig.turn(for_ns=0) == 0
        last_ns = int(
            rig.pipeline.record["last_data_ns"][0]
        )  # of the reading that completed a frame, as each does here
        other.rx[other.fill : other.fill + 50] = np.frombuffer(WIRE[at : at + 50], np.uint8)
        n = other.ingest(50, last_ns)
        assert rig.pipeline.solutions[:n].tobytes() == other.solutions[:n].tobytes()
        for _ in range(n):
            state = next(rig.states)
        assert (state.seq, state.t_ns) == (rig.samples, int(other.solutions[n - 1]["t_ns"]))
        assert abs(state.utc_s - time.time()) < 60.0
    assert rig.samples == 1000


def test_bytes_are_timed_after_they_are_read(monkeypatch):
    """A read may take its time on a busy machine: late bytes must not seem early. The kernel as plain Python."""
    now_ns, arrivals = 0, []

    def read_slowly(fd, at, room):
        nonlocal now_ns
        now_ns += 7
        return 22

    def ingest(pipeline, received, arrival_ns):
        arrivals.append(arrival_ns)
        return 1

    fakes = {
        "epoll_wait": lambda *_: 1,
        "set_timer": lambda *_: None,
        "clock_ns": lambda *_: now_ns,
        "read": read_slowly,
        "ingest": ingest,
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(f"imud.daemon.fast_loop.{name}", fake)
    fast_loop = SimpleNamespace(fd=0, epoll=0, timer=0, more=0, events_address=0, time_address=0, check_ns=NEVER_NS)
    pipeline = SimpleNamespace(rx=0, fill=0)
    assert interpreted(_run_until_event)([fast_loop], [pipeline], None, NEVER_NS, NEVER_NS, 0) == 1
    assert arrivals == [7]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 300), min_size=1, max_size=30))
def test_any_chunks_give_every_sample_once(chunks):
    pipeline = attitude_pipeline()
    with (
        contextlib.closing(FastLoop()) as fast_loop,
        contextlib.closing(BinaryOutputs(Settings(), fast_loop.others, 256)) as none,
    ):
        reader, writer = os.pipe()
        fast_loop.attach(reader, pipeline, STALE_NS)
        at = 0
        for size in chunks:
            os.write(writer, WIRE[at : at + size])
            fast_loop.run_until_event(0, none, NEVER_NS, 255)
            at += size
        os.close(reader)
        os.close(writer)
    assert pipeline.record["count"][0] == (at // 22 if at >= 44 else 0)
    assert pipeline.decoder["lost"][0] == 0
    assert pipeline.decoder["junk"][0] == 0 or at < 44  # a frame alone may be junk


def test_a_late_batch_is_left_to_be_judged(rig):
    rig.begin()
    rig.frames(100)
    assert rig.turn(max_batch=99) == 100
    rig.frames(1)
    rig.turn()
    assert next(rig.states).seq == 103  # nobody published the others
    assert rig.outputs.stream.dropped == 0


def test_more_bytes_than_one_reading_takes_are_all_read_though_no_others_come(rig):
    rig.begin()
    rig.frames(300)  # 6600 bytes
    rig.turn(max_batch=BATCH, for_ns=500_000_000)
    assert rig.samples == 302


def test_bytes_left_by_a_turn_that_ended_are_read_in_the_next(rig):
    rig.begin()
    rig.frames(300)
    first, second = rig.turn(for_ns=LONG_NS, max_batch=9), rig.turn(for_ns=LONG_NS, max_batch=9)
    assert first > 100 and second > 100 and first + second == 300


def test_a_solution_that_is_to_be_shown_comes_back_published(rig):
    rig.begin()
    rig.frames(1)
    assert rig.turn(for_ns=LONG_NS, publish_ns=0) == PUBLISH_DUE
    assert next(rig.states).seq == 3


def test_bytes_without_a_frame_are_nothing_to_show(rig):
    rig.write(b"\xff" * 100)
    assert rig.turn(publish_ns=0) == 0


def test_the_end_of_a_line_is_reported(rig):
    rig.frames(2)
    os.close(rig.writer)
    assert rig.turn(for_ns=LONG_NS) == FAILED
    assert rig.samples == 2


def test_another_descriptor_ends_the_turn_after_what_the_line_has(rig):
    rig.begin()
    rig.states.set_divisor(10)
    rig.frames(1)
    assert rig.turn(for_ns=LONG_NS) == 0
    assert rig.samples == 3
    fd, _ = rig.fast_loop.others.poll(0)[0]
    rig.outputs.stream.on_event(fd)
    rig.frames(30)
    rig.turn()
    assert [next(rig.states).seq for _ in range(3)] == [10, 20, 30]


def test_a_signal_ends_the_turn(rig):
    caught = []
    before = signal.signal(signal.SIGALRM, lambda *_: caught.append(time.monotonic_ns()))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        assert rig.turn(for_ns=LONG_NS) == 0
    finally:
        signal.signal(signal.SIGALRM, before)
    assert len(caught) == 1


def test_a_client_that_went_is_no_loss_to_anybody(rig):
    rig.begin()
    rig.states.close()
    rig.frames(50)
    rig.turn()
    assert rig.outputs.stream.dropped == 0
    rig.outputs.stream.on_event(rig.fast_loop.others.poll(0)[0][0])
    assert rig.outputs.stream.clients == 0


def test_without_a_line_it_waits_for_the_others(rig):
    rig.fast_loop.detach()
    rig.frames(2)
    begin_ns = time.monotonic_ns()
    assert rig.turn() == 0
    assert time.monotonic_ns() - begin_ns >= SOON_NS
    assert rig.samples == 0


def test_python_gets_a_changed_status_at_the_next_check_and_once(rig):
    rig.begin()
    now_ns = time.monotonic_ns()
    rig.fast_loop.note(now_ns)
    rig.pipeline.solutions["status"] ^= ATTITUDE_VALID
    assert rig.turn(for_ns=LONG_NS) == 0
    later_ns = time.monotonic_ns()
    assert now_ns + CHECK_NS <= later_ns < now_ns + LONG_NS
    assert rig.fast_loop.check_failed(later_ns)
    rig.fast_loop.note(later_ns)
    assert not rig.fast_loop.check_failed(later_ns)
    rig.turn(for_ns=3 * CHECK_NS)
    assert time.monotonic_ns() >= later_ns + 3 * CHECK_NS


def test_bits_that_are_not_watched_do_not_return_to_python(rig):
    rig.begin()
    begin_ns = time.monotonic_ns()
    rig.fast_loop.note(begin_ns)
    rig.pipeline.solutions["status"] ^= AT_REST
    rig.turn(for_ns=3 * CHECK_NS)
    assert time.monotonic_ns() >= begin_ns + 3 * CHECK_NS


def test_python_gets_a_silent_sensor(rig):
    rig.fast_loop.detach()
    rig.fast_loop.attach(rig.reader, rig.pipeline, stale_ns=2 * CHECK_NS)
    rig.begin()
    rig.fast_loop.note(time.monotonic_ns())
    begin_ns = int(rig.pipeline.record["last_data_ns"][0])
    assert rig.turn(for_ns=LONG_NS) == 0
    assert begin_ns + 2 * CHECK_NS < time.monotonic_ns() < begin_ns + LONG_NS


def test_python_gets_a_time_in_which_the_process_stood_still(rig):
    rig.begin()
    now_ns = time.monotonic_ns()
    rig.fast_loop.note(now_ns - CHECK_NS - PAUSE_NS)
    assert rig.turn(for_ns=LONG_NS) == 0
    later_ns = time.monotonic_ns()
    assert rig.fast_loop.check_failed(later_ns)
    assert rig.fast_loop.note(later_ns) == later_ns - (now_ns - CHECK_NS - PAUSE_NS)


@pytest.mark.parametrize("frame", [b"#\2\0\2\0\2\xcd$", b"0 0 9\n"], ids=["binary", "shortest line"])
def test_the_densest_stream_does_not_pile_up_in_the_buffer(frame):
    configured = ImuConfigured(Identity("seraccel", ""), 100.0, 10_000_000, 0, 0)
    driver, standard = by_name("seraccel"), Settings()
    pipeline = InertialPipeline(
        driver, driver.new_state(configured), Filter(registry.by_name("tilt"), standard, Initial(), 100.0)
    )
    pipeline.restart(driver.new_state(configured), configured, first_flags=0)
    whole = frame * (20 * READ_BYTES // len(frame))
    ours, device = os.pipe()
    with contextlib.closing(FastLoop()) as fast_loop:
        outputs = BinaryOutputs(standard, fast_loop.others, BATCH)
        fast_loop.attach(ours, pipeline, STALE_NS)
        for at in range(0, len(whole), READ_BYTES):
            os.write(device, whole[at : at + READ_BYTES])
            fast_loop.run_until_event(0, outputs, NEVER_NS, BATCH)
            assert pipeline.fill <= PARTIAL
    os.close(ours)
    os.close(device)
    assert int(pipeline.record["count"][0]) == pytest.approx(len(whole) // len(frame), abs=1)
