"""Farrell, Simple Kalman Filter: Design Example. Numbers and figures of his solutions, on two simulated sensors.

`model` data obey his equations (3) and (4) with his Q_n and Q_omega, so every claim of the theory must hold on them;
`m-g350` data have the data sheet's much steadier bias, like the sensor behind his figures, and show what he reports:
a normalised residual below 1, because Q_omega promises more wandering than there is.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..configuration.settings import Imu, Initial, Settings
from ..estimators import stationary
from ..estimators.records import SOLUTION
from ..estimators.stationary import BIAS, POSITION, STATES, VELOCITY
from ..figures import Figure, Panel, Trace
from ..kernels.jit import kernel
from ..kernels.kalman import scale, shear, unpack
from .report import Floats, Report, Row, at_most, rms, within
from .simulate import level_at_rest, m_g350, samples_of

RATE_HZ, SECONDS = 1000.0, 600
Q_N = 4.4e-7  # (m/s)^2/s
SETTLED = 10  # residuals of the transient
LAGS = 20
CHI2_99 = 37.57  # 99 % of chi-square with LAGS degrees of freedom
KS_99 = 1.63  # times 1/sqrt(n): 99 % of Kolmogorov and Smirnov's distance
PRINTED_PHI = ((1.0, 1.0, 0.4998), (0.0, 1.0, 0.9995), (0.0, 0.0, 0.9990))
PRINTED_QD = ((0.5464, 1.2193, 1.3320), (1.2193, 3.1047, 3.9960), (1.3320, 3.9960, 7.9920))  # 1e-6
NAMES = (("position", "m"), ("velocity", "m/s"), ("bias", "m/s²"))


@dataclass(frozen=True)
class Run:
    """One axis through the filter: states and sigmas at every sample, residuals once per second."""

    t: Floats  # s
    states: Floats  # (n, 3) p, v, b
    sigmas: Floats  # (n, 3)
    truth: Floats  # (n, 3)
    residual: Floats  # m, r_k
    residual_sigma: Floats  # m, sqrt(S_k)

    @property
    def normalised(self) -> Floats:
        return self.residual / self.residual_sigma


def parameters(interval_s: float = 1.0) -> Any:
    """His numbers; a measurement every `interval_s`."""
    p = stationary.configure(Settings(imu=Imu(profile="m-g350")), RATE_HZ)
    p["accel_psd"], p["interval_ns"] = Q_N, round(interval_s * 1e9)
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
        stationary.process_noise(p[0], T, packed)
    return phi, np.asarray(unpack(packed, STATES))


@kernel
def _record(p: Any, s: Any, samples: Any, out: Any, states: Any, sigmas: Any, residuals: Any) -> int:
    """Step through the samples and keep axis x: states, sigmas, and a row (r, sqrt(S)) per measurement."""
    kept = 0
    for k in range(len(samples)):
        stationary.step(p[0], s[0], samples[k], out[0])
        states[k, 0], states[k, 1], states[k, 2] = s[0].p[0], s[0].v[0], s[0].b[0]
        for i, diagonal in enumerate((0, 3, 5)):
            sigmas[k, i] = math.sqrt(s[0].P[diagonal])
        if s[0].measured > kept and kept < len(residuals):
            residuals[kept, 0], residuals[kept, 1] = s[0].residual[0], math.sqrt(s[0].variance)
            kept += 1
    return kept


def filtered(samples: Any, bias: Floats, interval_s: float = 1.0) -> Run:
    """The samples' x axis through his filter; `bias` is the truth in his sign."""
    p = parameters(interval_s)
    s = stationary.start(p, Initial(roll_deg=0.0, pitch_deg=0.0, yaw_deg=0.0))
    n = len(samples)
    states, sigmas, residuals = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 2))
    kept = _record(p, s, samples, np.zeros(1, SOLUTION), states, sigmas, residuals)
    truth = np.column_stack([np.zeros(n), np.zeros(n), bias])
    t = (samples["t_ns"] - samples["t_ns"][0]) * 1e-9
    return Run(t, states, sigmas, truth, residuals[:kept, 0], residuals[:kept, 1])


def model_samples(rng: np.random.Generator) -> tuple[Any, Floats]:
    """Samples whose x axis obeys (3) and (4): u = a - b - n, b' = -lambda b + omega; and b."""
    n, T = int(SECONDS * RATE_HZ) + 1, 1.0 / RATE_HZ
    decay = math.exp(-stationary.LAMBDA * T)
    walk = np.sqrt(stationary.BIAS_PSD * T) * rng.standard_normal(n)
    walk[0] = math.sqrt(parameters()["bias_var"][0]) * rng.standard_normal()
    powers = decay ** np.arange(n)
    bias = powers * np.cumsum(walk / powers)
    t = np.arange(n, dtype=np.float64) * T
    w, f = level_at_rest(n)
    # sample k stands for the interval that ends at t_k: the bias at its beginning, as the filter propagates it
    f[1:, 0] = -bias[:-1] - np.sqrt(Q_N / T) * rng.standard_normal(n - 1)
    return samples_of(t, w, f), bias


def sheet_samples(rng: np.random.Generator) -> tuple[Any, Floats]:
    """An M-G350 at rest, and the bias of its x axis as the last second shows it (he does the same)."""
    t = np.arange(int(SECONDS * RATE_HZ) + 1) / RATE_HZ
    samples = m_g350(rng, t, *level_at_rest(len(t)))
    return samples, np.full(len(t), -np.mean(samples["f"][-int(RATE_HZ) :, 0]))


def autocorrelation(x: Floats) -> Floats:
    """At lags 1 to LAGS."""
    centred = x - x.mean()
    rho: Floats = np.array([centred[k:] @ centred[:-k] for k in range(1, LAGS + 1)]) / (centred @ centred)
    return rho


def ljung_box(x: Floats) -> float:
    """Ljung and Box's statistic: chi-square with LAGS degrees of freedom if x is white."""
    n, rho = len(x), autocorrelation(x)
    return float(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, LAGS + 1))))


def normal_distance(x: Floats) -> float:
    """Kolmogorov and Smirnov's distance between x and N(0, 1)."""
    ordered = np.sort(x)
    normal = np.array([0.5 * (1.0 + math.erf(v / math.sqrt(2.0))) for v in ordered])
    steps = np.arange(len(x) + 1) / len(x)
    return float(max(np.max(steps[1:] - normal), np.max(normal - steps[:-1])))


def design_rows() -> list[Row]:
    """Problems 4 to 6, and observability (question 1)."""
    rows = []
    for steps in (1, 1000):
        phi, q_d = discrete(steps)
        how = "T = 1 s" if steps == 1 else "1000 steps of 1 ms"
        for name, printed, ours in (("Φ", PRINTED_PHI, phi), ("Q_d 1e6", PRINTED_QD, 1e6 * q_d)):
            for i in range(3):
                same = bool(np.all(np.abs(np.array(printed[i]) - ours[i]) <= 5.1e-5))
                text = [" ".join(f"{x:.{digits}f}" for x in row[i]) for row, digits in ((printed, 4), (ours, 6))]
                rows.append(Row(f"{name} row {i + 1}, {how}", text[0], text[1], same))
    F = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -stationary.LAMBDA]])
    H = np.array([[1.0, 0.0, 0.0]])
    rank = int(np.linalg.matrix_rank(np.vstack([H, H @ F, H @ F @ F])))
    p = stationary.configure(Settings(imu=Imu(profile="m-g350")), RATE_HZ)
    vrw, sigma_b = math.sqrt(p["accel_psd"][0]), math.sqrt(p["bias_var"][0])
    return [
        *rows,
        Row("rank of the observability matrix", "3", str(rank), rank == 3),
        Row("VRW 0.04 (m/s)/√h (printed: /√Hz)", "6.67e-4 (m/s)/√s", f"{vrw:.3g} (m/s)/√s", abs(vrw - 6.67e-4) < 5e-7),
        Row("Q_n = VRW²", "4.4e-7", f"{vrw**2:.2g}", f"{vrw**2:.1e}" == "4.4e-07"),
        Row(
            "σ_b = 8 mg (printed 7.2e-2 is 7.3 mg)",
            "7.2e-2 m/s²",
            f"{sigma_b:.4g} m/s²",
            abs(sigma_b - 7.845e-2) < 5e-6,
        ),
    ]


def filter_rows(run: Run, sheet: Run, reckoned: Run, bias: float) -> list[Row]:
    """Problems 2 and 7 on both data sets."""
    eta, n = run.normalised, len(run.residual)
    error = run.states - run.truth
    covered = float(np.mean(np.abs(error[1:]) <= run.sigmas[1:]))
    slope = float(np.polyfit(reckoned.t, reckoned.states[:, 1], 1)[0])
    span = reckoned.t[-1]
    curved = 2.0 * reckoned.states[-1, 0] / span**2
    first, second = run.sigmas[999, 0], run.residual_sigma[SETTLED:].max()
    bias_left = run.sigmas[1000, 2] / run.sigmas[0, 2]
    spread = 3.0 / math.sqrt(2.0 * n)
    drift = 3.0 * math.sqrt(stationary.BIAS_PSD * span)
    return [
        within("slope of the dead-reckoned velocity", "≈ −b", slope, -bias - drift, -bias + drift, "m/s²"),
        within("2 p / t² of the dead-reckoned position", "≈ −b", curved, -bias - drift, -bias + drift, "m/s²"),
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


def _state_figure(title: str, run: Run) -> Figure:
    panels = []
    for i, (name, unit) in enumerate(NAMES):
        for part, span in (("first 10 s", slice(0, 10_001)), ("last 10 s", slice(-10_000, None))):
            t = run.t[span]
            error = (run.states - run.truth)[span, i]
            trace = Trace(f"{name} error, {part}", t, error, run.sigmas[span, i], np.zeros(len(t)))
            panels.append(Panel(f"{name}, {part}", "time [s]", f"{name} error [{unit}]", [trace]))
    return Figure(title, panels)


def _histogram(values: Floats, sigma: float, name: str) -> list[Trace]:
    counts, edges = np.histogram(values, bins=31, range=(-4.0 * sigma, 4.0 * sigma), density=True)
    x = np.linspace(-4.0 * sigma, 4.0 * sigma, 201)
    normal = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
    bars = Trace(name, 0.5 * (edges[1:] + edges[:-1]), counts, style="bars")
    edge = Trace(
        "±σ", np.array([-sigma, -sigma, math.nan, sigma, sigma]), np.array([0, normal.max(), math.nan, 0, normal.max()])
    )
    return [bars, Trace("normal density", x, normal), edge]


def _residual_figure(title: str, run: Run) -> Figure:
    k = np.arange(1, len(run.residual) + 1, dtype=np.float64)
    zero, one = np.zeros(len(k)), np.ones(len(k))
    tail = slice(SETTLED, None)
    lags, rho = np.arange(1, LAGS + 1, dtype=np.float64), autocorrelation(run.normalised)
    bound = np.full(LAGS, 1.0 / math.sqrt(len(k)))
    late, settled_sigma = run.residual[tail], float(run.residual_sigma[-1])
    correlation = Trace("ρ", lags, rho, bound, np.zeros(LAGS), "markers")
    panels = [
        Panel("residual", "time [s]", "r [m]", [Trace("r", k, run.residual, run.residual_sigma, zero)]),
        Panel(
            "after the transient",
            "time [s]",
            "r [m]",
            [Trace("r, later", k[tail], late, run.residual_sigma[tail], zero[tail])],
        ),
        Panel("normalised residual", "time [s]", "r / √S", [Trace("η", k, run.normalised, one, zero, "markers")]),
        Panel("autocorrelation of η", "lag [s]", "correlation", [correlation]),
        Panel(
            "histogram of r after the transient", "r [m]", "density [1/m]", _histogram(late, settled_sigma, "r density")
        ),
        Panel("histogram of η", "r / √S", "density", _histogram(run.normalised, 1.0, "η density")),
    ]
    return Figure(title, panels)


def _drift_figure(run: Run) -> Figure:
    panels = []
    for i, (name, unit) in enumerate(NAMES[:2]):
        zero = np.zeros(len(run.t))
        trace = Trace(f"dead-reckoned {name}", run.t, run.states[:, i], run.sigmas[:, i], zero)
        panels.append(Panel(f"{name} without measurements", "time [s]", f"{name} [{unit}]", [trace]))
    return Figure("Problem 2: drift of dead reckoning, b̂ = 0 (model data)", panels)


def reproduce(seed: int) -> Report:
    """His table and figures."""
    rng = np.random.default_rng(seed)
    samples, bias = model_samples(rng)
    run = filtered(samples, bias)
    reckoned = filtered(samples, bias, interval_s=1e6)
    sheet = filtered(*sheet_samples(rng))
    return Report(
        "Farrell, Simple Kalman Filter: Design Example",
        [*design_rows(), *filter_rows(run, sheet, reckoned, -float(samples["f"][:, 0].mean()))],
        [
            _drift_figure(reckoned),
            _residual_figure("Fig. 1: residuals, model data", run),
            _residual_figure("Fig. 1: residuals, M-G350 data", sheet),
            _state_figure("Fig. 2: state errors ±σ, model data", run),
            _state_figure("Fig. 2: state errors ±σ, M-G350 data (bias against its last second)", sheet),
        ],
    )
