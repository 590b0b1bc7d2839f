"""The serial accelerometer through the daemon: found in its menu or streaming, served by `tilt`; others are refused."""

import os
import subprocess
import sys

import pytest
from processes import daemon, emulator

TILTED = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5", "--accel-bias-mg", "0,0,0")


@pytest.mark.thorough
def test_tilt_from_a_board_in_its_menu_and_again_from_one_that_streams_counts(tmp_path):
    board = tmp_path / "imu"
    with daemon(tmp_path, "--port", str(board)) as imud:
        with emulator("seraccel", *TILTED, links=[board]):
            est = imud.until(lambda m: m["class"] == "EST" and m["state"] == "attitude")
            assert est["estimator"] == "tilt"
            assert est["roll_deg"] == pytest.approx(10.0, abs=3.0 * est["sroll_deg"])
            assert est["pitch_deg"] == pytest.approx(-5.0, abs=3.0 * est["spitch_deg"])
            assert est["syaw_deg"] == pytest.approx(103.9, abs=0.1)
            assert "sbgz_dps" not in est and "lat_deg" not in est
            imud.comes_at(100.0, 0.05)
            later = imud.until(lambda m: m["class"] == "EST")
        imud.says("trying again")
        running = (*TILTED, "--streaming", "--stream-mode", "binary", "--stream-rate", "50")
        with emulator("seraccel@19200", *running, links=[board]):
            imud.says("baud=19200")
            est = imud.until(lambda m: m["class"] == "EST" and m["t_mono_ns"] > later["t_mono_ns"] + 3_000_000_000)
            assert est["roll_deg"] == pytest.approx(10.0, abs=3.0 * est["sroll_deg"])
        assert "has no gyro about x, y, z: tilt instead of attitude" in imud.log
        assert imud.process.poll() is None


def test_an_estimator_that_needs_gyros_is_refused(tmp_path):
    board = tmp_path / "imu"
    with emulator("seraccel", *TILTED, "--streaming", links=[board]):
        ended = subprocess.run(
            [sys.executable, "-m", "imud", "run", "--port", f"{board}:seraccel@57600", "--estimator", "attitude",
             "--listen", str(tmp_path / "gpsd.sock")],
            capture_output=True, text=True, check=False, env={**os.environ, "NO_COLOR": "1"},
        )  # fmt: skip
    assert ended.returncode == 64, ended.stderr
    assert "'attitude' needs all gyros" in ended.stderr and "--estimator tilt" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.thorough
def test_what_is_plugged_in_later_and_will_not_do_ends_nothing(tmp_path):
    board = tmp_path / "imu"
    with daemon(tmp_path, "--port", str(board), "--estimator", "attitude") as imud:
        with emulator("g350", "--scenario", "rest", links=[board]):
            before = imud.until(lambda m: m["class"] == "EST" and m["state"] == "attitude")
        with emulator("seraccel", *TILTED, "--streaming", links=[board]):
            imud.says("'attitude' needs all gyros")
        with emulator("g350", "--scenario", "rest", links=[board]):
            after = imud.until(lambda m: m["class"] == "EST" and m["t_mono_ns"] > before["t_mono_ns"] + 2_000_000_000)
        assert after["seq"] > before["seq"]
        assert imud.log.count("needs all gyros") == 1


@pytest.mark.thorough
def test_beside_a_receiver_it_gives_the_tilt_and_the_receiver_the_position(tmp_path):
    links = [tmp_path / "imu", tmp_path / "gnss"]
    ports = [word for link in links for word in ("--port", str(link))]
    with (
        emulator("seraccel", "nmea", "--no-fix", "0", "--patient", links=links),
        daemon(tmp_path, *ports) as imud,
    ):
        imud.says("tilt instead of navigation")
        tpv = imud.until(lambda m: m["class"] == "TPV" and m["mode"] == 3)
        assert tpv["device"] == str(links[1]) and tpv["lat"] == pytest.approx(35.6586, abs=0.005)
        est = imud.until(lambda m: m["class"] == "EST" and "attitude" in m["state"])
        assert est["device"] == str(links[0]) and est["estimator"] == "tilt" and "lat_deg" not in est
