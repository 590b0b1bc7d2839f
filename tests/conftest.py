"""Shared by all tests: compiled kernels, Hypothesis without deadlines (kernels compile), the recordings."""

import contextlib
import gc
import importlib.util
import os
import sys
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is imported: its threads would only wait for each other

import pytest
from hypothesis import HealthCheck, settings

from imud.compile import library, numba_cache

if importlib.util.find_spec("numba"):  # some machines have none: there the kernels come compiled
    numba_cache.prepare()
# each worker, and each process that a test starts, would compile all modules anew
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
slow = [HealthCheck.too_slow]  # under emulation it may be
# in CI the same examples each time, so that a failure can be repeated; elsewhere chance looks for new ones
settings.register_profile("imud", deadline=None, derandomize="CI" in os.environ, suppress_health_check=slow)
settings.load_profile("imud")

SHARED = Path(__file__).resolve().parents[2] / "shared"


# The files that take longest come first: what begins late is waited for at the end. Those of daemons wait most of their
# time, the others compute: so the two kinds alternate, and there are more workers than processors. plugins come last:
# by then same_bits has compiled most of the kernels that numba compiles for their daemon.
FIRST = """
    daemon_spares same_bits faults_daemon golden_coverage recording web_page daemon_spare_restarts daemon golden
    consistency gpsd_fake daemon_seraccel compile_library daemon_spi daemon_receiver_alone mutate daemon_iio
    takeover nmea_mtk notebooks comparison foxglove power_on sensor fault_matrix replay status report c_reference
    sim_ports faults aiding_live probe sim_iio_polled navigation_heading_posterior soak demo calibrate_recordings
    daemon_crossbow fuzz hot_path riss clock navigation_magnetometer ros2_node iio_polled plugins
"""


def pytest_collection_modifyitems(items):
    """Sort by file: FIRST, then the others by name."""
    places = {f"test_{name}.py": place for place, name in enumerate(FIRST.split())}
    items.sort(key=lambda item: (places.get(item.path.name, len(places)), item.path))


def pytest_configure(config):
    """Compile the kernels before the workers start: all of them need them at once."""
    if not hasattr(config, "workerinput"):
        library.library()


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Look for no garbage among the tests and modules: they stay until the end, and it takes a sixth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """Begin with other files in each worker: all collect all of them, and find the bytecode that the others wrote."""
    report = yield
    if isinstance(collector, pytest.Dir) and hasattr(collector.config, "workerinput"):
        worker, workers = int(collector.config.workerinput["workerid"][2:]), collector.config.workerinput["workercount"]
        begin = len(report.result) * worker // workers
        report.result = report.result[begin:] + report.result[:begin]
    return report


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real recordings with ground truth; skips where it is absent."""
    if not (SHARED / "data").is_dir():
        pytest.skip("no recordings: ../shared/data is absent")
    return SHARED / "data"


@pytest.fixture
def papers_as_c(monkeypatch):
    """The loops of `imud reproduce` and the steps that it calls are compiled as C; users have numba for them."""
    from in_c import Module, in_c

    from imud.experiments import farrell, prasanna, suh

    for paper in (farrell, suh):
        monkeypatch.setattr(paper, "_record", in_c(paper._record))
    monkeypatch.setattr(prasanna, "ins9", Module(prasanna.ins9))


@pytest.fixture
def make_loop():
    """Makes gpsd servers with a loop around each; ends them with the test."""
    from gpsd_loop import Loop  # only after numba_cache.prepare()

    with contextlib.ExitStack() as stack:

        def make(**changes) -> Loop:
            loop = Loop(**changes)
            stack.callback(loop.close)
            return loop

        yield make


@pytest.fixture
def loop(make_loop):
    """A gpsd server on a free port."""
    return make_loop()
