"""Shared by all tests: where kernels are cached, Hypothesis without deadlines (kernels compile), the recordings."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from imud.estimators import registry
from imud.process import runtime

runtime.prepare()
# in CI the same examples each time, so that a failure can be repeated; elsewhere chance looks for new ones
settings.register_profile("imud", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("imud")

_LARGE = ("navigation", "ins9", "gps-track")  # these take as long to compile as all the others

SHARED = Path(__file__).resolve().parents[2] / "shared"


def pytest_configure(config):
    """In CI compile before the workers start: two that need the same kernel at once would both compile it."""
    if "CI" in os.environ and not hasattr(config, "workerinput"):
        others = [name for name in registry.NAMES if name not in _LARGE]
        command = [sys.executable, "-m", "imud", "warmup"]
        halves = [[*command, *(f"--estimator={name}" for name in names)] for names in (_LARGE, others)]
        for compiling in [subprocess.Popen(half, stdout=subprocess.DEVNULL) for half in halves]:
            compiling.wait()


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real recordings with ground truth; skips where it is absent."""
    if not (SHARED / "data").is_dir():
        pytest.skip("no recordings: ../shared/data is absent")
    return SHARED / "data"


@pytest.fixture
def make_loop():
    """Makes gpsd servers with a loop around each; ends them with the test."""
    from gpsd_loop import Loop  # only after runtime.prepare()

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
