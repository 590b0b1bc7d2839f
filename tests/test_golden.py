"""Every estimator still gives its golden traces; after a change that was meant: `python tests/golden.py`."""

import numpy as np
import pytest
from golden import CLASSES, FOLDER, differences, read, traced

from imud.estimators.registry import NAMES

every_class = pytest.mark.parametrize("name", CLASSES)


def scaled(by):
    """Rates and forces as another processor might leave them, or another algorithm."""

    def disturb(samples):
        samples["w"] *= 1.0 + by
        samples["f"] *= 1.0 + by
        return samples

    return disturb


@every_class
def test_the_trace_is_the_golden_one(name):
    assert differences(read(name), traced(name)) == []


@pytest.mark.thorough
@every_class
def test_it_survives_rounding(name):
    """The comparison is loose enough for the last bits of a processor."""
    assert differences(read(name), traced(name, disturb=scaled(1e-13))) == []


@pytest.mark.parametrize("name", NAMES)
def test_it_survives_no_change_of_the_algorithm(name):
    """And tight enough for a change of one in 1000."""
    golden = read(name)
    if name == "gps-track":  # looks at fixes only
        golden["v_mps_0"] = golden["v_mps_0"] * 1.001
        assert differences(golden, traced(name)) != []
    else:
        assert differences(golden, traced(name, disturb=scaled(1e-4))) != []


def test_each_file_is_the_trace_of_a_class():
    assert {path.stem for path in FOLDER.glob("*.csv")} == set(CLASSES)


def test_differences_are_named():
    golden = read("tilt")
    other = {name: values.copy() for name, values in golden.items()}
    other["rpy_deg_1"][3] += 0.01
    other["srpy_deg_0"][5] = np.nan
    said = differences(golden, other)
    assert [text.split()[0] for text in said] == ["srpy_deg_0", "rpy_deg_1"]
    del other["status"]
    assert differences(golden, other) == ["columns ['status'] or their order"]
