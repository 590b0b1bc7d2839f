"""Allan deviation: allantools' numbers, coefficients of known noise within their own sigmas, and the command."""

import json
import math
import os
import re

import numpy as np
import pytest

from imud.commands import main
from imud.sensor_errors.noise import allan_deviation
from imud.sensor_errors.profiles import PROFILES, profile_of
from imud.setup import config

RATE_HZ = 20.0


def flicker(rng, n, instability):
    """Noise of one-sided spectrum B^2/(pi f), from the frequency domain; half of it, so that it does not repeat."""
    f = np.fft.rfftfreq(2 * n, 1.0 / RATE_HZ)
    spectrum = np.concatenate([[0.0], instability**2 / (math.pi * f[1:])])
    phases = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
    return np.fft.irfft(phases * np.sqrt(spectrum * RATE_HZ * 2 * n / 4.0))[:n]


def noise(rng, n, N, B=0.0, K=0.0):
    white = N * math.sqrt(RATE_HZ) * rng.standard_normal(n)
    walk = np.cumsum(K / math.sqrt(RATE_HZ) * rng.standard_normal(n))
    return white + walk + (flicker(rng, n, B) if B else 0.0)


def test_the_deviation_is_allantools():
    import allantools  # which takes a second

    rate = noise(np.random.default_rng(1), 20_000, 1e-3, 1e-4, 1e-5) + 7.0
    ours = allan_deviation(rate, RATE_HZ)
    tau, theirs, _, _ = allantools.oadev(rate, rate=RATE_HZ, data_type="freq", taus=ours.tau)
    np.testing.assert_allclose(ours.tau, tau)
    np.testing.assert_allclose(ours.deviation, theirs, rtol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("true", [(1e-4, 0.0, 2e-6), (1e-4, 6e-5, 0.0), (1e-4, 3e-5, 1e-6)])
def test_coefficients_lie_within_their_sigmas(true):
    """25 recordings of two hours: z of those that are given is standard normal, and bounds do bound."""
    rng = np.random.default_rng(2)
    z, bounds = [], []
    for _ in range(25):
        found = allan_deviation(noise(rng, int(7200 * RATE_HZ), *true), RATE_HZ)
        for value, c in zip(true, (found.random_walk, found.instability, found.rate_walk), strict=True):
            if c.bound:
                bounds.append(c.value >= value)
            elif value:
                z.append((c.value - value) / c.sigma)
    assert np.mean(bounds) > 0.9
    assert abs(np.mean(z)) < 0.5
    assert 0.7 < np.std(z) < 1.3


def test_the_sigma_of_the_curve_is_its_scatter():
    rng = np.random.default_rng(3)
    found = [allan_deviation(noise(rng, 20_000, 1e-4, 0.0, 2e-6), RATE_HZ) for _ in range(100)]
    scatter = np.std([d.deviation for d in found], axis=0)
    claimed = np.mean([d.sigma for d in found], axis=0)
    short = found[0].tau < 20_000 / RATE_HZ / 20
    np.testing.assert_allclose(claimed[short], scatter[short], rtol=0.25)


def test_a_short_recording_gives_bounds():
    found = allan_deviation(noise(np.random.default_rng(4), 400, 1e-4, 1e-5), RATE_HZ)
    assert not found.random_walk.bound
    assert found.instability.bound and found.instability.value > 1e-5
    with pytest.raises(ValueError, match="at least 64"):
        allan_deviation(np.zeros(63), RATE_HZ)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """40 min of a sensor twice as noisy as the M-G350's data sheet."""
    rng, n, path = np.random.default_rng(5), 48_000, tmp_path_factory.mktemp("allan") / "imu.csv"
    sheet = PROFILES["m-g350"]
    w = [noise(rng, n, 2 * sheet.gyro_noise, 4 * sheet.gyro_bias_instability) for _ in range(3)]
    f = [noise(rng, n, 2 * sheet.accel_noise, 4 * sheet.accel_bias_instability) for _ in range(3)]
    rows = np.stack([np.arange(n) / RATE_HZ, *w, *f], axis=1)
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=header, comments="")
    return path


def test_the_command_and_the_settings_that_the_daemon_reads_back(recording, tmp_path, capsys):
    settings = tmp_path / "noise.toml"
    assert main(["allan", str(recording), "--settings", str(settings)]) == 0
    out = capsys.readouterr().out
    assert "deg/√h" in out and "m-g350" in out and "0.2 deg/√h" in out
    assert "moved" not in out
    profile = profile_of(config.load(settings, ["imu.profile=m-g350"]))
    sheet = PROFILES["m-g350"]
    assert profile.gyro_noise == pytest.approx(2 * sheet.gyro_noise, rel=0.05)
    assert profile.gyro_bias_instability == pytest.approx(4 * sheet.gyro_bias_instability, rel=0.3)
    assert profile.accel_noise == pytest.approx(2 * sheet.accel_noise, rel=0.05)
    assert profile.accel_bias_instability == pytest.approx(4 * sheet.accel_bias_instability, rel=0.3)
    assert profile.gyro_range == sheet.gyro_range


def test_json_has_the_noise_that_was_simulated(recording, capsys):
    assert main(["allan", str(recording), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rate_hz"] == pytest.approx(RATE_HZ)
    assert found["gyro_x"]["N"]["unit"] == "rad/s/√Hz"
    assert found["gyro_x"]["N"]["value"] == pytest.approx(2 * PROFILES["m-g350"].gyro_noise, rel=0.05)


def test_the_page_draws_the_deviations_on_logarithmic_axes(recording, tmp_path, capsys):
    pytest.importorskip("plotly", reason="plots need the extra imud[plots]")
    page = tmp_path / "allan.html"
    assert main(["allan", str(recording), "-o", str(page)]) == 0
    text = page.read_text()
    assert re.search(r'"type":\s*"log"', text)
    assert "averaging time" in text and "Allan deviation" in text
    assert f"<h1>imud allan: {recording.name}</h1>" in text
    shown = re.search(r"random walk N +(\S+ ± \S+) ", capsys.readouterr().out)
    assert f"<td>gyro: random walk N</td><td>{shown[1]}</td>" in text  # the numbers of the terminal


def test_motion_of_the_sensor_is_reported(recording, tmp_path, capsys):
    lines = recording.read_text().splitlines()
    for i in range(20_000, 20_200):
        cells = lines[i].split(",")
        lines[i] = ",".join([cells[0], "0.3", *cells[2:]])
    moved = tmp_path / "moved.csv"
    moved.write_text("\n".join(lines))
    assert main(["allan", str(moved)]) == 0
    assert "moved, most at 1000 s" in capsys.readouterr().out


def test_motion_all_the_time_is_reported(recording, tmp_path, capsys):
    header, *lines = recording.read_text().splitlines()[:2001]
    for i, line in enumerate(lines):
        t, _, *others = line.split(",")
        lines[i] = ",".join([t, f"{0.1 * (i // 20 % 2)}", *others])  # changes each second
    moving = tmp_path / "moving.csv"
    moving.write_text("\n".join([header, *lines]))
    assert main(["allan", str(moving)]) == 0
    assert "its motion, not its noise" in capsys.readouterr().out


def test_axes_that_the_sensor_has_not(recording, tmp_path, capsys):
    header, *lines = recording.read_text().splitlines()[:2001]
    yaw, none = tmp_path / "yaw.csv", tmp_path / "none.csv"
    for path, kept in ((yaw, (0, 3, 4, 5, 6)), (none, (0,))):
        rows = [[cell if i in kept else "0" for i, cell in enumerate(line.split(","))] for line in lines]
        path.write_text("\n".join([header, *(",".join(row) for row in rows)]))
    assert main(["allan", str(yaw)]) == 0
    walk = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("random walk N"))
    assert walk.count("never changes") == 2
    assert " ± " in walk
    assert main(["allan", str(yaw), "--json", "--settings", str(tmp_path / "noise.toml")]) == 0
    assert [axis for axis in json.loads(capsys.readouterr().out) if axis.startswith("gyro")] == ["gyro_z"]
    assert "gyro_random_walk_deg_per_sqrt_h" in (tmp_path / "noise.toml").read_text()
    assert main(["allan", str(none)]) == 65
    assert "every axis is constant" in capsys.readouterr().err


def test_gaps_and_short_recordings_are_refused(recording, tmp_path, capsys):
    lines = recording.read_text().splitlines()
    gaps = tmp_path / "gaps.csv"
    gaps.write_text("\n".join([lines[0], *lines[1:10_000], *lines[11_000:20_000]]))
    assert main(["allan", str(gaps)]) == 65
    assert "% of the samples are missing" in capsys.readouterr().err
    short = tmp_path / "short.csv"
    short.write_text("\n".join(lines[:50]))
    assert main(["allan", str(short)]) == 65
    assert "at least 64" in capsys.readouterr().err
    assert main(["allan", str(tmp_path / "none.csv")]) == 66
    assert main(["allan", str(recording), "--sheet", "x"]) == 64
    assert main(["allan", str(recording), "--settings", "/nonexistent/x"]) == 73


def test_a_recording_of_any_name(recording, tmp_path):
    for name in ("a\nb.csv", os.fsdecode(b"\xff.csv")):
        (tmp_path / name).write_bytes(recording.read_bytes())
        outputs = ["-o", str(tmp_path / "page.html"), "--settings", str(tmp_path / "noise.toml")]
        assert main(["allan", str(tmp_path / name), *outputs]) == 0
        assert config.load(tmp_path / "noise.toml").noise.gyro_random_walk_deg_per_sqrt_h > 0.0
