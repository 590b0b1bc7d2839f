"""Emulated windowed sensors on pseudo-terminals and the daemon, end to end."""

import pytest
from processes import TIMEOUT_S, daemon, emulator, is_settled

REST = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5", "--gyro-bias-dps", "0.05,-0.05,0.05")


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("device", "model", "frame"), [("g364", "M-G364PDCA", "460800"), ("g370@230400", "M-G370PDF1", "230400")]
)
def test_attitude_of_a_still_sensor(tmp_path, device, model, frame):
    with (
        emulator(device, *REST, "--accel-bias-mg", "0,0,0", "--patient", links=[tmp_path / "imu"]),
        daemon(tmp_path, "--port", str(tmp_path / "imu"), "--estimator", "attitude") as imud,
    ):
        est = imud.until(is_settled)
        assert est["roll_deg"] == pytest.approx(10.0, abs=0.3)
        assert est["pitch_deg"] == pytest.approx(-5.0, abs=0.3)
        imud.comes_at(1000.0, 0.02)
        assert model in imud.log
        assert frame in imud.log
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
        assert "lost=0" in imud.log
