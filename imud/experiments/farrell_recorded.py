"""Farrell's claims on a user's recording of a sensor at rest.

The samples are turned level by the tilt of the first one, as the live estimator does, and run axis by axis. What the
tilt has absorbed of a level bias is not in the first residual; along the vertical it is as he has it.
"""

import math

import numpy as np

from ..compile.jit import interpreted
from ..configuration.settings import Initial
from ..estimators.papers import stationary
from ..math.arrays import Floats
from ..math.earth import STANDARD_GRAVITY, gravity
from ..math.rotation import quat_of_gravity, quat_rotate
from ..sensor_errors.profiles import Profile, profile_of
from ..setup import config
from .farrell import drift_rows, filtered
from .farrell_figures import SETTLED, drift_figure, residual_figure, state_figure
from .recorded import Recorded
from .report import Report, Row, at_most, rms, within
from .runs import AxisRun
from .simulate import samples_of
from .whiteness import CHI2_99, KS_99, LAGS, ljung_box, normal_distance

AXES = ("level x", "level y", "vertical")
LONGEST_S = 600.0  # his recording's length or more; of a longer one the beginning is taken
MOVED = 5.0  # normalised residuals beyond it are no noise


def level(data: Recorded, g: float) -> tuple[Floats, Floats]:
    """Time in s and forces, (n, 3), in level axes, gravity made the standard one, which the filter removes."""
    samples = data.samples[np.isfinite(data.samples["f"]).all(axis=1)]
    t = (samples["t_ns"] - samples["t_ns"][0]) * 1e-9
    samples, t = samples[t <= LONGEST_S], t[t <= LONGEST_S]
    q = interpreted(quat_of_gravity)(*samples["f"][0].tolist())
    turn = np.array([interpreted(quat_rotate)(q, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))])
    return t, samples["f"] @ turn + [0.0, 0.0, g - STANDARD_GRAVITY]


def _gravity(initial: Initial) -> tuple[float, str]:
    """m/s^2, and by what it is known."""
    if initial.lat_deg is None:
        return STANDARD_GRAVITY, "standard; --set initial=lat_deg=…"
    return gravity(math.radians(initial.lat_deg), initial.height_m or 0.0), f"at {initial.lat_deg:g} deg"


def axis_rows(name: str, run: AxisRun, reckoned: AxisRun, bias: float, profile: Profile) -> list[Row]:
    """His claims, on one axis."""
    eta, n = run.normalised, len(run.residual)
    if n <= SETTLED + LAGS:
        return [Row(f"{name}: measurements", "", f"{n}: too few to judge; record at rest for longer")]
    moved = int(np.count_nonzero(np.abs(eta[1:]) > MOVED))
    rows = drift_rows(reckoned, bias, profile)
    rows += [
        within("position σ at the first measurement", "≈ 4 cm", run.residual_sigma[0], 0.035, 0.045, "m"),
        at_most("position σ at any later one", "a few mm", run.residual_sigma[SETTLED:].max(), 0.005, "m"),
        at_most("RMS residual after the transient", "< 1 mm", rms(run.residual[SETTLED:]), 1e-3, "m"),
        at_most("RMS of the normalised residual", "less than 1", rms(eta), 1.0),
        at_most("Ljung-Box of 20 lags (99 %)", "no obvious correlation", ljung_box(eta), CHI2_99),
        at_most("KS distance to N(0,1) (99 %)", "standard normal", normal_distance(eta), KS_99 / math.sqrt(n)),
        Row(f"residuals beyond {MOVED:g} σ: it moved", "at rest", f"{moved} of {n}", moved == 0),
    ]
    if name == AXES[2]:
        first = abs(float(eta[0]))
        rows.append(within("the first residual, |r| / σ", "one large value, 4 cm", first, 0.0, 3.0))
    return [Row(f"{name}: {row.quantity}", row.paper, row.ours, row.holds) for row in rows]


def reproduce(data: Recorded) -> Report:
    """His table and figures from the recording."""
    g, known = _gravity(config.initial_of(data.settings))
    t, f = level(data, g)
    samples = samples_of(t, np.zeros_like(f), f)
    profile = profile_of(data.settings)
    design = stationary.configure(data.settings, data.rate_hz)
    rows = [
        Row("recording", "a minute or more at rest", f"{data.name}: {t[-1]:.1f} s at {data.rate_hz:.6g} Hz"),
        Row("gravity", "", f"{g:.5f} m/s² ({known})"),
        Row("√Q_n", "6.67e-4 (m/s)/√s", f"{math.sqrt(design['accel_psd'][0]):.3g} ({data.settings.imu.profile})"),
        Row("σ_b", "7.845e-2 m/s²", f"{math.sqrt(design['bias_var'][0]):.4g} m/s²"),
    ]
    drawn = []
    for axis, name in enumerate(AXES):
        u = f[:, axis] + (STANDARD_GRAVITY if axis == 2 else 0.0)
        bias = -float(np.mean(u[t > t[-1] - 1.0]))
        truth = np.full(len(t), bias)
        run = filtered(samples, truth, axis=axis, design=design)
        reckoned = filtered(samples, truth, measured=False, axis=axis, design=design)
        rows += axis_rows(name, run, reckoned, bias, profile)
        if len(run.residual) > SETTLED + LAGS:
            drawn += [
                residual_figure(f"Fig. 1: residuals, {name}", run),
                state_figure(f"Fig. 2: state errors ±σ, {name} (bias against its last second)", run),
                drift_figure(reckoned, name),
            ]
    return Report(f"Farrell, Simple Kalman Filter, on {data.name}", rows, drawn, ours=False)
