"""Farrell, Simple Kalman Filter: Design Example. Numbers and figures of his solutions, on two simulated sensors.

`model` data obey his equations (3) and (4) with his Q_n and Q_omega, so every claim of the theory must hold on them;
`m-g350` data have the data sheet's much steadier bias, like the sensor behind his figures, and show what he reports:
lines and parabolas of dead reckoning, and a normalised residual below 1, because Q_omega is larger than the bias's
random walk.
"""

import math
from typing import Any

import numpy as np

from ..compile.jit import kernel
from ..configuration.settings import Imu, Initial, Noise, Settings
from ..estimators.papers import stationary
from ..estimators.papers.stationary import BIAS, POSITION, STATES, VELOCITY
from ..estimators.records import SOLUTION
from ..math.arrays import Floats
from ..math.kalman import packed_index, scale, shear, unpack
from ..sensor_errors.profiles import Profile, profile_of
from .farrell_figures import SETTLED, drift_figure, residual_figure, state_figure
from .farrell_open_ends import drawn_rows, open_end_rows
from .report import Report, Row, at_most, rms, within
from .runs import AxisRun
from .simulate import IN_RUN_S, PROFILE, level_at_rest, m_g350, samples_of
from .whiteness import CHI2_99, KS_99, ljung_box, normal_distance

RATE_HZ, SECONDS = 1000.0, 600
Q_N = 4.4e-7  # (m/s)^2/s
NEVER_NS = 10**15
PRINTED_PHI = ((1.0, 1.0, 0.4998), (0.0, 1.0, 0.9995), (0.0, 0.0, 0.9990))
PRINTED_QD = ((0.5464, 1.2193, 1.3320), (1.2193, 3.1047, 3.9960), (1.3320, 3.9960, 7.9920))  # 1e-6


def parameters() -> Any:
    """His numbers."""
    p = stationary.configure(Settings(imu=Imu(profile="m-g350")), RATE_HZ)
    p["accel_psd"] = Q_N
    return p


def discrete(steps: int) -> tuple[Floats, Floats]:
    """Phi and Q_d over 1 s, accumulated from `steps` steps of the filter's own arithmetic."""
    p, T = parameters(), 1.0 / steps
    to_p, to_v, to_b = stationary.transition(p["bias_rate"][0], T)
    one = np.array([[1.0, T, to_p], [0.0, 1.0, to_v], [0.0, 0.0, to_b]])
    phi, packed = np.eye(STATES), np.zeros(6)
    for _ in range(steps):
        phi = one @ phi
        shear(packed, STATES, POSITION, VELOCITY, T)
        shear(packed, STATES, POSITION, BIAS, to_p)
        shear(packed, STATES, VELOCITY, BIAS, to_v)
        scale(packed, STATES, BIAS, to_b)
        stationary.add_process_noise(p[0], T, packed)
    return phi, np.asarray(unpack(packed, STATES))


@kernel
def _record(p: Any, s: Any, samples: Any, out: Any, axis: int, states: Any, sigmas: Any, residuals: Any) -> int:
    """Step through the samples and keep an axis: states, sigmas, and a row (r, sqrt(S)) per measurement."""
    count = 0
    for k in range(len(samples)):
        stationary.step(p[0], s[0], samples[k], out[0])
        states[k, 0], states[k, 1], states[k, 2] = s[0].p[axis], s[0].v[axis], s[0].b[axis]
        for i in range(STATES):
            sigmas[k, i] = math.sqrt(s[0].P[packed_index(STATES, i, i)])
        if s[0].measurement_count > count and count < len(residuals):
            residuals[count, 0], residuals[count, 1] = s[0].residual[axis], math.sqrt(s[0].variance)
            count += 1
    return count


def filtered(samples: Any, bias: Floats, measured: bool = True, axis: int = 0, design: Any = None) -> AxisRun:
    """An axis of level samples through his filter, or dead reckoned; `bias` is the truth in his sign.

    design: other parameters than his.
    """
    p = parameters() if design is None else design.copy()
    if not measured:
        p["interval_ns"] = NEVER_NS
    s = stationary.start(p, Initial(roll_deg=0.0, pitch_deg=0.0, yaw_deg=0.0))
    n = len(samples)
    states, sigmas, residuals = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 2))
    count = _record(p, s, samples, np.zeros(1, SOLUTION), axis, states, sigmas, residuals)
    truth = np.column_stack([np.zeros(n), np.zeros(n), bias])
    t = (samples["t_ns"] - samples["t_ns"][0]) * 1e-9
    return AxisRun(t, states, sigmas, truth, residuals[:count, 0], residuals[:count, 1])


def model_samples(rng: np.random.Generator) -> tuple[Any, Floats]:
    """Samples whose x axis obeys (3) and (4): u = a - b - n, b' = -lambda b + omega; and b."""
    n, T = int(SECONDS * RATE_HZ) + 1, 1.0 / RATE_HZ
    decay = math.exp(-parameters()["bias_rate"][0] * T)
    walk = np.sqrt(parameters()["bias_psd"][0] * T) * rng.standard_normal(n)
    walk[0] = math.sqrt(parameters()["bias_var"][0]) * rng.standard_normal()
    powers = decay ** np.arange(n)
    bias = powers * np.cumsum(walk / powers)
    t = np.arange(n, dtype=np.float64) * T
    w, f = level_at_rest(n)
    # sample k stands for the interval that ends at t_k: the bias at its beginning, as the filter propagates it
    f[1:, 0] = -bias[:-1] - np.sqrt(Q_N / T) * rng.standard_normal(n - 1)
    return samples_of(t, w, f), bias


def sheet_samples(rng: np.random.Generator) -> tuple[Any, Floats]:
    """An M-G350 at rest, and the bias of its x axis as the last second shows it.

    He takes the last estimate for it, which Q_omega makes noisier than a second's mean is.
    """
    t = np.arange(int(SECONDS * RATE_HZ) + 1) / RATE_HZ
    samples = m_g350(rng, t, *level_at_rest(len(t)))
    return samples, np.full(len(t), -np.mean(samples["f"][-int(RATE_HZ) :, 0]))


def design_rows() -> list[Row]:
    """Problems 4 to 6, observability, and the numbers of Solution 7."""
    rows = []
    for steps in (1, 1000):
        phi, q_d = discrete(steps)
        how = "T = 1 s" if steps == 1 else "1000 steps of 1 ms"
        for name, printed, ours in (("Φ", PRINTED_PHI, phi), ("Q_d 1e6", PRINTED_QD, 1e6 * q_d)):
            for i in range(3):
                same = bool(np.all(np.abs(np.array(printed[i]) - ours[i]) <= 5.1e-5))
                text = [" ".join(f"{x:.{digits}f}" for x in row[i]) for row, digits in ((printed, 4), (ours, 6))]
                rows.append(Row(f"{name} row {i + 1}, {how}", text[0], text[1], same))
    return [*rows, *_unit_rows(), *_observability_rows()]


def _unit_rows() -> list[Row]:
    """Problems 4 and 5, R and P0: his units in ours."""
    p = stationary.configure(Settings(imu=Imu(profile="m-g350")), RATE_HZ)
    vrw, sigma_b, r = (math.sqrt(p[name][0]) for name in ("accel_psd", "bias_var", "position_var"))
    exercise = profile_of(Settings(noise=Noise(accel_random_walk_mps_per_sqrt_h=0.6))).accel_noise
    return [
        Row(
            "Problem 4: 0.6 (m/s)/√h (printed: /√Hz)",
            "1.0e-2 (m/s)/√s",
            f"{exercise:.1e} (m/s)/√s",
            abs(exercise - 0.01) < 1e-9,
        ),
        Row("VRW 0.04 (m/s)/√h (printed: /√Hz)", "6.67e-4 (m/s)/√s", f"{vrw:.3g} (m/s)/√s", abs(vrw - 6.67e-4) < 5e-7),
        Row("Q_n = VRW²", "4.4e-7", f"{vrw**2:.2g}", f"{vrw**2:.1e}" == "4.4e-07"),
        Row("√R", "1.0e-5 m", f"{r:.1e} m", abs(r - 1e-5) < 1e-12),
        Row("time between measurements", "1.0 s", f"{1e-9 * p['interval_ns'][0]:.1f} s", p["interval_ns"][0] == 10**9),
        Row(
            "σ_b = 8 mg (printed 7.2e-2 is 7.3 mg)",
            "7.2e-2 m/s²",
            f"{sigma_b:.4g} m/s²",
            abs(sigma_b - 7.845e-2) < 5e-6,
        ),
    ]


def _observability_rows() -> list[Row]:
    """Questions 1 and 2: of (H, F) in continuous time, of (H, Phi) after each measurement."""
    F = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -parameters()["bias_rate"][0]]])
    phi, _ = discrete(1)
    ranks = []
    for transition in (F, phi):
        seen = [np.array([[1.0, 0.0, 0.0]])]
        for _ in range(STATES - 1):
            seen.append(seen[-1] @ transition)
        ranks.append([int(np.linalg.matrix_rank(np.vstack(seen[: n + 1]))) for n in range(STATES)])
    counted = ", ".join(map(str, ranks[1]))
    return [
        Row("rank of the observability matrix", "3", str(ranks[0][-1]), ranks[0][-1] == 3),
        Row("rank after 1, 2, 3 measurements", "3 are required", counted, ranks[1] == [1, 2, 3]),
    ]


def drift_rows(reckoned: AxisRun, bias: float, profile: Profile = PROFILE) -> list[Row]:
    """Problem 2: a constant bias in the estimated acceleration, integrated once and twice."""
    span = float(reckoned.t[-1])
    slope = float(np.polyfit(reckoned.t, reckoned.states[:, 1], 1)[0])
    curved = 2.0 * float(reckoned.states[-1, 0]) / span**2
    # the bias's own, and the noise of the second that it is taken from
    change = 3.0 * math.hypot(profile.accel_bias_instability * math.sqrt(span / IN_RUN_S), profile.accel_noise)
    return [
        within("slope of the dead-reckoned velocity", "≈ −b", slope, -bias - change, -bias + change, "m/s²"),
        within("2 p / t² of the dead-reckoned position", "≈ −b", curved, -bias - change, -bias + change, "m/s²"),
    ]


def filter_rows(run: AxisRun, sheet: AxisRun) -> list[Row]:
    """Problem 7 on both data sets."""
    eta, n = run.normalised, len(run.residual)
    error = run.states - run.truth
    covered = float(np.mean(np.abs(error[1:]) <= run.sigmas[1:]))
    first, second = run.sigmas[999, 0], run.residual_sigma[SETTLED:].max()
    bias_left = run.sigmas[1000, 2] / run.sigmas[0, 2]
    spread = 3.0 / math.sqrt(2.0 * n)
    return [
        at_most("σ of the bias after 1 measurement, of σ_b (P0 = 0, 0, σ_b²)", "observable", bias_left, 0.1),
        within("position σ after 1 s without a measurement", "≈ 4 cm", first, 0.035, 0.045, "m"),
        within("the first residual, |r| / σ", "one large value, 4 cm", abs(float(eta[0])), 0.0, 3.0),
        at_most("position σ after any later second", "a few mm, ≪ 4 cm", second, 0.005, "m"),
        within("RMS of the normalised residual, model data", "1", rms(eta), 1.0 - spread, 1.0 + spread),
        at_most("Ljung-Box of 20 lags, model data (99 %)", "white", ljung_box(eta), CHI2_99),
        at_most(
            "KS distance to N(0,1), model data (99 %)", "standard normal", normal_distance(eta), KS_99 / math.sqrt(n)
        ),
        within("share of state errors within ±σ, model data", "0.68", covered, 0.55, 0.80),
        at_most("RMS residual after the transient, M-G350 data", "< 1 mm", rms(sheet.residual[SETTLED:]), 1e-3, "m"),
        Row(
            "Ljung-Box of 20 lags, M-G350 data",
            "no obvious correlation",
            f"{ljung_box(sheet.normalised):.4g}: Q_ω is too large",
        ),
        at_most("RMS of the normalised residual, M-G350 data", "less than 1", rms(sheet.normalised), 1.0),
    ]


def reproduce(seed: int) -> Report:
    """His table and figures."""
    rng = np.random.default_rng(seed)
    run = filtered(*model_samples(rng))
    samples, bias = sheet_samples(rng)
    sheet, reckoned = filtered(samples, bias), filtered(samples, bias, measured=False)
    return Report(
        "Farrell, Simple Kalman Filter: Design Example",
        [
            *design_rows(),
            *drift_rows(reckoned, float(bias[-1])),
            *filter_rows(run, sheet),
            *open_end_rows(samples, sheet, parameters()),
            *drawn_rows(rng),
        ],
        [
            drift_figure(reckoned),
            residual_figure("Fig. 1: residuals, model data", run),
            residual_figure("Fig. 1: residuals, M-G350 data", sheet),
            state_figure("Fig. 2: state errors ±σ, model data", run),
            state_figure("Fig. 2: state errors ±σ, M-G350 data (bias against its last second)", sheet),
        ],
    )
