"""The golden traces vouch only for the lines that they run: that is nearly all of the estimators' kernels."""

import pytest
from golden_coverage import LEAST_PERCENT, counts, percent, unexplained
from same_bits import LARGER, digest

from imud.compile import build

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def counts_and_digests():
    try:
        return counts()
    except build.CannotBuildError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def counted(counts_and_digests):
    return counts_and_digests[0]


def test_the_golden_traces_run_nearly_all_lines(counted):
    assert percent(counted) >= LEAST_PERCENT


def test_lines_that_they_do_not_run_have_a_reason(counted):
    """New code that no recording reaches needs one in a file `golden_*.py`; or else a reason."""
    assert [f"{line.path}:{line.number}: {line.text}" for line in unexplained(counted)] == []


@pytest.mark.parametrize("name", LARGER)
def test_the_library_that_counts_gives_the_same_bits(counts_and_digests, name):
    assert counts_and_digests[1][name] == digest(name)
