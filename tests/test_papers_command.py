"""`imud reproduce`: table, JSON, figures, exit codes; and that every paper's estimator runs in `imud replay`."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from imud import figures
from imud.commands import main
from imud.configuration.settings import GpsTrack, Ins9, Settings, Stationary
from imud.estimators import registry
from imud.experiments import farrell, prasanna, simulate, suh
from imud.experiments.report import Report, Row, at_most, within
from imud.experiments.runs import AxisRun
from imud.figures import Figure, Panel, Trace

pytestmark = pytest.mark.usefixtures("papers_as_c")

PAPERS = ("stationary", "suh-standard", "suh-adaptive", "suh-two-step", "gps-track", "ins9")


def report_of(*rows, drawn=()):
    return Report("a title", rows, drawn)


def a_figure():
    x = np.linspace(0.0, 1.0, 50_000)
    panel = Panel("a panel", "time [s]", "error [m]", [Trace("error", x, x, np.full(len(x), 0.5))], equal=True)
    return Figure("a figure", [panel, panel, panel])


def test_a_claim_that_holds_ends_with_0(monkeypatch, capsys):
    monkeypatch.setattr(suh, "reproduce", lambda seed: report_of(at_most("an error", "small", 1.0, 2.0, "m")))
    assert main(["reproduce", "suh"]) == 0
    assert re.search(r"ok +an error +small +1 m \(limit 2\)", capsys.readouterr().out)


def test_a_claim_that_fails_ends_with_1_and_is_named(monkeypatch, capsys):
    rows = (within("a ratio", "1", 3.0, 0.5, 2.0), Row("a number", "2", "2"))
    monkeypatch.setattr(suh, "reproduce", lambda seed: report_of(*rows))
    assert main(["reproduce", "suh"]) == 1
    said = capsys.readouterr()
    assert re.search(r"FAIL +a ratio", said.out)
    assert "does not hold: a ratio: 3" in said.err
    assert main(["reproduce", "suh", "--json"]) == 1
    table = json.loads(capsys.readouterr().out)
    assert table["holds"] is False
    assert [row["holds"] for row in table["rows"]] == [False, None]


@pytest.mark.parametrize("width", [60, 80, 1000])
def test_the_table_fits_and_loses_nothing(width):
    long = ("RMS of the error of position after 600 s", "a few mm, far below 4 cm", "0.00206 m (limit 0.005)")
    report = report_of(Row(*long, holds=True), at_most("a number", "2", 1.0, 2.0))
    title, _, head, rule, *lines = report.lines(width)
    assert max(map(len, (title, head, rule, *lines))) <= width
    starts = [head.index(word) for word in ("quantity", "paper", "ours")]
    first = lines[: next(i for i, line in enumerate(lines) if "a number" in line)]
    for start, end, text in zip(starts, [*starts[1:], None], long, strict=True):
        assert " ".join(" ".join(line[start:end] for line in first).split()) == text
    assert first[0].startswith("ok ") and not any(line[: starts[0]].strip() for line in first[1:])
    assert "no mark: a number without a claim" in " ".join(" ".join(lines).split())


def test_a_nan_is_no_success():
    assert at_most("x", "", float("nan"), 1.0).holds is False
    assert within("x", "", float("nan"), 0.0, 1.0).holds is False


def test_the_order_of_the_filters_can_fail(monkeypatch):
    """Swapping two filters must break the claim: it is not true by construction."""
    swapped = {**suh.FILTERS, "two-step": suh.FILTERS["standard"], "standard": suh.FILTERS["two-step"]}
    monkeypatch.setattr(suh, "FILTERS", swapped)
    monkeypatch.setattr(suh, "CARTS", 1)
    failed = {row.quantity for row in suh.reproduce(1).failed}
    assert "M-G350, 141 e²: roll RMS in deg" in failed
    assert "his sensors, 141 e²: carts with the order of roll largest error" in failed


def other_design(**design):
    """Settings whose `stationary` is another than Farrell's."""
    return lambda **more: Settings(stationary=Stationary(**design), **more)


def test_another_bias_model_is_not_farrell_s(monkeypatch, capsys):
    monkeypatch.setattr(farrell, "Settings", other_design(bias_psd=9e-6))
    monkeypatch.setattr(farrell, "SECONDS", 60)
    assert main(["reproduce", "farrell"]) == 1
    said = capsys.readouterr().err
    assert all(f"does not hold: Q_d 1e6 row {row}, 1000 steps of 1 ms" in said for row in (1, 2, 3))


@pytest.mark.parametrize(
    ("module", "name", "value", "rows_of", "quantity"),
    [
        (farrell, "Settings", other_design(position_var=1e-8), farrell.design_rows, "√R"),
        (farrell, "Settings", other_design(interval_s=2.0), farrell.design_rows, "time between measurements"),
        (suh.filters, "R3", 2.0, suh._parameter_rows, "r3"),
        (suh.filters, "R_LARGE", 50.0, suh._parameter_rows, "r1, r2 of the simple adaptive filter"),
        (
            suh.filters,
            "ALPHA2",
            10.0,
            suh._parameter_rows,
            "α2 of e; our rule: 141 of e², times √δ",
        ),
    ],
)
def test_another_number_than_the_papers_fails(monkeypatch, module, name, value, rows_of, quantity):
    assert all(row.holds for row in rows_of())
    monkeypatch.setattr(module, name, value)
    assert [row.quantity for row in rows_of() if not row.holds] == [quantity]


def test_other_defaults_are_not_prasanna_s(monkeypatch):
    monkeypatch.setattr(prasanna, "Settings", lambda: Settings(gps_track=GpsTrack(position_var=5.0), ins9=Ins9(0.1)))
    failed = [row.quantity for row in prasanna._parameter_rows() if not row.holds]
    assert failed == ["GPS: R", "INS: Q (ours: per second)"]


def test_a_roll_to_the_other_side_is_another_tilt():
    for side, failed in ((1.0, 0), (-1.0, 5)):  # 0 and 180 deg are the same on both sides
        tilts = [(tilt, 0.4, side * tilt, 2.0) for tilt in prasanna.TILTS_DEG]
        assert sum(row.holds is False for row in prasanna._tilt_rows(tilts)) == failed


@pytest.mark.parametrize(("shape", "holds"), [(-1.0, True), (1.0, False), (-1.1, False)])
def test_dead_reckoning_drifts_by_the_bias(shape, holds):
    t = np.linspace(0.0, 600.0, 601)
    states = shape * 0.078 * np.column_stack([0.5 * t**2, t, 0.0 * t])
    nothing = np.zeros((len(t), 3))
    run = AxisRun(t, states, nothing, nothing, np.zeros(0), np.zeros(0))
    assert [row.holds for row in farrell.drift_rows(run, 0.078)] == [holds, holds]


def test_a_sensor_worse_than_its_sheet_fails_prasanna_s_claims(monkeypatch, capsys):
    worse = replace(prasanna.PROFILE, accel_bias_initial=20.0 * prasanna.PROFILE.accel_bias_initial)
    monkeypatch.setattr(simulate, "PROFILE", worse)
    assert main(["reproduce", "prasanna"]) == 1
    assert "does not hold: tilt at " in capsys.readouterr().err


def test_an_unknown_paper_is_a_usage_error():
    with pytest.raises(SystemExit) as ended:
        main(["reproduce", "kalman"])
    assert ended.value.code == 64


def test_without_plotly_the_table_is_printed_and_the_remedy_is_named(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(suh, "reproduce", lambda seed: report_of(Row("a number", "2", "2"), drawn=[a_figure()]))
    monkeypatch.setattr(figures, "available", lambda: False)
    assert main(["reproduce", "suh", "-o", str(tmp_path)]) == 73
    said = capsys.readouterr()
    assert "a number" in said.out
    assert "pip install 'imud[plots]'" in said.err
    assert list(tmp_path.iterdir()) == []


def test_the_page_holds_everything(monkeypatch, capsys, tmp_path):
    pytest.importorskip("plotly", reason="figures need the extra imud[plots]")
    monkeypatch.setattr(
        suh, "reproduce", lambda seed: report_of(Row("a < b", "2", "2"), drawn=[a_figure(), a_figure()])
    )
    assert main(["reproduce", "suh", "-o", str(tmp_path / "new")]) == 0
    page = (tmp_path / "new" / "suh.html").read_text()
    assert "a &lt; b" in page
    for text in ("a figure", "a panel", "time [s]", "error [m]"):
        assert text in page
    assert "±σ error" in page or "\\u00b1\\u03c3 error" in page
    assert not re.search(r"<script[^>]+src=", page)  # nothing is fetched
    assert page.count("draw(document.currentScript") >= 2
    assert main(["reproduce", "suh", "-o", str(tmp_path / "new" / "suh.html")]) == 73
    assert "cannot write" in capsys.readouterr().err


@pytest.mark.parametrize("name", PAPERS)
def test_replay_runs_every_papers_estimator(name, tmp_path):
    t = np.arange(0.0, 12.0, 0.05)
    table = np.column_stack([t, 0 * t, 0 * t, 0 * t, 0 * t, 0 * t, 0 * t - 9.81])
    header = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    np.savetxt(tmp_path / "imu.csv", table, delimiter=",", header=header, comments="")
    fixes = "".join(f"{k},47.0,8.0,400.0\n" for k in range(1, 11))
    (tmp_path / "gnss.csv").write_text("t_s,lat_deg,lon_deg,height_m\n" + fixes)
    files = ["--imu", str(tmp_path / "imu.csv"), "--gnss", str(tmp_path / "gnss.csv"), "-o", str(tmp_path / "e.csv")]
    assert main(["replay", *files, "--estimator", name]) == 0
    head, *_, last = (tmp_path / "e.csv").read_text().splitlines()
    row = dict(zip(head.split(","), last.split(","), strict=True))
    knows_attitude, knows_position = name != "gps-track", not name.startswith("suh")
    assert (row["roll_deg"] != "") == (row["pitch_deg"] != "") == (row["q0"] != "") == knows_attitude
    assert (row["lat_deg"] != "") == (row["sn_m"] != "") == (row["ve_mps"] != "") == knows_position
    if knows_attitude:
        assert float(row["roll_deg"]) == pytest.approx(0.0, abs=0.01)
    if knows_position:
        assert float(row["lat_deg"]) == pytest.approx(47.0, abs=1e-7)


def test_the_registry_names_what_there_is():
    assert set(PAPERS) <= set(registry.NAMES)
    for name in registry.NAMES:
        assert registry.by_name(name).name == name
