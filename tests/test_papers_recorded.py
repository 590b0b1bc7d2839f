"""`imud reproduce PAPER --data FILE`: which claims hold on a user's recording, and what is said of one without use."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from emulated_recording import record
from scipy.spatial.transform import Rotation
from simulated import motion, received, sensed

from imud import figures
from imud.commands import main
from imud.errors import BadDataError
from imud.experiments import compensation, farrell, farrell_open_ends, prasanna_recorded, recorded, suh_cart
from imud.experiments.simulate import level_at_rest, m_g350
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.scenarios import SCENARIOS

pytestmark = pytest.mark.usefixtures("papers_as_c")

IMU = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
GNSS = "t_s,lat_deg,lon_deg,height_m,satellites"
G350 = ["--set", "imu.profile=m-g350"]


def imu_csv(path, samples):
    table = np.column_stack([samples["t_ns"] * 1e-9, samples["w"], samples["f"]])
    np.savetxt(path, table, delimiter=",", header=IMU, comments="", fmt="%.9f")
    return str(path)


def judged(capsys, *arguments):
    """Exit code, and the rows of the table by quantity."""
    code = main(["reproduce", *arguments, "--json"])
    return code, {row["quantity"]: row for row in json.loads(capsys.readouterr().out)["rows"]}


def at_rest(seconds, rate_hz=100.0, rpy_deg=(0.0, 0.0, 0.0), seed=3):
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    w, f = level_at_rest(len(t))
    f = Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True).inv().apply(f)
    return m_g350(np.random.default_rng(seed), t, w, f)


def test_farrell_on_a_table_that_stands_askew(tmp_path, capsys):
    file = imu_csv(tmp_path / "imu.csv", at_rest(120.0, rpy_deg=(12.0, -20.0, 0.0)))
    code, rows = judged(capsys, "farrell", "--data", file, *G350)
    assert code == 0
    for axis in ("level x", "level y", "vertical"):
        for quantity in ("RMS residual after the transient", "position σ at the first measurement",
                         "RMS of the normalised residual", "slope of the dead-reckoned velocity",
                         "residuals beyond 5 σ: it moved"):  # fmt: skip
            assert rows[f"{axis}: {quantity}"]["holds"] is True, (axis, quantity)
    assert rows["vertical: the first residual, |r| / σ"]["holds"] is True


def test_farrell_on_a_sensor_that_is_moved(tmp_path, capsys):
    samples = at_rest(60.0)
    samples["f"][3000:3100, 1] += 1.0
    code, rows = judged(capsys, "farrell", "--data", imu_csv(tmp_path / "imu.csv", samples), *G350)
    assert code == 0
    assert rows["level x: residuals beyond 5 σ: it moved"]["holds"] is True
    assert rows["level y: residuals beyond 5 σ: it moved"]["holds"] is False
    assert rows["level y: RMS of the normalised residual"]["holds"] is False


def test_farrell_on_a_recording_takes_the_sensor_s_profile(tmp_path, capsys):
    path = tmp_path / "rest.mcap"
    record(path, Trajectory(SCENARIOS["rest"](0.0, 0.0, 0.0), 35.0, 139.0, 60.0), 40.0)
    code, rows = judged(capsys, "farrell", "--data", str(path))
    assert code == 0
    assert rows["√Q_n"]["ours"].endswith("(m-g350)")
    assert rows["vertical: RMS of the normalised residual"]["holds"] is True


def test_design_parameters_are_those_of_set(tmp_path, capsys):
    file = imu_csv(tmp_path / "imu.csv", at_rest(60.0))
    _, rows = judged(capsys, "farrell", "--data", file, *G350, "--set", "stationary.interval_s=0.1")
    assert rows["level x: position σ at the first measurement"]["holds"] is False  # 0.4 mm instead of 4 cm
    _, rows = judged(capsys, "farrell", "--data", file, *G350, "--set", "initial=lat_deg=48")
    assert "9.80891 m/s² (at 48 deg)" in rows["gravity"]["ours"]


def test_suh_on_his_cart(tmp_path, capsys):
    samples, _ = suh_cart.cart(np.random.default_rng(4), suh_cart.his)
    code, rows = judged(capsys, "suh", "--data", imu_csv(tmp_path / "cart.csv", samples), *G350)
    assert code == 0
    for quantity in ("attitude: range of pitch or roll", "experiment 2, 141 e²: roll RMS in deg",
                     "experiment 2, 10 |e|: roll RMS in deg", "experiment 2, 10 |e|: mean r1, r2"):  # fmt: skip
        assert rows[quantity]["holds"] is True, quantity


def test_suh_on_a_sensor_at_rest_and_on_one_that_is_turned(tmp_path, capsys):
    samples = suh_cart.still(np.random.default_rng(4), suh_cart.his)
    _, rows = judged(capsys, "suh", "--data", imu_csv(tmp_path / "rest.csv", samples), *G350)
    assert rows["experiment 1: largest roll error"]["holds"] is True
    assert not any(quantity.startswith("experiment 2") for quantity in rows)
    t = np.arange(6000) / 100.0
    w, f = level_at_rest(len(t))
    w[:, 0] = 0.25 * np.cos(0.5 * t)
    f = Rotation.from_euler("X", 0.5 * np.sin(0.5 * t)[:, None]).inv().apply(f)
    turned = m_g350(np.random.default_rng(4), t, w, f)
    _, rows = judged(capsys, "suh", "--data", imu_csv(tmp_path / "turned.csv", turned), *G350)
    assert rows["attitude: range of pitch or roll"]["holds"] is False


def drive(folder, seconds=60.0):
    rng = np.random.default_rng(5)
    m = motion("car", seconds, 100.0)
    samples, fixes = sensed(m, rng)[0], received(m, rng)
    table = np.column_stack([fixes["t_ns"] * 1e-9, np.degrees(fixes["lat"]), np.degrees(fixes["lon"]), fixes["height"]])
    table = np.column_stack([table, np.full(len(table), 9)])
    np.savetxt(folder / "gnss.csv", table, delimiter=",", header=GNSS, comments="", fmt="%.9f")
    return imu_csv(folder / "imu.csv", samples), str(folder / "gnss.csv")


def test_prasanna_on_a_drive(tmp_path, capsys):
    imu, gnss = drive(tmp_path)
    code, rows = judged(capsys, "prasanna", "--data", imu, "--gnss", gnss, *G350)
    assert code == 0
    for quantity in ("fixes; of them with 4 satellites or fewer", "his filter: roughness of the track, of the fixes'",
                     "his filter: RMS distance from the fixes"):  # fmt: skip
        assert rows[quantity]["holds"] is True, quantity
    printed = next(row for name, row in rows.items() if "9.8 sin(angle) as printed" in name)
    mended = next(row for name, row in rows.items() if "by the rotation" in name)
    assert float(printed["ours"].split()[0]) > 3.0 * float(mended["ours"].split()[0])


def test_what_a_paper_cannot_use_is_named(tmp_path):
    imu, _ = drive(tmp_path, 20.0)
    with pytest.raises(BadDataError, match=r"0 fixes of a receiver; at least 10 are needed \(--gnss FILE\)"):
        prasanna_recorded.reproduce(recorded.read(Path(imu), None, None, ()))
    with pytest.raises(BadDataError, match="gx_radps"):
        recorded.read(tmp_path / "gnss.csv", None, None, ())
    slow = imu_csv(tmp_path / "slow.csv", at_rest(60.0, rate_hz=5.0))
    assert main(["reproduce", "suh", "--data", slow]) == 65
    assert main(["reproduce", "suh", "--data", str(tmp_path / "none.csv")]) == 66
    assert main(["reproduce", "suh", "--set", "imu.profile=m-g350"]) == 64
    short = imu_csv(tmp_path / "short.csv", at_rest(5.0))
    assert main(["reproduce", "farrell", "--data", short]) == 0  # and says that it is too short


def test_the_page_of_a_recording_has_a_table_whose_columns_align(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("imud.commands.reproduce._PAGE", 1000)  # columns: a line for each row
    pytest.importorskip("plotly", reason="figures need the extra imud[plots]")
    file = imu_csv(tmp_path / "imu.csv", at_rest(60.0))
    assert main(["reproduce", "farrell", "--data", file, *G350, "-o", str(tmp_path)]) == 0
    page = (tmp_path / "farrell.html").read_text()
    text = capsys.readouterr().out.splitlines()
    rows = page.split("<tbody>")[1].split("</tbody>")[0].split("</tr>")[:-1]
    assert len(rows) == len(text) - 6  # title, blank line, head, rule; blank line, legend
    assert all(row.count("<td>") == 4 for row in rows)
    assert page.count("<th>") == 4


def test_a_table_in_a_page_is_escaped(tmp_path):
    pytest.importorskip("plotly", reason="figures need the extra imud[plots]")
    figures.write("a", "", [], tmp_path / "a.html", [("x", "y"), ("<b>", "1 < 2")])
    page = (tmp_path / "a.html").read_text()
    assert "<tr><th>x</th><th>y</th></tr>" in page
    assert "<tr><td>&lt;b&gt;</td><td>1 &lt; 2</td></tr>" in page


# --- the parts ---


def test_gravity_is_removed_by_the_rotation_and_not_by_the_print():
    """SciPy turns a level acceleration into a tilted unit at rest; the rotation finds it again."""
    for roll, pitch in np.random.default_rng(1).uniform(-1.2, 1.2, (20, 2)):
        turn = Rotation.from_euler("YX", [pitch, roll]).inv()
        f = turn.apply([0.7, -0.4, -9.80665])[None]
        angles = np.array([roll]), np.array([pitch])
        np.testing.assert_allclose(compensation.mended(f, *angles)[0], [0.7, -0.4], atol=1e-12)
        still = turn.apply([0.0, 0.0, -9.8])[None]
        left = compensation.as_printed(still, *angles)[0]
        np.testing.assert_allclose(left, [0.0, 9.8 * math.sin(roll) * (1.0 + math.cos(pitch))], atol=1e-12)


def test_integration_methods_on_a_known_motion():
    """a = cos t: the trapezoid and Runge and Kutta are of second order in these samples, Euler of the first."""
    errors = {}
    for T in (0.02, 0.01):
        t = np.arange(0.0, 6.0 + T / 2, T)
        for name, method in farrell_open_ends.METHODS.items():
            v, p = method(np.cos(t), T)
            errors[name, T] = abs(v[-1] - math.sin(t[-1])), abs(p[-1] - (1.0 - math.cos(t[-1])))
    for name, order in (("Euler", 2.0), ("predictor and corrector", 4.0), ("Runge and Kutta", 4.0)):
        for i in range(2):
            assert errors[name, 0.02][i] / errors[name, 0.01][i] == pytest.approx(order, rel=0.1)


def test_another_filter_is_not_called_identical():
    p = farrell.parameters()
    t = np.arange(3001) / 100.0
    samples = m_g350(np.random.default_rng(3), t, *level_at_rest(len(t)))
    run = farrell.filtered(samples, np.zeros(len(t)))
    assert all(row.holds for row in farrell_open_ends.implementation_rows(samples, run, p))
    p["position_var"] = 1e-6
    assert not any(row.holds for row in farrell_open_ends.implementation_rows(samples, run, p))
