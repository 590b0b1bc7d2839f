"""The daemon with an emulated M-G350 that is asked for each sample, through a pseudo-terminal."""

import numpy as np
import pytest
from processes import TIMEOUT_S, daemon, emulator

from imud.client import connect

IDEAL = ("--gyro-bias-dps", "0,0,0", "--accel-bias-mg", "0,0,0")


PERIOD_NS = 16_000_000


def test_attitude_of_a_polled_g350(tmp_path):
    imu, stream = tmp_path / "imu", tmp_path / "stream"
    polled = ("--set", "imu.mode=polled", "--set", "imu.rate_hz=62.5", "--set", f"stream.listen={stream}")
    rest = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5")
    with emulator("g350", *rest, *IDEAL, links=[imu]), daemon(tmp_path, "--port", str(imu), *polled) as imud:
        imud.says("rate_hz=62.5")
        est = imud.until(lambda m: m["class"] == "EST" and "aligning" not in m["state"])
        assert est["roll_deg"] == pytest.approx(10.0, abs=0.3)
        assert est["pitch_deg"] == pytest.approx(-5.0, abs=0.3)
        with connect(stream, timeout_s=TIMEOUT_S) as states:
            steps = np.diff([next(states).t_ns for _ in range(120)]) / PERIOD_NS
        passed = np.round(steps)  # by the sensor's own count; a busy machine asks too late for some
        assert np.mean((passed > 0) & (np.abs(steps - passed) < 0.05)) > 0.9, steps
        assert (passed == 1).any(), steps
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
        assert "junk=0" in imud.log
