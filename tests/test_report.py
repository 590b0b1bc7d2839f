"""`imud report`: its statistics against other people's, its words against runs with known faults, its page."""

import asyncio
import gzip
import json
import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from report_data import WHITE, still
from test_recording_damage import write

from imud.commands import main
from imud.commands.report import distinct_labels, read
from imud.commands.report.content import panels
from imud.commands.report.findings import findings
from imud.commands.report.session import Estimates, Part, Session, merged
from imud.estimators.filter_states import FILTER_STATES
from imud.estimators.records import ATTITUDE_VALID, FIX, INNOVATION, POSITION_N, POSITION_VALID, REJECTING, SOLUTION
from imud.filter_state_names import PLACES
from imud.tables.estimates import EstimateWriter, write_innovations
from imud.tables.filter_states import write_states
from imud.tables.inputs import IMU_COLUMNS

RECORDED = Path(__file__).parent / "corpus/recordings/json.mcap"


@pytest.fixture
def files(tmp_path):
    """est.csv, innovations.csv, imu.csv and gnss.csv of 30 s on a straight road; their folder."""
    n = 300
    rows = np.zeros(n, SOLUTION)
    rows["t_ns"] = np.arange(n) * 100_000_000
    rows["status"] = ATTITUDE_VALID | POSITION_VALID
    rows["status"][:30] |= REJECTING
    rows["lat"], rows["lon"], rows["q_nb"][:, 0] = np.radians(48.0) + np.arange(n) * 1e-7, np.radians(11.0), 1.0
    for name in ("sigma_p", "sigma_v", "sigma_rpy", "sigma_bg", "sigma_ba"):
        rows[name] = 0.1
    with (tmp_path / "est.csv").open("wb") as file:
        EstimateWriter(file, 1000).write(rows)
    innovation_rows = np.zeros(30, INNOVATION)
    innovation_rows["t_ns"], innovation_rows["kind"], innovation_rows["used"] = (
        np.arange(30) * 1_000_000_000,
        POSITION_N,
        1,
    )
    innovation_rows["value"], innovation_rows["variance"] = 3.0 * WHITE[:30], 1.0
    write_innovations(tmp_path / "innovations.csv", 1000, innovation_rows)
    imu = "".join(f"{1000 + k / 100},0,0,0,0,0,{-9.81 + 0.001 * (k % 7)}\n" for k in range(3000))
    (tmp_path / "imu.csv").write_text(f"t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2\n{imu}")
    fixes = "".join(f"{1000 + k},48.0,11.0,500,{1000.2 + k},1.0\n" for k in range(30))
    (tmp_path / "gnss.csv").write_text(f"t_s,lat_deg,lon_deg,height_m,arrival_s,hdop\n{fixes}")
    return tmp_path


NAMES = ("est.csv", "innovations.csv", "imu.csv", "gnss.csv")


def test_a_short_run_is_not_judged_but_nothing_is_wrong_with_it(tmp_path, capsys):
    rows = np.zeros(10, INNOVATION)
    rows["t_ns"], rows["kind"], rows["used"] = np.arange(10) * 1_000_000_000, POSITION_N, 1
    rows["value"], rows["variance"] = WHITE[:10], 1.0
    write_innovations(tmp_path / "innovations.csv", 1000, rows)
    assert main(["report", str(tmp_path / "innovations.csv"), "-o", str(tmp_path / "run.html")]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "Nothing looks wrong."
    assert said[1] == "innovations: too few innovations to judge the filter by pn_m (10); 20 are needed."


def test_innovations_come_back_as_they_were_written(files):
    session = read([files / name for name in NAMES])
    (found,) = session.innovations
    assert found.kind == "pn_m" and found.used.all()
    assert found.normalised == pytest.approx(3.0 * WHITE[:30])
    assert found.t == pytest.approx(np.arange(30.0), abs=1e-6)
    assert session.fixes[0].rows["t_ns"][0] == session.sensors[0].columns["t_s"][0] == 0


@pytest.mark.parametrize("clock", [True, False], ids=["with clock", "as older versions wrote it"])
def test_a_recording_gives_the_same_report_as_tables(clock, tmp_path):
    pytest.importorskip("mcap", reason="recordings need the extra imud[record]")
    from imud.recording.clock_fit import CLOCK_FIT
    from imud.recording.file import RecordingFile
    from imud.recording.messages import CLOCK_TABLE, ESTIMATE_TABLE, FIX_TABLE, INNOVATION_TABLE, SAMPLE_TABLE

    estimates, innovation_rows, samples, fixes = (
        np.zeros(100, SOLUTION),
        np.zeros(30, INNOVATION),
        still(500),
        np.zeros(9, FIX),
    )
    estimates["t_ns"], innovation_rows["t_ns"] = (
        5_250_000_000 + np.arange(100) * 10**8,
        6_000_000_000 + np.arange(30) * 10**8,
    )
    estimates["status"], estimates["q_nb"][:, 0], estimates["lat"] = ATTITUDE_VALID | POSITION_VALID, 1.0, 0.5
    innovation_rows["kind"], innovation_rows["value"], innovation_rows["variance"] = POSITION_N, 2.0 * WHITE[:30], 4.0
    innovation_rows["used"][:27] = 1
    samples["t_ns"] += 5_000_000_000
    fixes["t_ns"], fixes["arrival_ns"], fixes["lat"] = 6_000_000_000, 6_200_000_000, 0.5
    file = RecordingFile(tmp_path / "drive.mcap", {"version": "0"}, b"{}", 0)
    tables = [
        (ESTIMATE_TABLE, estimates),
        (INNOVATION_TABLE, innovation_rows),
        (SAMPLE_TABLE, samples),
        (FIX_TABLE, fixes),
    ]
    fits = np.zeros(3, CLOCK_FIT)
    fits["t_ns"], fits["drift"], fits["sigma_drift"] = 6_000_000_000 + np.arange(3) * 10**9, 2e-5, 1e-6
    fits["drift"][0], fits["lost"], fits["bad"] = np.nan, (3, 5, 1), 7  # it was connected anew after the second
    if clock:
        tables.append((CLOCK_TABLE, fits))
        event = {"t_ns": 6_500_000_000, "level": "warning", "text": "the fixes are refused", "facts": {"hdop": "9"}}
        file.write("/events", event["t_ns"], msgspec.json.encode(event))
    for table, rows in tables:
        for row, message in zip(rows, table.encode(rows), strict=True):
            file.write(table.topic, int(row["t_ns"]), message)
    file.finish()
    session = read([tmp_path / "drive.mcap"])
    assert session.estimates[0].columns["t_s"][:2] == pytest.approx([0.25, 0.35])
    assert session.estimates[0].columns["lat_deg"] == pytest.approx(np.degrees(0.5))
    (found,) = session.innovations
    assert found.kind == "pn_m" and found.normalised == pytest.approx(WHITE[:30])
    assert found.t[0] == pytest.approx(1.0) and np.count_nonzero(found.used) == 27
    assert session.sensors[0].rate_hz == pytest.approx(100.0)
    latency = session.fixes[0].rows["arrival_ns"] - session.fixes[0].rows["t_ns"]
    assert (latency == 200_000_000).all()
    assert len(session.clocks) == len(session.events) == int(clock)
    text = "\n".join(findings(session))
    assert ("drive: 6 samples are missing" in text) == ("drive: 7 frames were damaged" in text) == clock
    titles = {panel.title for figure in panels(session) for panel in figure.panels}
    assert ("Clock drift ± σ" in titles) == clock and {"Rates, FRD", "Plan"} <= titles
    assert {title.split(" (")[0] for title in titles} >= {"roll", "north", "east", "down", "x", "y", "z"}
    if clock:
        assert session.clocks[0].rows["drift"][1:] == pytest.approx(2e-5)
        assert session.events[0].t == pytest.approx(1.5) and session.events[0].text == "the fixes are refused (hdop 9)"


def test_a_report_sees_every_sample_also_of_a_recording_that_keeps_few(tmp_path):
    """They are decoded from the bytes, as `imud export` does it."""
    reader = pytest.importorskip("mcap.reader", reason="recordings need the extra imud[record]")
    from mcap.writer import Writer

    from imud.recording.samples import samples_of

    path = tmp_path / "thinned.mcap"
    with RECORDED.open("rb") as source, path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        whole, known = reader.make_reader(source), {}
        for record in whole.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for kept_file in whole.iter_attachments():
            writer.add_attachment(
                kept_file.create_time, kept_file.log_time, kept_file.name, kept_file.media_type, kept_file.data
            )
        for schema, channel, message in whole.iter_messages():
            if channel.topic == "/imu/samples":
                continue
            if channel.topic not in known:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(known[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    (sensor,) = read([path]).sensors
    samples, _, _ = samples_of(RECORDED)
    assert sensor.rate_hz == pytest.approx(1e9 / np.median(np.diff(samples["t_ns"])))
    assert sensor.columns["wz"].max() == pytest.approx(samples["w"][:, 2].max())
    assert sensor.columns["wz"].min() == pytest.approx(samples["w"][:, 2].min())


def test_what_the_filter_estimates_beside_its_solution_is_drawn_from_tables_and_recordings(files):
    """Of a run that overlaps est.csv, whose time 0 is 1000 s: a time offset throughout, a mounting from the second row
    on, nothing of an odometer."""
    pytest.importorskip("mcap", reason="recordings need the extra imud[record]")
    from imud.recording.file import RecordingFile
    from imud.recording.messages import ESTIMATE_TABLE, STATES
    from imud.recording.state_messages import states_message

    rows = np.zeros(3, FILTER_STATES)
    rows["t_ns"], rows["value"], rows["sigma"] = (2_500_000_000, 3_500_000_000, 4_500_000_000), np.nan, np.nan
    rows["value"][:, PLACES["time_offset"]], rows["sigma"][:, PLACES["time_offset"]] = (0.1, 0.2, 0.3), 0.05
    rows["value"][1:, PLACES["mount_yaw"]], rows["sigma"][1:, PLACES["mount_yaw"]] = np.radians(30.0), 0.1
    write_states(files / "states.csv", 1000, rows)
    file = RecordingFile(files / "drive.mcap", {"version": "0"}, b"{}", 0)
    estimates = np.zeros(2, SOLUTION)
    estimates["t_ns"] = 1_002_000_000_000, 1_005_000_000_000
    for message in ESTIMATE_TABLE.encode(estimates):
        file.write(ESTIMATE_TABLE.topic, 0, message)
    rows["t_ns"] += 1000 * 10**9
    for row in rows:
        file.write(STATES, 0, states_message(row))
    file.finish()
    for name in ("states.csv", "drive.mcap"):
        session = read([files / "est.csv", files / name])
        figures = [figure for figure in panels(session) if "beside" in figure.title]
        assert [figure.title.rpartition(" ")[2] for figure in figures] == ["receiver", "vehicle"]
        ((delay,), (yaw,)) = (figure.panels for figure in figures)
        (trace,) = delay.traces
        assert (delay.title, delay.y) == ("time offset", "s")
        assert trace.x == pytest.approx([2.5, 3.5, 4.5]) and trace.y == pytest.approx([0.1, 0.2, 0.3])
        assert trace.sigma == pytest.approx(0.05)
        assert np.isnan(yaw.traces[0].y[0]) and yaw.traces[0].y[1:] == pytest.approx(30.0)


def test_runs_at_the_same_time_share_an_axis_and_those_of_other_days_lie_over_them():
    def part(first, last):
        columns = {name: np.array([0.25, 1.0]) for name in ("t_s",)}
        run = Estimates("run", columns, np.zeros(2, int), {}, (0.5,))
        return Part(int(first), first, last, Session(estimates=(run,)))

    whole = merged([part(1000.25, 1030.0), part(90_000.25, 90_010.0), part(1020.0, 1040.0)])
    assert [run.columns["t_s"][0] for run in whole.estimates] == [0.25, 20.25, 0.25]
    assert [run.lost_s for run in whole.estimates] == [(0.5,), (20.5,), (0.5,)]


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["a/drive.mcap", "b/other.csv"], ["drive", "other"]),
        (["a/drive.mcap", "a/drive.csv"], ["drive.mcap", "drive.csv"]),
        (["a/drive.mcap", "b/drive.mcap"], ["a/drive.mcap", "b/drive.mcap"]),
    ],
)
def test_overlaid_files_have_distinct_labels(paths, names):
    assert distinct_labels([Path(path) for path in paths]) == names


def test_the_page_contains_text_and_figures_of_the_files(files, capsys):
    pytest.importorskip("plotly", reason="pages need the extra imud[web]")
    page = files / "report.html"
    assert main(["report", *(str(files / name) for name in NAMES), "-o", str(page)]) == 0
    text = capsys.readouterr().err
    assert "pn_m: overconfident" in text and "est: fixes contradict the estimate in 10 %" in text
    html = page.read_text()
    for words in ("Attitude", "Plan", "innovation ±σ", "N(0, 1)", "autocorrelation", "χ²", "95 % ellipses", "Latency"):
        assert json.dumps(words)[1:-1] in html or words in html, words
    asyncio.run(_look(page, files))


async def _look(page, folder):
    """In a browser, where there is one: every figure is drawn, and nothing is asked of the network."""
    pytest.importorskip("aiohttp", reason="Chromium is driven by aiohttp, of the extra imud[web]")
    from browser import DESKTOP, browser, program

    if program() is None:
        pytest.skip("no Chromium here")
    async with browser(folder / "profile") as tab:
        await tab.open(page.as_uri())
        await tab.until("document.querySelectorAll('.plotly-graph-div').length > 8")
        await tab.until("[...document.querySelectorAll('.plotly-graph-div')].every(d => d.querySelector('.main-svg'))")
        for scheme, back in (("dark", "rgb(18, 23, 28)"), ("light", "rgb(255, 255, 255)")):  # as the browser asks for
            await tab.size(DESKTOP, scheme)
            await tab.until(f"getComputedStyle(document.documentElement).backgroundColor === '{back}'")
            figures = "[...document.querySelectorAll('.plotly-graph-div .main-svg:first-child')]"
            await tab.until(f"{figures}.every(svg => getComputedStyle(svg).backgroundColor === '{back}')")
        assert tab.errors == []
        assert {url for url in tab.requests if not url.startswith("data:")} == {page.as_uri()}


@pytest.mark.parametrize(
    ("content", "code", "says"),
    [
        (None, 66, "no such file"),
        ("a,b\n1,2\n", 65, "line 1"),
        ("t_s,kind,value,sigma,used\n", 65, "no rows"),
        ("t_s,kind,value,sigma,used\n0,pn_m,x,1,1\n", 65, "line 2: value is 'x'"),
        ("t_s,kind,value,sigma,used\n0,pn_m,1\n", 65, "line 2: 3 columns instead of 5"),
        ("t_s,kind,value,sigma,used\n0,pn_m,1,1,1\nnan,pn_m,1,1,1\n", 65, "line 3: t_s is nan"),
        (f"{','.join(IMU_COLUMNS)}\n{'0,' * 6}0\n{'nan,' * 6}0\n", 65, "line 3: t_s is nan"),
        (f"{','.join(IMU_COLUMNS)}\n{'1e19,' * 6}0\n", 65, "line 2: t_s is 1e+19, no time in seconds"),
    ],
)
def test_bad_files_are_reported(content, code, says, tmp_path, capsys):
    pytest.importorskip("plotly", reason="pages need the extra imud[web]")
    path = tmp_path / "x.csv"
    if content is not None:
        path.write_text(content)
    assert main(["report", str(path), "-o", str(tmp_path / "x.html")]) == code
    assert says in capsys.readouterr().err


TABLES = {
    "tabs": lambda text: text.replace(",", "\t").encode(),
    "semicolons, decimal commas": lambda text: text.replace(",", ";").replace(".", ",").encode(),
    "UTF-16": lambda text: text.encode("utf-16"),
    "gzip": lambda text: gzip.compress(text.encode()),
    "comments": lambda text: f"# a logger\n{text}".encode(),
    "cut off": lambda text: f"{text}1030.5,1".encode(),
    "cut off by a loss of power": lambda text: text.encode() + bytes(512),
}


@pytest.mark.parametrize("form", TABLES)
def test_a_table_of_any_make_gives_the_same_report(form, files, tmp_path):
    """As `imud replay` reads them: tests/test_tables.py."""
    (tmp_path / "other").mkdir()
    for name in NAMES:
        (tmp_path / "other" / name).write_bytes(TABLES[form]((files / name).read_text()))
    plain, other = (read([folder / name for name in NAMES]) for folder in (files, tmp_path / "other"))
    drawn, as_drawn = (msgspec.json.encode(panels(session), enc_hook=np.ndarray.tolist) for session in (other, plain))
    assert drawn == as_drawn
    assert findings(other) == findings(plain)


def test_of_a_recording_in_which_no_sensor_streamed_no_replay_is_advised(tmp_path, capsys):
    path = write(tmp_path / "empty.mcap")
    assert main(["report", str(path), "-o", str(tmp_path / "page.html")]) == 65
    assert capsys.readouterr().err == f"imud: {path}: no samples of an inertial sensor in it\n"


def test_a_page_that_cannot_be_written_is_reported(files, capsys):
    pytest.importorskip("plotly", reason="pages need the extra imud[web]")
    assert main(["report", str(files / "est.csv"), "-o", str(files / "no" / "x.html")]) == 73
    assert "cannot write" in capsys.readouterr().err


def test_files_of_any_name(files, tmp_path):
    pytest.importorskip("plotly", reason="pages need the extra imud[web]")
    for name in (os.fsdecode(b"\xff.csv"), "<script>x</script>.csv".replace("/", "")):
        (tmp_path / name).write_bytes((files / "est.csv").read_bytes())
        assert main(["report", str(tmp_path / name), "-o", str(tmp_path / "x.html")]) == 0
        assert "<script>x" not in (tmp_path / "x.html").read_text(encoding="utf-8")
