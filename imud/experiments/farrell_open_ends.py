"""What Farrell leaves to the reader: integration methods, restarts of b(0), alternative implementations; and tilt.

Plain numpy beside the kernels. Each implementation of the filter takes one step per measurement, with the input that
the samples of that second add up to: the numbers of his Solution 6 at work.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ..configuration.settings import Imu, Initial, Settings
from ..estimators import registry
from ..estimators.papers import stationary
from ..estimators.papers.stationary import STATES
from ..estimators.records import SOLUTION
from ..math.arrays import Floats
from ..math.kalman import unpack
from ..pipeline import Filter
from .report import Row, at_most, rms, within
from .runs import AxisRun
from .simulate import level_at_rest, m_g350

H = np.array([1.0, 0.0, 0.0])
DRAWN, DRAWN_S, DRAWN_HZ = 100, 10.0, 100.0
Step = Callable[[Floats, Any, float, Floats, Floats, Floats], tuple[Floats, Any]]


# --- integration ---


def euler(a: Floats, T: float) -> tuple[Floats, Floats]:
    """(13), (14) as printed: a_k after t_k. Velocity and position."""
    v = np.concatenate([[0.0], np.cumsum(a[:-1] * T)])
    return v, np.concatenate([[0.0], np.cumsum(v[:-1] * T)])


def trapezoidal(a: Floats, T: float) -> tuple[Floats, Floats]:
    """Euler's step as predictor, the mean of both slopes as corrector."""
    v = np.concatenate([[0.0], np.cumsum(0.5 * T * (a[1:] + a[:-1]))])
    return v, np.concatenate([[0.0], np.cumsum(0.5 * T * (v[1:] + v[:-1]))])


def runge_kutta(a: Floats, T: float) -> tuple[Floats, Floats]:
    """The classical one of order 4, the acceleration linear between samples."""
    v = np.concatenate([[0.0], np.cumsum(0.5 * T * (a[1:] + a[:-1]))])
    steps = T * v[:-1] + T * T / 6.0 * (2.0 * a[:-1] + a[1:])
    return v, np.concatenate([[0.0], np.cumsum(steps)])


METHODS = {"Euler": euler, "predictor and corrector": trapezoidal, "Runge and Kutta": runge_kutta}


def integration_rows(samples: Any, noise: float) -> list[Row]:
    """Problem 1 by other methods. noise: of the accelerometer, (m/s)/sqrt(s)."""
    T, a = 1e-9 * float(np.median(np.diff(samples["t_ns"]))), samples["f"][:, 0]
    span = T * (len(a) - 1)
    exact_v = np.concatenate([[0.0], np.cumsum(a[1:] * T)])
    exact = np.concatenate([[0.0], np.cumsum(T * exact_v[:-1] + 0.5 * T * T * a[1:])])[-1]
    sigma = noise * math.sqrt(span**3 / 3.0)
    quantity = f"position after {span:.0f} s of dead reckoning"
    rows = [Row(f"{quantity}, exact as built", "try then and compare", f"{exact:.6g} m; σ of the noise {sigma:.3g} m")]
    for name, method in METHODS.items():
        apart = abs(float(method(a, T)[1][-1] - exact))
        rows.append(at_most(f"{quantity}, {name}: from exact, in σ", "try then and compare", apart / sigma, 1.0))
    return rows


def restart_rows(samples: Any, noise: float) -> list[Row]:
    """Solution 2: the data integrated anew with another b(0)."""
    T, u = 1e-9 * float(np.median(np.diff(samples["t_ns"]))), samples["f"][:, 0]
    span = T * (len(u) - 1)
    one_reading = 3.0 * noise / math.sqrt(T) * span  # m/s, 3 sigma
    starts = (
        ("0", 0.0, "line and parabola", math.inf),
        ("minus the first reading", -u[0], "drift by one reading's noise", one_reading),
        ("minus the mean reading", -u.mean(), "v returns to 0", 1e-3 * one_reading),
    )
    rows = []
    for name, b, paper, limit in starts:
        v, p = trapezoidal(u + b, T)
        holds = None if b == 0.0 else bool(abs(v[-1]) < limit)
        ours = f"v {v[-1]:.4g} m/s, p {p[-1]:.4g} m"
        rows.append(Row(f"dead reckoning of {span:.0f} s with b(0) {name}", paper, ours, holds))
    return rows


# --- implementations ---


def as_printed(x: Floats, P: Floats, R: float, phi: Floats, q_d: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Solution 7: P = (I - K H) P."""
    x, P = phi @ x + w, phi @ P @ phi.T + q_d
    K = P @ H / (H @ P @ H + R)
    return x - K * x[0], (np.eye(STATES) - np.outer(K, H)) @ P


def joseph(x: Floats, P: Floats, R: float, phi: Floats, q_d: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Joseph's form."""
    x, P = phi @ x + w, phi @ P @ phi.T + q_d
    K = P @ H / (H @ P @ H + R)
    A = np.eye(STATES) - np.outer(K, H)
    return x - K * x[0], A @ P @ A.T + R * np.outer(K, K)


def information(x: Floats, P: Floats, R: float, phi: Floats, q_d: Floats, w: Floats) -> tuple[Floats, Floats]:
    """The update in the inverse of P."""
    x, P = phi @ x + w, phi @ P @ phi.T + q_d
    updated: Floats = np.linalg.inv(np.linalg.inv(P) + np.outer(H, H) / R).astype(np.float64)
    return x - updated @ H / R * x[0], updated


def square_root(x: Floats, S: Floats, R: float, phi: Floats, q_d: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Potter's update of P = S S', the prediction by a QR decomposition."""
    x = phi @ x + w
    root: Floats = np.linalg.qr(np.hstack([phi @ S, np.linalg.cholesky(q_d)]).T)[1].T.astype(np.float64)
    f = root.T @ H
    total = f @ f + R
    K = root @ f / total
    return x - K * x[0], root - np.outer(K, f) / (1.0 + math.sqrt(R / total))


IMPLEMENTATIONS: dict[str, tuple[Step, bool]] = {  # whether it carries a root of P
    "(I - KH) P as printed": (as_printed, False),
    "Joseph's form": (joseph, False),
    "information form": (information, False),
    "Potter's square root": (square_root, True),
}


def _seconds(u: Floats, T: float, p: Any) -> Iterator[Floats]:
    """What the samples of each interval add to the state."""
    size = round(1e-9 * float(p["interval_ns"][0]) / T)
    for k in range(1, len(u) - size + 1, size):
        part = u[k : k + size]
        left = T * np.arange(size - 1, -1, -1)
        yield np.array([float(np.sum(part * (T * left + 0.5 * T * T))), T * float(np.sum(part)), 0.0])


def implementation_rows(samples: Any, run: AxisRun, p: Any) -> list[Row]:
    """Each of them against the kernels, at the measurements, in the kernels' sigmas."""
    T, u = 1e-9 * float(np.median(np.diff(samples["t_ns"]))), samples["f"][:, 0]
    interval = 1e-9 * float(p["interval_ns"][0])
    to_p, to_v, to_b = stationary.transition(p["bias_rate"][0], interval)
    phi = np.array([[1.0, interval, to_p], [0.0, 1.0, to_v], [0.0, 0.0, to_b]])
    packed = np.zeros(6)
    stationary.add_process_noise(p[0], interval, packed)
    q_d, R = np.asarray(unpack(packed, STATES)), float(p["position_var"][0])
    inputs = list(_seconds(u, T, p))
    at = np.round(interval / T * np.arange(1, len(inputs) + 1)).astype(int)
    rows = []
    for name, (step, rooted) in IMPLEMENTATIONS.items():
        x, P = np.zeros(STATES), np.diag([0.0, 0.0, float(p["bias_var"][0])])
        P = np.sqrt(P) if rooted else P
        states, sigmas = [], []
        for w in inputs:
            x, P = step(x, P, R, phi, q_d, w)
            states.append(x)
            sigmas.append(np.sqrt(np.diag(P @ P.T if rooted else P)))
        apart = float(np.max(np.abs(np.array(states) - run.states[at]) / run.sigmas[at]))
        relative = float(np.max(np.abs(np.array(sigmas) / run.sigmas[at] - 1.0)))
        quantity = f"{name}, one step a second: from ours at 1 kHz, in σ; its σ"
        rows.append(Row(quantity, "identical", f"{apart:.1e}; {relative:.1e} off", max(apart, relative) < 0.01))
    return rows


def open_end_rows(samples: Any, run: AxisRun, p: Any) -> list[Row]:
    """His open ends on the data-sheet sensor. run: the kernels on its x axis with the parameters p."""
    noise = math.sqrt(float(p["accel_psd"][0]))
    return [
        *integration_rows(samples, noise),
        *restart_rows(samples, noise),
        *implementation_rows(samples, run, p),
    ]


# --- tilt ---


def drawn_rows(rng: np.random.Generator) -> list[Row]:
    """Live, the tilt is that of the first sample and absorbs b_x and b_y: are the sigmas honest?"""
    settings = Settings(imu=Imu(profile="m-g350"))
    t = np.arange(round(DRAWN_S * DRAWN_HZ)) / DRAWN_HZ
    w, f = level_at_rest(len(t))
    ratios = []
    for _ in range(DRAWN):
        samples = m_g350(rng, t, w, f)
        bias = (samples["f"] - f)[-round(DRAWN_HZ) :].mean(axis=0)
        out = np.zeros(len(t), SOLUTION)
        Filter(registry.by_name("stationary"), settings, Initial(), DRAWN_HZ).run(samples, out)
        ratios.append((out["ba"][-1] - bias) / out["sigma_ba"][-1])
    spread = 4.0 / math.sqrt(2.0 * DRAWN)
    quantity = f"{DRAWN} drawn sensors, tilt from the first sample: RMS of error / σ of b"
    columns = np.array(ratios).T
    rows = [
        within(f"{quantity}_{axis}", "not asked", rms(columns[i]), 1.0 - spread, 1.0 + spread)
        for i, axis in enumerate("xy")
    ]
    return [*rows, at_most(f"{quantity}_z (Q_ω is too large)", "not asked", rms(columns[2]), 1.0)]
