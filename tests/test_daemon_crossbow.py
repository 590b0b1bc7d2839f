"""The daemon with an emulated Crossbow DMU, through a pseudo-terminal."""

import pytest
from processes import TIMEOUT_S, daemon, emulator


@pytest.mark.thorough
def test_tilt_of_a_still_dmu(tmp_path):
    imu = tmp_path / "imu"
    errors = ("--gyro-bias-dps", "0,0,0.2", "--accel-bias-mg", "0,0,0")
    rest = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5")
    with emulator("rga300", *rest, *errors, "--patient", links=[imu]), daemon(tmp_path, "--port", str(imu)) as imud:
        imud.says("DMU RGA300CA")
        imud.until(lambda m: m["class"] == "EST" and "aligning" not in m["state"])
        imud.comes_at(100.0, 0.02)
        est = imud.until(lambda m: m["class"] == "EST")
        assert est["roll_deg"] == pytest.approx(10.0, abs=0.5)
        assert est["pitch_deg"] == pytest.approx(-5.0, abs=0.5)
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
        assert "serial=30042" in imud.log
        assert "lost=0" in imud.log


@pytest.mark.thorough
def test_a_dmu_beside_a_receiver_gives_position_and_attitude(tmp_path):
    links = [tmp_path / "imu", tmp_path / "gnss"]
    ports = [word for link in links for word in ("--port", str(link))]
    with (
        emulator("rga300", "nmea", "--scenario", "car", "--no-fix", "0", "--patient", links=links),
        daemon(tmp_path, *ports) as imud,
    ):
        imud.says("riss instead of navigation")
        est = imud.until(lambda m: m["class"] == "EST" and "position" in m["state"])
        assert est["estimator"] == "riss" and "attitude" in est["state"]
        assert est["lat_deg"] == pytest.approx(35.6586, abs=0.005)
        assert 0.1 < est["sroll_deg"] < 10.0
        imud.until(lambda m: m["class"] == "TPV" and m["mode"] == 3)
