"""The statistics of the report: against scipy and numpy, and what is said of simulated faults."""

import numpy as np
import pytest
import scipy  # imports scipy.stats when it is used
from hypothesis import given
from hypothesis import strategies as st
from report_data import RNG_SEED, WHITE, innovations, still

from imud.commands.report.content import panels
from imud.commands.report.envelope import Envelope
from imud.commands.report.findings import findings
from imud.commands.report.reduction import NAMES, EstimateReduction, SensorReduction
from imud.commands.report.session import Session
from imud.commands.report.statistics import autocorrelation, chi2_bounds, effective_number, moving_mean
from imud.figures import kept


@pytest.mark.parametrize("degrees", [3, 20, 200, 5000])
def test_bounds_are_those_of_chi_square(degrees):
    exact = scipy.stats.chi2.ppf((0.025, 0.975), degrees) / degrees
    assert chi2_bounds(degrees) == pytest.approx(exact, rel=0.02, abs=0.015)


def test_autocorrelation_is_numpys():
    z = np.random.default_rng(RNG_SEED).normal(size=300).cumsum()
    d = z - z.mean()
    full = np.correlate(d, d, "full")[len(z) - 1 :]
    assert autocorrelation(z, 7) == pytest.approx(full[:8] / full[0])
    assert autocorrelation(np.ones(5), 2).tolist() == [1.0, 0.0, 0.0]


def test_correlated_values_are_worth_fewer():
    rng, rho = np.random.default_rng(RNG_SEED), 0.8
    means, numbers = [], []
    for _ in range(300):
        z = np.zeros(400)
        noise = rng.normal(size=400) * np.sqrt(1.0 - rho**2)
        for k in range(1, 400):
            z[k] = rho * z[k - 1] + noise[k]
        means.append(z.mean())
        numbers.append(effective_number(z))
    assert 1.0 / np.var(means) == pytest.approx(np.mean(numbers), rel=0.25)


def test_moving_mean_is_convolution():
    z = np.random.default_rng(RNG_SEED).normal(size=50)
    assert moving_mean(z, 7) == pytest.approx(np.convolve(z, np.full(7, 1.0 / 7.0), "valid"))


def said(*of, sensors=()):
    return "\n".join(findings(Session(innovations=of, sensors=sensors)))


def watched(rows, block=700):
    """As a report sees a sensor, block by block."""
    watch = SensorReduction("imu")
    for start in range(0, len(rows), block):
        watch.add(rows[start : start + block])
    return watch.close()


@pytest.mark.parametrize(
    ("case", "words"),
    [
        (innovations(WHITE), ""),
        (innovations(1.5 * WHITE), "overconfident: the innovations are 1.5"),
        (innovations(0.4 * WHITE), "conservative"),
        (innovations(WHITE + 0.6), "biased: mean +0.6"),
        (innovations(np.convolve(WHITE, np.full(4, 0.5), "same")), "not white"),
        (innovations(WHITE, np.arange(400) % 10 > 0), "10 % of 400 innovations were rejected: the gate is too tight"),
        (innovations(9.0 * WHITE[:10]), ""),  # too few to judge
    ],
)
def test_inconsistent_innovations_are_reported(case, words):
    text = said(case)
    assert words in text and bool(text) == bool(words)


def test_faults_of_the_sensor_are_reported():
    well = still()
    assert said(sensors=(watched(well),)) == ""
    frozen = still()
    frozen["w"][2000:3000, 1] = frozen["w"][2000, 1]
    for block in (30, 700, 4000):
        assert "imu: gyro y frozen" in said(sensors=(watched(frozen, block),))
    gap = np.delete(still(), np.s_[1000:1100])
    assert "1 gap between samples, the longest 1.01 s at 10.0 s" in said(sensors=(watched(gap),))
    assert watched(well[:1]) is None


def curve(session, figure, panel):
    """The only trace of a panel, by the beginning of the titles."""
    [found] = (f for f in panels(session) if f.title.startswith(figure))
    [[trace]] = (p.traces for p in found.panels if p.title.startswith(panel))
    return trace


@pytest.mark.parametrize("angle", ["roll", "yaw"])
@pytest.mark.parametrize("n", [400, 40_000])
def test_no_line_is_drawn_over_a_gap_nor_where_an_angle_passes_a_half_turn(angle, n):
    t = np.linspace(0.0, 100.0, n)
    rows = {name: np.zeros(n) for name in (*NAMES, "status")} | {"t_s": t + 20.0 * (t >= 50.0)}
    rows[f"{angle}_deg"] = (4.0 * t - 170.0 + 180.0) % 360.0 - 180.0
    reduction = EstimateReduction("run")
    for start in range(0, n, 150):
        reduction.add({name: column[start : start + 150] for name, column in rows.items()})
    drawn = curve(Session(estimates=(reduction.close(),)), "Attitude", angle)
    pairs = np.isfinite(drawn.y[:-1]) & np.isfinite(drawn.y[1:])  # between these there is a line
    assert np.abs(np.diff(drawn.y))[pairs].max() < 5.0 and np.diff(drawn.x)[pairs].max() < 1.0
    assert np.count_nonzero(np.isnan(drawn.y)) == 2 and np.nanmax(np.abs(drawn.y)) <= 180.0


@given(st.integers(1, 5000), st.integers(1, 900), st.integers(0, 2**31))
def test_an_envelope_is_small_and_loses_no_spike(n, block, seed):
    rng = np.random.default_rng(seed)
    rows = np.stack([np.arange(n, dtype=float), rng.normal(size=n), rng.normal(size=n)], axis=1)
    rows[rng.random(n) < 0.3, 2] = np.nan
    bits = 1 << rng.integers(0, 5, n)
    envelope = Envelope(3, spans=20)
    for start in range(0, n, block):
        envelope.add(rows[start : start + block], bits[start : start + block])
    extremes, ends, greatest, seen = envelope.close()
    assert len(extremes) == len(ends) == len(greatest) == len(seen) <= 80
    for k in (0, 1, 2):
        if np.isfinite(rows[:, k]).any():
            wanted = np.nanmin(rows[:, k]), np.nanmax(rows[:, k])
            assert (np.nanmin(extremes[:, k]), np.nanmax(extremes[:, k])) == wanted
            assert np.nanmax(greatest[:, k]) == wanted[1]
    assert np.bitwise_or.reduce(seen) == np.bitwise_or.reduce(bits)
    assert (ends[0, :2].tolist(), ends[-1, :2].tolist()) == (rows[0, :2].tolist(), rows[-1, :2].tolist())
    spans = np.searchsorted(extremes[0::2, 0], np.arange(n), side="right") - 1 if len(extremes) < n else None
    if spans is not None:  # each value lies between the bounds of the span of its time
        assert (extremes[0::2, 1][spans] <= rows[:, 1]).all() and (rows[:, 1] <= extremes[1::2, 1][spans]).all()
    if n <= 40:
        assert np.array_equal(extremes, rows, equal_nan=True)


@given(st.integers(1, 3000), st.integers(0, 2**31))
def test_what_is_drawn_loses_no_spike(n, seed):
    y = np.random.default_rng(seed).normal(size=n)
    y[::7] = np.nan
    take = kept(y, 100)
    assert len(take) <= max(100, min(n, 100)) and (np.diff(take) > 0).all()
    if n > 1:
        assert (np.nanmin(y[take]), np.nanmax(y[take])) == (np.nanmin(y), np.nanmax(y))


def test_stamps_that_are_bunched_at_the_start_are_no_gaps_in_all_the_rest():
    rows = still()
    rows["t_ns"][:100] = rows["t_ns"][100] - np.arange(100, 0, -1) * 100_000
    assert watched(rows).rate_hz == pytest.approx(100.0)
    assert "gaps" not in said(sensors=(watched(rows),))
