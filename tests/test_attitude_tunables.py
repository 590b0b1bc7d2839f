"""The attitude filter at both ends of the range of every tunable: it may be worse, but it stays a filter."""

from functools import cache

import numpy as np
import pytest
from attitude_runs import assert_whole, samples_from
from attitude_simulation import DEG, Flaws, after, simulate, wobble

from imud.configuration.settings import Attitude, Initial, Settings
from imud.drivers.sample import SATURATED, SUSPECT
from imud.estimators import registry
from imud.estimators.records import SOLUTION
from imud.pipeline import Filter

ESTIMATOR = registry.by_name("attitude")
LSB = 2000.0 * DEG / 2**15


@cache
def eventful():
    """A rest and motion, truncated readings, a saturated sensor, damaged samples, no force, two gaps."""
    truth = simulate(32.0, 100.0, after(8.0, wobble(1, 0.5)), after(8.0, wobble(2, 1.0, 1.0, 4.0)))
    samples = samples_from(truth, Flaws(gyro_bias=(0.2 * DEG, -0.1 * DEG, 0.0)))
    samples["w"] = np.trunc(samples["w"] / LSB) * LSB
    samples["flags"][1500:1600] = SATURATED
    samples["flags"][2000:2050] = SUSPECT
    samples["f"][2300:2350] = np.nan
    return np.delete(samples, np.r_[2600:2630, 2800:3000])


@pytest.mark.parametrize("end", ["least", "most"])
@pytest.mark.parametrize("tunable", ESTIMATOR.tunables, ids=lambda tunable: tunable.name)
def test_every_value_of_a_tunable_gives_finite_solutions(tunable, end):
    samples = eventful()
    settings = Settings(attitude=Attitude(tuning={tunable.name: getattr(tunable, end)}))
    filter_ = Filter(ESTIMATOR, settings, Initial(), 100.0)
    out = np.zeros(len(samples), SOLUTION)
    filter_.run(samples, out)
    assert_whole(out)
