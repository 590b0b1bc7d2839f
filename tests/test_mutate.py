"""The golden traces notice when a tunable changes: some of them here, all of them by `python tests/mutate.py`."""

import zlib

import pytest
from mutate import NOT_NOTICED, Search, mutants

EVERY = 12  # by their names, so that a new tunable does not change which of the others are tried
SOME = [mutant for mutant in mutants() if mutant.reason is None and zlib.crc32(mutant.name.encode()) % EVERY == 0]


@pytest.fixture(scope="module")
def search():
    return Search()


@pytest.mark.thorough
@pytest.mark.parametrize("mutant", SOME, ids=[mutant.name for mutant in SOME])
def test_a_tunable_that_changes_moves_a_golden_trace(search, mutant):
    """A new tunable needs a recording in which it matters; or else a reason in `NOT_NOTICED`."""
    assert mutant.value != mutant.tunable.default
    assert mutant.tunable.accepts(mutant.value)
    assert search.noticed_by(mutant) is not None


def test_reasons_are_of_tunables():
    assert set(NOT_NOTICED) <= {mutant.name for mutant in mutants()}
