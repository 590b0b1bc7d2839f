"""Shared by all tests: where kernels are cached, Hypothesis without deadlines (kernels compile), the recordings."""

from pathlib import Path

import pytest
from hypothesis import settings

from imud import runtime

runtime.prepare()
settings.register_profile("imud", deadline=None)
settings.load_profile("imud")

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real recordings with ground truth; skips where it is absent."""
    if not (SHARED / "data").is_dir():
        pytest.skip("no recordings: ../shared/data is absent")
    return SHARED / "data"
