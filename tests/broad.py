"""The attitude filter for `../shared/data/score_attitude.py`: z-up sensor axes in, sensor-to-earth quaternions out.

Usage: score_attitude.py broad:attitude, with this folder on the path.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from replay_in_process import new_filter, replay

from imud.configuration.settings import Imu, Initial, Settings
from imud.drivers.sample import SAMPLE
from imud.math.arrays import Floats

HALF_TURN_ABOUT_X = np.array([1.0, -1.0, -1.0])  # z-up axes to FRD and back; a quaternion's vector part turns with them


def samples_of(t: Floats, w: Floats, f: Floats) -> NDArray[np.void]:
    """Samples (SAMPLE) at times t in s with rates w (N, 3) and specific forces f (N, 3), FRD."""
    samples = np.zeros(len(t), SAMPLE)
    samples["t_ns"] = np.round((t - t[0]) * 1e9).astype(np.int64) + 1_000_000_000
    samples["tick"] = np.arange(len(t))
    samples["w"], samples["f"], samples["temperature"] = w, f, np.nan
    return samples


def filter_of(samples: NDArray[np.void], profile: str = "auto", initial: Initial | None = None):
    """A fresh attitude filter for these samples."""
    return new_filter("attitude", samples, Settings(imu=Imu(profile=profile)), initial)


def solutions_of(samples: NDArray[np.void], profile: str = "auto", initial: Initial | None = None) -> NDArray[np.void]:
    """Every sample's solution from a fresh filter."""
    return replay(filter_of(samples, profile, initial), samples)[0]


def with_profile(profile: str) -> Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]:
    def filtered(t: Floats, gyr: Floats, acc: Floats) -> tuple[Floats, Floats]:
        out = solutions_of(samples_of(t, gyr * HALF_TURN_ABOUT_X, acc * HALF_TURN_ABOUT_X), profile)
        return out["q_nb"] * np.concatenate([[1.0], HALF_TURN_ABOUT_X]), out["bg"] * HALF_TURN_ABOUT_X

    return filtered


attitude = with_profile("auto")
