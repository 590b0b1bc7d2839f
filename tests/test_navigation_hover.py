"""Noise of the accelerometers is no force that shows the heading: a multicopter that hovers, vibrating."""

import numpy as np
import pytest
from navigation_runner import navigate, settings_of
from navigation_simulation import moved, received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Initial

RATE, SECONDS, SHAKEN = 100, 90.0, 0.25


@pytest.mark.parametrize("seed", range(3))
def test_vibration_does_not_confirm_the_heading_of_a_craft_that_hovers(seed):
    """It has the heading that it was given, with 5 degrees. Shaken by SHAKEN m/s/sqrt(s), it stays where it is, so
    nothing shows the heading. With the measured force in the transition matrix noise confirmed it to 2 degrees.
    """
    rng, t = np.random.default_rng(seed), np.arange(int(SECONDS * RATE)) / RATE
    d = moved(t, np.zeros((len(t), 3)), Rotation.from_euler("ZYX", np.zeros((len(t), 3))))
    samples = sensed(d, rng)
    samples["f"][t > 8.0] += SHAKEN * RATE**0.5 * rng.standard_normal(((t > 8.0).sum(), 3))
    fixes = received(d, rng, every=0.2, late=0.05, sigma=0.0, white=0.015)
    fixes["speed"] = fixes["course"] = fixes["hdop"] = np.nan
    fixes["sigma"], fixes["v"] = (0.02, 0.02, 0.04), 0.02 * rng.standard_normal((len(fixes), 3))
    out = navigate(samples, fixes, settings_of("free"), Initial(yaw_deg=10.0))[0]
    assert np.degrees(out["sigma_rpy"][-1, 2]) > 4.0
