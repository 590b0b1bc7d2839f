"""What the filters of the papers made of a recording, sample by sample, for tables and figures."""

from dataclasses import dataclass

import numpy as np

from ..math.arrays import Floats
from .report import rms


@dataclass(frozen=True)
class AxisRun:
    """One axis through Farrell's filter: states and sigmas at every sample, residuals once per second."""

    t: Floats  # s
    states: Floats  # (n, 3) p, v, b
    sigmas: Floats  # (n, 3)
    truth: Floats  # (n, 3)
    residual: Floats  # m, r_k
    residual_sigma: Floats  # m, sqrt(S_k)

    @property
    def normalised(self) -> Floats:
        return self.residual / self.residual_sigma


@dataclass(frozen=True)
class AttitudeRun:
    """One of Suh's filters on one recording, at its steps: angles and sigmas in deg, columns pitch and roll; r1, r2."""

    t: Floats
    angles: Floats
    sigmas: Floats
    r: Floats

    def rms_deg(self, axis: int) -> float:
        return rms(self.angles[:, axis])

    def largest_deg(self, axis: int) -> float:
        return float(np.max(np.abs(self.angles[:, axis])))


@dataclass(frozen=True)
class LoopRun:
    """Prasanna's table-top loop as he plots it; m, columns north, east, down."""

    t: Floats
    truth: Floats
    measured: Floats
    predicted: Floats
    estimated: Floats
    acceleration: Floats
    acceleration_sigma: Floats
    true_acceleration: Floats
    reckoned_sigma: Floats
    sigma: Floats
    literal: Floats
    literal_sigma: Floats
