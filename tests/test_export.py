"""`imud export`: a recording of a receiver alone; tracks as other programs read them. Oracles: gpxpy, ElementTree."""

import argparse
import csv
import io
import json
import math
import shutil
import subprocess
from contextlib import ExitStack
from pathlib import Path
from xml.etree import ElementTree

import gpxpy
import msgspec
import numpy as np
import pytest
from emulated import REST
from emulated_recording import record
from nmea_lines import gga
from recorded import message
from scipy.spatial.transform import Rotation

from imud.commands import export, main
from imud.drivers.capture_messages import READS, Connection
from imud.drivers.sample import SAMPLE
from imud.errors import BadDataError, UsageError
from imud.estimators import registry
from imud.estimators.records import FIX, HEIGHT_VALID, MEASUREMENT, POSITION_VALID, SOLUTION
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.scenarios import SCENARIOS
from imud.progress import Progress
from imud.recording import tracks
from imud.recording.file import RecordingFile
from imud.tables.inputs import read_aiding, read_imu

SECOND = 1_000_000_000


def recorded(path, fixes):
    file = RecordingFile(path, {"version": "0", "session": "boat"}, b"{}", 0)
    said = Connection(0, 0, "/dev/ttyUSB0", True, "gnss", "nmea", {"identity": {"driver": "nmea", "model": ""}})
    file.write("/connections", 0, msgspec.json.encode(said))
    for second in range(fixes):
        for t_ns, data in ((second * SECOND, gga(f"12000{second}.000")), (second * SECOND + SECOND // 2, b"")):
            file.write(READS, t_ns, message(t_ns, data))
    file.finish()
    return path


NOTHING = dict.fromkeys(("csv", "parquet", "ros2", "gpx", "kml", "geojson"))


def exported(recording, **outputs):
    return export.run(argparse.Namespace(recording=[recording], rate=0.0, **{**NOTHING, "smooth": False, **outputs}))


def test_fixes_without_an_inertial_sensor_are_exported(tmp_path, capsys):
    assert exported(recorded(tmp_path / "boat.mcap", 5), csv=tmp_path / "boat") == 0
    assert not (tmp_path / "boat" / "states.csv").exists()
    rows = list(csv.DictReader((tmp_path / "boat" / "gnss.csv").open()))
    assert [(int(float(row["arrival_s"])), float(row["height_m"])) for row in rows] == [(s, 592.3) for s in range(1, 5)]
    assert "no samples of an inertial sensor in it: there are fixes only" in capsys.readouterr().err


def test_a_recording_with_neither_samples_nor_fixes_is_bad_data(tmp_path):
    with pytest.raises(BadDataError, match="no samples of an inertial sensor"):
        exported(recorded(tmp_path / "boat.mcap", 0), csv=tmp_path / "boat")


@pytest.mark.parametrize("command", ["replay {} -o {}", "export {} --gpx {}", "report {} -o {}", "allan {} -o {}"])
def test_progress_ends_at_the_end_of_the_file(tmp_path, monkeypatch, command):
    """A bar that stops at 98 % leaves the next words of the command, or the prompt of the shell, behind it."""
    recording, shown = tmp_path / "still.mcap", []
    if command.startswith("report"):  # it needs estimates
        shutil.copy(Path(__file__).parent / "corpus/recordings/json.mcap", recording)
    else:
        record(recording, REST, 4.0)
    monkeypatch.setattr(Progress, "at", lambda self, done: shown.append((self, 100 * done // self._total)))
    assert main(command.format(recording, tmp_path / "output").split()) == 0
    bars = dict(shown)  # the last of each bar
    assert bars and set(bars.values()) == {100}


@pytest.mark.thorough
@pytest.mark.parametrize("group_rows", [100, 100_000])
def test_parquet_files_have_the_numbers_of_the_csv_files(tmp_path, monkeypatch, group_rows):
    import polars  # takes half a second, of each worker

    monkeypatch.setattr(export.parquet_folder, "GROUP_ROWS", group_rows)
    recording, folders = tmp_path / "still.mcap", {"csv": tmp_path / "csv", "parquet": tmp_path / "parquet"}
    record(recording, REST, 4.0)
    assert exported(recording, **folders) == 0
    for name in ("imu", "est"):
        theirs = polars.read_parquet(folders["parquet"] / f"{name}.parquet")
        ours = polars.read_csv(folders["csv"] / f"{name}.csv", infer_schema_length=None)
        assert len(theirs) > 400 and set(ours.columns) <= set(theirs.columns)
        for column in ours.columns:
            known = ours[column].is_not_null()
            assert (known == theirs[column].is_not_null()).all(), column
            for a, b in zip(ours[column].filter(known), theirs[column].filter(known), strict=True):
                assert b == pytest.approx(a, rel=1e-12, abs=1e-4 if name == "est" else 1e-12), column
    boat = recorded(tmp_path / "boat.mcap", 5)
    assert exported(boat, parquet=tmp_path / "boat") == 0
    fixes = polars.read_parquet(tmp_path / "boat" / "gnss.parquet")
    assert fixes["height_m"].to_list() == [592.3] * 4 and fixes["arrival_s"].to_list() == [1.5, 2.0, 3.0, 4.0]
    assert fixes["vn_mps"].null_count() == 4 and fixes["quality"].dtype == polars.Int32
    assert not (tmp_path / "boat" / "est.parquet").exists()


def of_sources():
    """(name, row of MEASUREMENT) of some sources, each by itself 0.3 s late, and their sigmas partly unknown."""
    said = {
        "heading": {"heading_deg": 123.4, "sigma_deg": 0.3},
        "odometer": {"left_mps": 0.011, "right_mps": -0.012},
        "barometer": {"pressure_pa": 100_900.0},
        "pose": {"lat_deg": 35.0, "lon_deg": 139.0, "sn_m": 0.7},
    }
    rows = []
    for k, (name, values) in enumerate(4 * list(said.items())):
        row = np.zeros(1, MEASUREMENT)
        source = next(source for source in registry.by_name("navigation").sources if source.name == name)
        source.fill(row[0], values)
        row["t_ns"] = 108_000_000_001 + k * 400_000_000
        row["arrival_ns"] = row["t_ns"] + 300_000_000
        rows.append((name, row[0]))
    return rows


def test_a_replay_of_the_exported_tables_fuses_the_same_measurements(tmp_path):
    """So that a recording of any source can be worked on elsewhere."""
    import polars  # takes half a second, of each worker

    recording, folder, rows = tmp_path / "still.mcap", tmp_path / "csv", of_sources()
    record(recording, REST, 14.0, settings=b'{"estimator": "navigation"}', aiding=rows)
    folder.mkdir()
    (folder / "velocity.csv").write_text("of an earlier export")
    assert exported(recording, csv=folder, parquet=tmp_path / "parquet") == 0
    tables = sorted({name for name, _ in rows})
    assert {path.stem for path in folder.iterdir()} == {"imu", "gnss", "est", "states", *tables}
    for source in registry.by_name("navigation").sources:
        if source.name in tables:
            read = read_aiding(source, folder / f"{source.name}.csv", 0)
            wanted = np.array([row for name, row in rows if name == source.name])
            assert (read["t_ns"] == wanted["t_ns"]).all() and (read["arrival_ns"] == wanted["arrival_ns"]).all()
            for target in ("value", "sigma"):
                np.testing.assert_allclose(read[target], wanted[target], rtol=1e-15)
            theirs = polars.read_parquet(tmp_path / "parquet" / f"{source.name}.parquet")
            assert len(theirs) == 4 and theirs.columns[:2] == ["t_s", "arrival_s"]
    est, inn = tmp_path / "est.csv", [tmp_path / "of_recording.csv", tmp_path / "of_tables.csv"]
    assert main(["replay", str(recording), "-o", str(est), "--innovations", str(inn[0])]) == 0
    aiding = [option for name in tables for option in ("--aiding", f"{name}={folder / name}.csv")]
    command = [
        "replay",
        "--imu",
        str(folder / "imu.csv"),
        *aiding,
        "--estimator",
        "navigation",
        "--set",
        "imu.profile=m-g350",
        "-o",
        str(est),
    ]
    assert main([*command, "--innovations", str(inn[1])]) == 0
    found = [polars.read_csv(path) for path in inn]
    assert {"yaw_rad", "pose_pn_m", "pose_pe_m"} <= {*found[0]["kind"]}
    for column in ("t_s", "kind", "used"):
        assert found[0][column].to_list() == found[1][column].to_list()
    values = [each["value"].cast(polars.Float64).to_numpy() for each in found]
    np.testing.assert_allclose(*values, atol=1e-6)


START_NS = 1_700_000_000_123_000_000  # Unix time of time 0


def two_tracks():
    """Estimates from -2 s on with a pause of a minute and two seconds without a position; fixes without a height."""
    estimates, fixes = tracks.Track("imud", "a < b & c"), tracks.Track("receiver", "as it came")
    row, fix = np.zeros(1, SOLUTION), np.zeros(1, FIX)
    for second in (-2, -1, 0, 1, 61, 62, 63, 64, 65):
        row["t_ns"], row["lat"], row["lon"], row["height"] = second * SECOND, 0.9, -3.0 - 1e-6 * second, 50.0 + second
        row["status"] = 0 if second in (62, 63) else POSITION_VALID | (HEIGHT_VALID if second < 60 else 0)
        row["sigma_p"] = 1.5, 2.5, 3.5
        estimates.add(tracks.point_of_solution(row[0], START_NS))
    for second in range(4):
        fix["t_ns"], fix["lat"], fix["lon"], fix["height"] = second * SECOND, 0.9, 0.1 + 1e-6 * second, np.nan
        fix["sigma"] = (2.0, 3.0, np.nan) if second else np.nan
        fixes.add(tracks.point_of_fix(fix[0], START_NS))
    return [estimates, fixes]


def written(name):
    file = io.StringIO()
    tracks.WRITERS[name](file, two_tracks())
    return file.getvalue()


def test_a_gpx_file_has_both_tracks_with_times_and_sigmas():
    gpx = gpxpy.parse(written("gpx"))
    estimates, fixes = gpx.tracks
    assert (estimates.name, estimates.description, fixes.name) == ("imud", "a < b & c", "receiver")
    assert [len(segment.points) for segment in estimates.segments] == [4, 1, 2]
    assert [len(segment.points) for segment in fixes.segments] == [4]
    first = estimates.segments[0].points[0]
    assert (first.latitude, first.longitude) == pytest.approx((math.degrees(0.9), math.degrees(-3.0 + 2e-6)), abs=1e-9)
    assert first.elevation == 48.0
    assert first.time.timestamp() == pytest.approx(START_NS * 1e-9 - 2.0, abs=1e-6)
    assert {child.tag.partition("}")[2]: float(child.text) for child in first.extensions} == {
        **{"sigma_n_m": 1.5, "sigma_e_m": 2.5, "sigma_d_m": 3.5}
    }
    assert estimates.segments[1].points[0].elevation is None
    assert [len(point.extensions) for point in fixes.segments[0].points] == [0, 2, 2, 2]


def test_a_kml_file_has_as_many_times_and_sigmas_as_coordinates():
    spaces = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
    root = ElementTree.fromstring(written("kml"))
    found = root.findall(".//gx:Track", spaces)
    assert [len(track.findall("gx:coord", spaces)) for track in found] == [4, 1, 2, 4]
    for track in found:
        n = len(track.findall("gx:coord", spaces))
        assert len(track.findall("k:when", spaces)) == n
        assert [len(a.findall("gx:value", spaces)) for a in track.findall(".//gx:SimpleArrayData", spaces)] == [n] * 3
    modes = [track.find("k:altitudeMode", spaces).text for track in found]
    assert modes == ["absolute", "clampToGround", "clampToGround", "clampToGround"]
    lon, lat, height = map(float, found[0].find("gx:coord", spaces).text.split())
    assert (lon, lat, height) == pytest.approx((math.degrees(-3.0 + 2e-6), math.degrees(0.9), 48.0), abs=1e-8)


def test_a_geojson_file_has_lines_and_points():
    features = json.loads(written("geojson"))["features"]
    lines = [feature for feature in features if feature["geometry"]["type"] == "MultiLineString"]
    assert [[len(line) for line in each["geometry"]["coordinates"]] for each in lines] == [[4, 2], [4]]
    points = [feature for feature in features if feature["geometry"]["type"] == "Point"]
    assert len(points) == 7 + 4
    assert points[0]["properties"] == {
        **{"track": "imud", "time": "2023-11-14T22:13:18.123Z"},
        **{"sigma_n_m": 1.5, "sigma_e_m": 2.5, "sigma_d_m": 3.5},
    }
    assert [len(point["geometry"]["coordinates"]) for point in points] == [3] * 4 + [2] * 7


def test_the_tracks_of_a_recording(tmp_path):
    path = recorded(tmp_path / "boat.mcap", 5)
    files = {name: tmp_path / f"boat.{name}" for name in ("gpx", "kml", "geojson")}
    assert exported(path, **files) == 0
    (track,) = gpxpy.parse(files["gpx"].read_text()).tracks
    assert (track.name, track.segments[0].points[0].latitude) == ("receiver", pytest.approx(48.1173, abs=1e-6))
    assert [point.elevation for point in track.segments[0].points] == pytest.approx([592.3] * 4)
    assert ElementTree.parse(files["kml"]).getroot().tag.endswith("kml")
    assert len(json.loads(files["geojson"].read_text())["features"]) == 5


def replayed(folder, seed=3):
    """A recording with samples of a G350 at rest, and fixes of nobody."""
    path = folder / "rest.mcap"
    record(path, Trajectory(SCENARIOS["rest"](0.0, 0.0, 0.0), 35.0, 139.0, 60.0), 12.0)
    return path


def test_a_smoothed_track_stands_beside_the_causal_one(tmp_path, monkeypatch):
    """Of an estimator that can run backward; the smoother's own output is that of `imud replay --smooth`."""
    causal, smoothed = [], []
    monkeypatch.setattr(export.TrackFiles, "write_smoothed", lambda self, rows: smoothed.append(rows.copy()))
    monkeypatch.setattr(export.TrackFiles, "step", lambda self, samples, rows: causal.append(rows.copy()))
    path = replayed(tmp_path)
    assert exported(path, gpx=tmp_path / "a.gpx", smooth=True) == 0
    assert main(["replay", str(path), "--smooth", "-o", str(tmp_path / "smooth.csv")]) == 0
    rows = list(csv.DictReader((tmp_path / "smooth.csv").open()))
    ours = np.concatenate(smoothed)
    assert len(rows) == len(ours) == len(np.concatenate(causal))
    np.testing.assert_allclose(
        [float(row["sroll_deg"]) for row in rows], np.degrees(ours["sigma_rpy"][:, 0]), atol=1e-5
    )
    with pytest.raises(UsageError, match="--smooth is for --gpx"):
        exported(path, csv=tmp_path / "folder", smooth=True)


def test_the_tracks_are_named_and_in_order():
    files = export.TrackFiles({}, 0.0, START_NS, ExitStack())
    row = np.zeros(1, SOLUTION)
    row["lat"], row["status"] = 0.9, POSITION_VALID
    files.step(row, row)
    files.write_smoothed(row)
    file = io.StringIO()
    files._write(tracks.write_gpx, file)
    assert [track.name for track in gpxpy.parse(file.getvalue()).tracks] == ["imud", "smoothed"]


def test_the_device_s_own_tilt_goes_to_csv_and_back(tmp_path):
    samples = np.zeros(3, SAMPLE)
    samples["t_ns"], samples["f"] = np.arange(3) * 10_000_000, (0.0, 0.0, -9.8)
    turn = Rotation.from_euler("ZYX", [[0.3, -0.2, 0.5], [0.1, 0.4, -2.0]])
    samples["down"][:2] = turn.inv().apply([0.0, 0.0, 1.0])
    with ExitStack() as stack:
        export.CsvFolder(tmp_path, 0.0, stack).step(samples, np.zeros(3, SOLUTION))
    head, first, _, last = (tmp_path / "imu.csv").read_text().splitlines()
    assert head.endswith("device_roll_deg,device_pitch_deg") and last.endswith(",,")
    assert [float(cell) for cell in first.split(",")[-2:]] == pytest.approx(np.degrees([0.5, -0.2]))
    np.testing.assert_allclose(read_imu(tmp_path / "imu.csv")[0]["down"], samples["down"], atol=1e-12)


@pytest.mark.skipif(
    not (shutil.which("gpsbabel") and shutil.which("ogr2ogr")), reason="gpsbabel and ogr2ogr are absent"
)
def test_gpsbabel_and_ogr2ogr_open_the_tracks(tmp_path):
    for name in ("gpx", "kml", "geojson"):
        (tmp_path / f"t.{name}").write_text(written(name))
    said = subprocess.run(
        ["gpsbabel", "-t", "-i", "gpx", "-f", tmp_path / "t.gpx", "-o", "unicsv", "-F", "-"],
        capture_output=True,
        check=True,
    )
    assert len(said.stdout.decode().strip().splitlines()) == 1 + 7 + 4
    for name, layer in (("gpx", "track_points"), ("kml", "imud"), ("geojson", "t")):
        out = tmp_path / f"{name}.csv"
        subprocess.run(["ogr2ogr", "-f", "CSV", out, tmp_path / f"t.{name}", layer], capture_output=True, check=True)
        assert len(out.read_text().splitlines()) > 2
