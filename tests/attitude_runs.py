"""Runs of the attitude filter on simulated sensors, and what tests demand of their solutions."""

import numpy as np
from attitude_simulation import DEG, Flaws, after, measure, simulate, wobble
from broad import samples_of
from scipy.spatial.transform import Rotation

from imud.estimators.records import SOLUTION

PROFILE_NAMES = ("m-g350", "consumer-mems")
UNKNOWN = ("lat", "lon", "height", "v", "sigma_p", "sigma_v")
KNOWN = tuple(name for name in SOLUTION.names if name not in UNKNOWN)
FLAWLESS = Flaws()  # but for the M-G350's noise


class Fields:
    """The fields of a record as attributes, also one that is named as an attribute of numpy's."""

    def __init__(self, record):
        object.__setattr__(self, "record", record)

    def __getattr__(self, name):
        value = self.record[name]
        return Fields(value) if value.dtype.names else value

    def __setattr__(self, name, value):
        self.record[name] = value


def samples_from(truth, flaws=FLAWLESS, seed=0):
    w, f = measure(truth, flaws, np.random.default_rng(seed))
    return samples_of(truth.t, w, f)


def still_then_moving(seconds=30.0, rate_hz=100.0):
    truth = simulate(seconds, rate_hz, after(5.0, wobble(1, 0.5)), rpy_deg=(10.0, 5.0, 0.0))
    return truth, samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3))


def rpy_deg(out):
    return Rotation.from_quat(out["q_nb"][:, [1, 2, 3, 0]]).as_euler("ZYX", degrees=True)[:, ::-1]


def tilt_variance_deg2(out):
    """Sum of the variances of the two components of tilt, from the sigmas of roll and pitch."""
    q = out["q_nb"]
    cosine2 = 1.0 - (2.0 * (q[:, 0] * q[:, 2] - q[:, 1] * q[:, 3])) ** 2
    return np.degrees(1.0) ** 2 * (out["sigma_rpy"][:, 1] ** 2 + out["sigma_rpy"][:, 0] ** 2 * cosine2)


def yaw_sigma_deg(out):
    return np.degrees(out["sigma_rpy"][:, 2])


def assert_whole(out):
    """Every known field is finite, every unknown one NaN, quaternions have unit length."""
    for name in KNOWN:
        assert np.all(np.isfinite(out[name])), name
    for name in UNKNOWN:
        assert np.all(np.isnan(out[name])), name
    np.testing.assert_allclose(np.linalg.norm(out["q_nb"], axis=1), 1.0, atol=1e-12)
