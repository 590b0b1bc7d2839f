"""Every estimator still gives its golden trace; after a change that was meant: `python tests/golden.py`."""

import numpy as np
import pytest
from golden import differences, read, trace

from imud.estimators.registry import NAMES


def scaled(by):
    """Rates and forces as another processor might leave them, or another algorithm."""

    def disturb(samples):
        spoilt = samples.copy()
        spoilt["w"] *= 1.0 + by
        spoilt["f"] *= 1.0 + by
        return spoilt

    return disturb


@pytest.mark.parametrize("name", NAMES)
def test_the_trace_is_the_golden_one(name):
    assert differences(read(name), trace(name)) == []


@pytest.mark.parametrize("name", NAMES)
def test_it_survives_rounding_but_no_change(name):
    """The comparison is loose enough for the last bits of a processor and tight enough for a change of one in 1000."""
    golden = read(name)
    assert differences(golden, trace(name, scaled(1e-13))) == []
    if name == "gps-track":  # looks at fixes only
        golden["v_mps_0"] = golden["v_mps_0"] * 1.001
        assert differences(golden, trace(name)) != []
    else:
        assert differences(golden, trace(name, scaled(1e-4))) != []


def test_differences_are_named():
    golden = read("tilt")
    other = {name: values.copy() for name, values in golden.items()}
    other["rpy_deg_1"][3] += 0.01
    other["srpy_deg_0"][5] = np.nan
    said = differences(golden, other)
    assert [text.split()[0] for text in said] == ["srpy_deg_0", "rpy_deg_1"]
    del other["status"]
    assert differences(golden, other) == ["columns ['status'] or their order"]
