"""Tunables: constants of an estimator that `--set ESTIMATOR.tuning.NAME=VALUE` changes without a rebuild."""

import math

import numpy as np
import pytest
from broad import samples_of

from imud.commands.reference import tuning
from imud.configuration.settings import Initial
from imud.drivers.sample import SAMPLE
from imud.errors import ConfigError
from imud.estimators import registry
from imud.estimators.records import SOLUTION
from imud.estimators.tuning import Tunable, dtype_of, problems, values_of
from imud.pipeline import Filter
from imud.setup import config

ESTIMATORS = [registry.by_name(name) for name in registry.NAMES]
TUNED = [estimator for estimator in ESTIMATORS if estimator.tunables]
TABLE = (
    Tunable("time_s", 1.5, "s", "A time.", "A book.", low=0.5, high=3.0),
    Tunable("count", 4, "", "A number of samples.", "A book.", low=1),
)


def test_defaults_and_changes_make_the_record():
    record = np.array([values_of(TABLE, {"count": 7})], dtype_of(TABLE))
    assert (record["time_s"][0], record["count"][0]) == (1.5, 7)
    assert record.dtype["time_s"] == np.float64 and record.dtype["count"] == np.int64


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"time": 1.0}, "no such tunable"),
        ({"time_s": 0.4}, "number from 0.5 to 3 s"),
        ({"time_s": math.nan}, "number"),
        ({"count": 2.5}, "integer from 1 to 4000, not 2.5"),
    ],
)
def test_what_is_not_taken_is_named(changed, said):
    [(name, what)] = problems(TABLE, changed)
    assert name in changed and said in what
    assert list(problems(TABLE, {"time_s": 0.5, "count": 3})) == []


@pytest.mark.parametrize("estimator", TUNED, ids=lambda estimator: estimator.name)
def test_every_tunable_is_described_and_accepts_its_default(estimator):
    assert len({t.name for t in estimator.tunables}) == len(estimator.tunables)
    for tunable in estimator.tunables:
        assert tunable.accepts(tunable.default), tunable.name
        assert tunable.meaning.endswith(".") and tunable.source.endswith("."), tunable.name
        assert f"`{estimator.table}.tuning.{tunable.name}`" in tuning()


def test_a_bad_tunable_in_the_settings_is_reported_with_its_line():
    text = "[attitude.tuning]\ngyro_noise_per_rate = 1e-3\nshock_rotation = -1\nnothing = 2\n"
    with pytest.raises(ConfigError) as caught:
        config.loads(text, name="x.toml")
    assert "x.toml:3: attitude.tuning.shock_rotation: must be a number from 1e-05 to 10 rad/(m/s), not -1" in str(
        caught.value
    )
    assert "x.toml:4: attitude.tuning.nothing: there is no such tunable" in str(caught.value)
    assert "gyro_noise_per_rate" not in str(caught.value)


@pytest.mark.parametrize("value", ["true", "fast", "[1.0]", "nan", "inf", "1e300", "9" * 400])
def test_a_tunable_is_a_finite_number(value):
    with pytest.raises(ConfigError, match=r"attitude\.tuning"):
        config.loads("", [f"attitude.tuning.shock_rotation={value}"])


def test_a_tunable_of_the_settings_reaches_the_kernels():
    def yaw_sigma(*overrides):
        t = np.arange(500) / 100.0
        samples = samples_of(t, np.full((500, 3), 2.0), np.tile([0.0, 0.0, -9.8], (500, 1)))
        out = np.zeros(500, SOLUTION)
        filter_ = Filter(registry.by_name("attitude"), config.loads("", overrides), Initial(), 100.0)
        filter_.run(np.ascontiguousarray(samples, SAMPLE), out)
        return out["sigma_rpy"][-1, 2]

    noisy = "attitude.tuning.gyro_noise_per_rate=0.1"
    assert yaw_sigma(noisy) > 2.0 * yaw_sigma()
