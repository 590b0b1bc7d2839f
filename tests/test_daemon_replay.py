"""A recording that is played to the daemon, end to end."""

from emulated_recording import record
from processes import TIMEOUT_S, daemon

from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.scenarios import SCENARIOS

RATE_HZ, SECONDS, GAP_S = 125.0, 3.0, (0.7, 2.2)  # longer than a live sensor may be silent


def test_a_gap_in_a_recording_is_passed_once(tmp_path):
    path = tmp_path / "gap.mcap"
    record(path, Trajectory(SCENARIOS["rest"](0.0, 0.0, 0.0), 52.0, 7.0, 0.0), SECONDS, rate_hz=RATE_HZ, gap_s=GAP_S)
    with daemon(tmp_path, "--port", f"replay:{path}", "--estimator", "attitude") as imud:
        imud.says("played to its end")
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
        samples = int(imud.log.partition("ended samples=")[2].split()[0])
        assert abs(samples - (SECONDS - GAP_S[1] + GAP_S[0]) * RATE_HZ) < 10
        assert imud.log.count(" streaming ") == 1
