"""The golden traces vouch only for the lines that they run: that is nearly all of the estimators' kernels."""

import pytest
from golden_coverage import LEAST_PERCENT, counts, percent, unexplained

from imud.compile import build

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def counted():
    try:
        return counts()
    except build.CannotBuildError as error:
        pytest.skip(str(error))


def test_the_golden_traces_run_nearly_all_lines(counted):
    assert percent(counted) >= LEAST_PERCENT


def test_lines_that_they_do_not_run_have_a_reason(counted):
    """New code that no recording reaches needs one in a file `golden_*.py`; or else a reason."""
    assert [f"{line.path}:{line.number}: {line.text}" for line in unexplained(counted)] == []
