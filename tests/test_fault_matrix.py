"""Every aiding source with every fault leaves the rest unharmed: `fault_matrix.py` beside limits for each cell."""

from functools import cache

import pytest
from fault_matrix import FAULTS, SOURCES, cell, harm

MOST = 2.0  # times the RMS error without the source


@cache
def alone(seed):
    return cell(seed)


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_source_harms_little_and_is_never_believed_wrongly(name, fault):
    found = cell(1, name, fault)
    ratio, worst = harm(found, alone(1))
    assert found.sure_s == 0.0, found.worst
    assert ratio < MOST, worst


@pytest.mark.parametrize("name", SOURCES)
def test_without_a_fault_each_source_is_honest(name):
    found = cell(1, name)
    assert found.sure_s == 0.0 and harm(found, alone(1))[0] < 1.1
