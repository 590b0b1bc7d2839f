"""The daemon with an emulated M-G350 that is asked for each sample, through a pseudo-terminal."""

import pytest
from processes import PATIENCE_S, daemon, emulator

IDEAL = ("--gyro-bias-dps", "0,0,0", "--accel-bias-mg", "0,0,0")


def test_attitude_of_a_polled_g350(tmp_path):
    imu = tmp_path / "imu"
    polled = ("--set", "imu.mode=polled", "--set", "imu.rate_hz=62.5")
    rest = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5")
    with emulator("g350", *rest, *IDEAL, links=[imu]), daemon(tmp_path, "--port", str(imu), *polled) as imud:
        imud.says("rate_hz=62.5")
        first = imud.until(lambda m: m["class"] == "EST" and "aligning" not in m["state"])
        est = imud.until(lambda m: m["class"] == "EST" and m["t_mono_ns"] > first["t_mono_ns"] + 2_000_000_000)
        assert est["roll_deg"] == pytest.approx(10.0, abs=0.3)
        assert est["pitch_deg"] == pytest.approx(-5.0, abs=0.3)
        rate = (est["seq"] - first["seq"]) / (est["t_mono_ns"] - first["t_mono_ns"]) * 1e9
        assert rate == pytest.approx(62.5, rel=0.1)
        imud.process.terminate()
        assert imud.process.wait(PATIENCE_S) == 0
        assert "junk=0" in imud.log
