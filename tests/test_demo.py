"""`imud demo`: its comparison with the truth on numbers made by hand, and the whole of it once."""

import math
import subprocess
import sys

import pytest
from processes import process

from imud.commands import demo as demo_command
from imud.commands.demo import screen
from imud.commands.demo.comparison import Comparison, Truth
from imud.errors import ImudError

METRES = 111_320.0  # in a degree of latitude
FIRST = (100.0, 60.0, 10.0, 50.0, 1.0, 2.0, 3.0, 170.0, -4.0, 179.0)  # in the order of the file's columns
SECOND = (100.1, 60.001, 10.002, 50.0, 2.0, 2.0, 3.0, -170.0, -6.0, -179.0)
HEADER = "t_mono_s,lat_deg,lon_deg,height_m,vn_mps,ve_mps,vd_mps,roll_deg,pitch_deg,yaw_deg\n"


def rows(*values):
    return "".join(",".join(map(str, row)) + "\n" for row in values)


def test_truth_is_interpolated_with_angles_along_the_short_arc(tmp_path):
    file = tmp_path / "truth.csv"
    file.write_text(HEADER + rows(FIRST))
    truth = Truth(file)
    assert truth.covers(100.0) and not truth.covers(100.05)
    with file.open("a") as more:
        more.write(rows(SECOND)[:30])
        more.flush()
        assert not truth.covers(100.05)  # half a row is none
        more.write(rows(SECOND)[30:])
    assert truth.covers(100.1)
    found = truth.at(100.05)
    expected = {"lat_deg": 60.0005, "lon_deg": 10.001, "height_m": 50.0, "vn_mps": 1.5, "ve_mps": 2.0, "vd_mps": 3.0}
    assert found == pytest.approx(expected | {"roll_deg": 180.0, "pitch_deg": -5.0, "yaw_deg": 180.0})
    assert truth.at(99.9) is None


def test_errors_of_what_is_claimed_and_of_nothing_else():
    truth = {"lat_deg": 60.0, "lon_deg": 10.0, "vn_mps": 1.0, "ve_mps": 2.0, "vd_mps": 3.0}
    truth |= {"roll_deg": 10.0, "pitch_deg": 20.0, "yaw_deg": 179.0}
    est = {"roll_deg": 13.0, "pitch_deg": 16.0, "yaw_deg": -179.0, "sroll_deg": 1.0, "spitch_deg": 2.0, "syaw_deg": 3.0}
    est |= {"lat_deg": 60.0 + 3.0 / METRES, "lon_deg": 10.0 + 8.0 / METRES, "sn_m": 3.0, "se_m": 4.0}  # cos 60° = 1/2
    est |= {"vn_mps": 1.0, "ve_mps": 4.0, "vd_mps": 3.0} | {f"sv{axis}_mps": 1.0 for axis in "ned"}
    comparison = Comparison()
    comparison.add(est | {"state": "aligning"}, truth)
    assert all(error.count == 0 for error in comparison.errors.values())
    comparison.add(est | {"state": "attitude"}, truth)
    comparison.add(est | {"state": "attitude,position"}, truth)
    assert {name for name, error in comparison.errors.items() if math.isfinite(error.last)} == {
        "roll",
        "pitch",
        "position",
    }
    comparison.add(est | {"state": "attitude,position,at-rest"}, truth)
    comparison.add(est | {"state": "attitude,heading,position"}, truth)
    assert {name: error.count for name, error in comparison.errors.items()} == {
        **{"roll": 4, "pitch": 4, "heading": 1, "position": 3, "velocity": 2}
    }
    rms = {"roll": 3.0, "pitch": 4.0, "heading": 2.0, "position": 5.0, "velocity": 2.0}
    assert {name: error.rms for name, error in comparison.errors.items()} == pytest.approx(rms, rel=1e-4)
    claimed = {"roll": 1.0, "pitch": 2.0, "heading": 3.0, "position": 5.0, "velocity": 3.0**0.5}
    assert {name: error.claimed_rms for name, error in comparison.errors.items()} == pytest.approx(claimed)


@pytest.mark.parametrize("code", ["import time; time.sleep(0.5); print('g350 /dev/pts/1')", "1 / 0"])
def test_the_emulator_may_take_its_time_to_start_but_not_end_instead(code, tmp_path):
    log = tmp_path / "log"
    with (
        log.open("w") as file,
        subprocess.Popen([sys.executable, "-c", code], stdout=-1, stderr=file, text=True) as sim,
    ):
        if "print" in code:
            assert demo_command._first_line(sim, "the emulator", log) == "g350 /dev/pts/1"
        else:
            with pytest.raises(ImudError, match=r"(?s)the emulator did not start:.*ZeroDivisionError"):
                demo_command._first_line(sim, "the emulator", log)


def test_it_ends_by_itself_with_errors_against_the_truth(tmp_path):
    """At rest, where an estimate that comes late is as true as before."""
    options = ("--seconds", "8", "--scenario", "rest", "--set", f"record.path={tmp_path / 'demo.mcap'}")
    with process("imud", "demo", *options, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as demo:
        out, err = demo.communicate()
    assert demo.returncode == 0, out + err
    values = {words[0]: words[1] for line in out.splitlines() if len(words := line.split()) >= 2}
    assert float(values["roll"]) < 1.0
    assert float(values["pitch"]) < 1.0
    assert {"heading", "position", "velocity"} <= values.keys()
    assert (tmp_path / "demo.mcap").stat().st_size > 10_000


def test_lines_and_summary_show_errors_beside_the_claimed_sigmas():
    comparison = Comparison()
    est = {"state": "attitude,position,height,coasting", "roll_deg": 1.0, "pitch_deg": -2.0, "sroll_deg": 0.5}
    est |= {"spitch_deg": 3.0, "lat_deg": 3.0 / METRES, "lon_deg": 0.0, "sn_m": 3.0, "se_m": 4.0}
    truth = {"roll_deg": 0.0, "pitch_deg": 0.0, "lat_deg": 0.0, "lon_deg": 0.0}
    comparison.add(est, truth)
    comparison.add(est | {"roll_deg": 7.0, "sroll_deg": 1.5}, truth)
    shown = screen.line(est, comparison, 9.3)
    assert shown.split() == ["9.3", "s", "+7.00", "±1.50", "-2.00", "±3.00", "-", "3.00", "±5.00", "-", "coasting"]
    column = screen.head().index("position, m") + len("position, m")
    assert shown[:column].endswith("±5.00")
    assert len(screen.head()) <= 80
    table = {words[0]: words[1:] for row in screen.summary(comparison, 2, 0.1).splitlines() if (words := row.split())}
    assert table["roll"] == ["5.000", "1.118", "7.000", "1.500", "deg"]  # root of (1 + 49) / 2, of (0.25 + 2.25) / 2
    assert table["heading"] == ["-", "-", "-", "-", "deg"]


@pytest.mark.parametrize(
    ("state", "known"),
    [("aligning", []), ("attitude", ["roll", "pitch"]), ("attitude,heading", ["roll", "pitch", "heading"])],
)
def test_the_table_shows_only_angles_that_are_known(state, known):
    est = {f"{s}{angle}_deg": 1.0 for angle in ("roll", "pitch", "yaw") for s in ("", "s")} | {"state": state}
    truth = dict.fromkeys((key for _, key, *_ in screen._ROWS), 2.0)
    cells = {
        words[0]: words[1:-1] for row in screen._screen(est, truth, 0.0).splitlines()[2:] if (words := row.split())
    }
    assert [name for name in ("roll", "pitch", "heading") if cells[name] == ["2.00", "1.00", "1.00"]] == known
    assert all(cells[name] == ["2.00", "-", "-"] for name in ("roll", "pitch", "heading", "north") if name not in known)
