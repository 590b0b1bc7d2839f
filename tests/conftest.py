"""Shared by all tests: where kernels are cached, Hypothesis without deadlines (kernels compile), the recordings."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from imud.process import runtime

runtime.prepare()
# the same examples each time where a failure must be repeatable: chance looks for new ones at the desk
settings.register_profile("imud", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("imud")

_LARGE = ("navigation", "attitude")  # take most of the time, and about the same

SHARED = Path(__file__).resolve().parents[2] / "shared"


def pytest_configure(config):
    """Where everything is run, compile first: workers that need a kernel at the same time each compile it."""
    if "CI" in os.environ and not hasattr(config, "workerinput"):
        command = [sys.executable, "-m", "imud", "warmup", "--estimator"]
        for compiling in [subprocess.Popen([*command, name], stdout=subprocess.DEVNULL) for name in _LARGE]:
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
