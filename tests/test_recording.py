"""A recording of a running daemon: replayed bit for bit, played again as ports, exported; one run for all of it."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from decimal import Decimal
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from processes import TIMEOUT_S, daemon, emulator, process
from recorded import reads_of, stored

from imud.commands.replay import recordings
from imud.configuration.settings import Initial
from imud.drivers.capture import Capture
from imud.estimators.innovation_kinds import KINDS
from imud.filter_state_names import PLACES
from imud.recording import many, replaying
from imud.recording.clock_fit import row_of
from imud.recording.messages import CLOCK_TABLE, ESTIMATE_TABLE, FIX_TABLE, INNOVATION_TABLE, SAMPLE_TABLE
from imud.recording.player import Handlers, Player
from imud.recording.samples import read_samples
from imud.recording.source import Recording, adapter, group
from imud.recording.state_messages import states_rows
from imud.sensor_errors.calibration import read as read_calibration

RATE_HZ = 250  # 1000 are recorded and replayed in test_aiding_live.py
EVERY = tuple(
    word
    for setting in ("record.estimate_rate_hz=0", "record.sample_rate_hz=0", f"imu.rate_hz={RATE_HZ}")
    for word in ("--set", setting)
)
SCENARIO = ("--scenario", "car")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording of a drive until the heading is known and fixes correct the filter, every estimate in it."""
    folder = tmp_path_factory.mktemp("recording")
    imu, gnss = folder / "imu", folder / "gnss"
    ports = ("--port", str(imu), "--port", str(gnss))
    record = ("--record", str(folder / "drive.mcap"), *EVERY)
    with emulator("g350", "nmea", *SCENARIO, links=[imu, gnss]), daemon(folder, *ports, *record) as imud:
        start = imud.until(lambda m: m["class"] == "EST" and "heading" in m["state"])["t_mono_ns"]
        imud.until(lambda m: m["class"] == "EST" and m["t_mono_ns"] > start + 3_000_000_000)
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
    return folder / "drive.mcap"


def replayed(recording, estimator=None):
    steps, fixes, innovations = [], [], []

    def update(fix, rows):
        fixes.append(fix.copy())
        innovations.append(rows.copy())

    adapt = adapter(None, (), estimator)
    player = Player(
        recording.settings(adapt), adapt, Initial(), Handlers(lambda samples, rows: steps.append(rows.copy()), update)
    )
    for entry in recording:
        player.take(entry)
    return [np.concatenate(rows) for rows in (steps, fixes, innovations)]


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "imud", *map(str, arguments)], capture_output=True, text=True, check=False
    )


def test_a_replay_gives_the_daemons_estimates_bit_for_bit(recorded):
    found = replayed(Recording([recorded]))
    for rows, table in zip(found, (ESTIMATE_TABLE, FIX_TABLE, INNOVATION_TABLE), strict=True):
        assert len(rows) > 5
        kept = stored(recorded, table)
        since_the_last_fix = len(kept) - len(rows)
        assert since_the_last_fix == 0 if table is not INNOVATION_TABLE else 0 <= since_the_last_fix < 60
        for name in table.names:
            assert rows[name].tobytes() == kept[: len(rows)][name].tobytes(), name
    assert len(found[0]) > 6 * RATE_HZ


def test_without_receivers_the_samples_are_the_same(recorded):
    found = []
    for with_receivers in (True, False):
        recording, adapt, samples, fixes = Recording([recorded]), adapter(None, (), "tilt"), [], []
        handlers = Handlers(lambda rows, _, kept=samples: kept.append(rows.copy()), fix=fixes.append)
        player = Player(recording.settings(adapt), adapt, Initial(), handlers, with_receivers=with_receivers)
        for entry in recording:
            player.take(entry)
        found.append((np.concatenate(samples).tobytes(), len(fixes)))
    (samples, fixes), (alone, none) = found
    assert alone == samples
    assert fixes > 5 and none == 0


def test_a_truncated_recording_gives_the_same_up_to_its_end_and_is_reported(recorded, tmp_path):
    whole = stored(recorded, ESTIMATE_TABLE)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.read_bytes()[: recorded.stat().st_size // 2])
    recording = Recording([cut])
    rows, *_ = replayed(recording)
    assert 100 < len(rows) < len(whole)
    assert rows.tobytes() == whole[: len(rows)].tobytes()
    assert "broke off, as after a power cut, or is still being written, at" in recording.notes[0]


@pytest.fixture(scope="module")
def fleet(recorded, tmp_path_factory):
    """Arguments of recordings, of which one is none and one has nothing in it; and what one process makes of them."""
    folder = tmp_path_factory.mktemp("fleet")
    copy, hollow, empty = folder / "drive.mcap", folder / "hollow.mcap", folder / "empty.mcap"
    copy.write_bytes(recorded.read_bytes()[: recorded.stat().st_size * 2 // 3])
    hollow.write_bytes(b"\x89MCAP0\r\nnothing more")
    empty.touch()
    paths = (recorded, copy, hollow, empty)
    done = command("replay", *paths, "-o", folder / "here", "--jobs", "2")
    assert done.returncode == 65, done.stderr
    assert "2 of 4 recordings" in done.stderr
    assert "hollow.mcap: no samples" in done.stderr and "empty.mcap is no recording" in done.stderr
    return paths, {path.name: path.read_bytes() for path in (folder / "here").iterdir() if path.stat().st_size > 2000}


@pytest.mark.thorough
def test_parallel_replays_equal_single_ones(recorded, fleet, tmp_path):
    paths, made = fleet
    assert sorted(made) == [f"{paths[1].parent.name}_drive.csv", f"{recorded.parent.name}_drive.csv"]
    alone = tmp_path / "alone.csv"
    assert command("replay", recorded, "-o", alone).returncode == 0
    assert made[f"{recorded.parent.name}_drive.csv"] == alone.read_bytes()


def test_a_failure_names_its_recording_once(recorded, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.read_bytes()[:1000])
    why = many.replay_locally(replaying.Job((cut,), tmp_path / "out.csv", None, (), None, "", None))
    assert why == f"{cut} is damaged: the settings that it was made with are missing"


def killed_by_one(job):
    """What a process does that is killed while it replays the second of the jobs."""
    if job.paths[0].name == "1":
        os.kill(os.getpid(), signal.SIGKILL)
    return f"{job.paths[0]} done"


@pytest.mark.thorough
def test_a_process_that_is_killed_takes_its_own_recording_along():
    jobs = [replaying.Job((Path(str(i)),), Path("out"), None, (), None, "", None) for i in range(5)]
    outcomes = sorted(many.run_locally(jobs, 2, killed_by_one))
    assert outcomes[1].startswith("1: its process was killed")
    assert [line for line in outcomes if line.endswith("done")] == ["0 done", "2 done", "3 done", "4 done"]


def test_another_estimator_is_tried_on_the_same_bytes(recorded, tmp_path):
    out = tmp_path / "attitude.csv"
    assert command("replay", recorded, "-o", out, "--estimator", "attitude").returncode == 0
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(stored(recorded, ESTIMATE_TABLE))
    assert rows[-1]["lat_deg"] == ""
    assert command("replay", tmp_path / "absent.mcap", "-o", tmp_path / "out").returncode == 66


@pytest.mark.thorough
def test_a_cluster_gives_the_same_files(fleet, tmp_path):
    distributed = pytest.importorskip("distributed", reason="clusters need the extra imud[cluster]")
    paths, made = fleet
    given = ("replay", *paths, "-o", tmp_path / "out", "--cluster")
    with distributed.LocalCluster(n_workers=0, threads_per_worker=1, dashboard_address=None) as cluster:
        idle = command(*given, cluster.scheduler_address)
        assert (idle.returncode, "no workers" in idle.stderr) == (74, True), idle.stderr
        cluster.scale(2)
        cluster.wait_for_workers(2)
        done = command(*given, cluster.scheduler_address)
    assert done.returncode == 65 and "2 of 4 recordings" in done.stderr, done.stderr
    assert "\r" not in done.stderr and not done.stdout
    found = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir() if path.name in made}
    assert found == made
    absent = command(*given, "127.0.0.1:9")
    assert (absent.returncode, "no Dask scheduler answers" in absent.stderr) == (74, True), absent.stderr
    assert "Traceback" not in absent.stderr


def test_workers_without_this_imud_are_named():
    ours = many.version()
    assert many.version_mismatch({"tcp://a": ours, "tcp://b": ours}) == ""
    outcomes = many.version_mismatch(
        {"tcp://a": ours, "tcp://b": "0.0.1", "tcp://c": metadata.PackageNotFoundError("imud")}
    )
    assert "tcp://b has imud 0.0.1, tcp://c has no imud" in outcomes and "tcp://a" not in outcomes


def test_files_of_a_name_are_distinguished_by_their_folders():
    paths = [Path(text) for text in ("/x/a/drive.mcap", "/x/b/drive.mcap", "/x/b/other.mcap")]
    assert recordings.distinct_names(paths) == ["a_drive", "b_drive", "other"]
    assert recordings.distinct_names(paths[1:]) == ["drive", "other"]


@pytest.mark.thorough
def test_the_export_is_what_replay_takes_and_what_ros_reads(recorded, tmp_path):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    ros = tmp_path / "ros.mcap"
    done = command("export", recorded, "--csv", tmp_path, "--ros2", ros)
    assert done.returncode == 0, done.stderr
    estimates = stored(recorded, ESTIMATE_TABLE)
    positioned = estimates[(estimates["status"] & 4) > 0]
    with (tmp_path / "est.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(Decimal(row["t_s"]) * 10**9) for row in rows] == estimates["t_ns"].tolist()
    gnss = list(csv.DictReader((tmp_path / "gnss.csv").open()))
    used = np.degrees(stored(recorded, FIX_TABLE)["lat"]).tolist()  # by the filter: since there was one
    assert [float(row["lat_deg"]) for row in gnss][-len(used) :] == used
    with (tmp_path / "imu.csv").open() as file:
        temperatures = [float(row["temperature_c"]) for row in csv.DictReader(file)]
    assert temperatures == stored(recorded, SAMPLE_TABLE)["temperature"].tolist()
    again = command("replay", "--imu", tmp_path / "imu.csv", "--gnss", tmp_path / "gnss.csv", "-o", tmp_path / "e.csv")
    assert again.returncode == 0, again.stderr
    with AnyReader([ros], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        read = {topic: [] for topic in counts}
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            read[connection.topic].append(message)
            first = message.transforms[0] if connection.topic.startswith("/tf") else message
            assert first.header.stamp.sec * 10**9 + first.header.stamp.nanosec == log_ns
        latched = next(c for c in reader.connections if c.topic == "/tf_static").ext.offered_qos_profiles
    seconds = np.ptp(estimates["t_ns"]) * 1e-9
    assert len(read["/diagnostics"]) == pytest.approx(seconds, abs=3)
    assert counts | {"/diagnostics": 0} == {
        **{topic: len(estimates) for topic in ("/imu/data_raw", "/imu/data")},
        **{topic: len(positioned) for topic in ("/odometry", "/fix/filtered")},
        **{topic: len(gnss) for topic in ("/fix", "/time_reference")},
        **{"/tf": np.maximum.accumulate(estimates["status"] & 1).sum(), "/tf_static": 1, "/diagnostics": 0},
    }
    assert [(policy.durability.name, policy.depth) for policy in latched] == [("TRANSIENT_LOCAL", 1)]
    assert [fix.latitude for fix in read["/fix/filtered"]] == np.degrees(positioned["lat"]).tolist()
    assert [fix.latitude for fix in read["/fix"]] == [float(row["lat_deg"]) for row in gnss]
    samples = stored(recorded, SAMPLE_TABLE)
    assert [m.angular_velocity.x for m in read["/imu/data_raw"]] == samples["w"][:, 0].tolist()
    assert all(m.angular_velocity_covariance[0] > 0.0 for m in read["/imu/data_raw"] + read["/imu/data"])
    for fix, reference in zip(read["/fix"], read["/time_reference"], strict=True):  # the emulator has the host's time
        assert fix.header.stamp == reference.header.stamp
        times = [stamp.sec + 1e-9 * stamp.nanosec for stamp in (reference.time_ref, fix.header.stamp)]
        assert times[0] == pytest.approx(times[1], abs=0.5)
    parts = {status.name: status for status in read["/diagnostics"][-1].status}
    assert set(parts) == {"imud: filter", "imud: inertial sensor", "imud: receiver"}
    assert parts["imud: inertial sensor"].hardware_id.startswith("M-G350")


@pytest.mark.thorough
def test_a_recording_is_an_ordinary_port(recorded, tmp_path):
    with daemon(tmp_path, "--port", f"replay:{recorded}", "--record", str(tmp_path / "copy.mcap")) as imud:
        imud.says("device=M-G350")
        imud.says("position is valid")
        while imud.log.count("played to its end") < 2:
            imud.until(lambda m: True)
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
    for kind in ("imu", "gnss"):
        (copied, came_ns), (original, once_ns) = (_bytes(path, kind) for path in (tmp_path / "copy.mcap", recorded))
        assert original.endswith(copied)
        assert len(copied) > 0.5 * len(original)
        assert np.ptp(came_ns - once_ns[-len(copied) :]) == 0  # each byte as long after the others as then
    assert len(replayed(Recording([tmp_path / "copy.mcap"]))[0]) > 3 * RATE_HZ


def test_allan_and_its_like_read_the_samples_of_a_recording(recorded):
    samples, origin, _ = read_samples(recorded)
    kept = stored(recorded, SAMPLE_TABLE)
    assert (samples["t_ns"] + origin * 10**9).tolist() == kept["t_ns"].tolist()
    assert samples["w"].tobytes() == kept["w"].tobytes()
    assert samples["f"].tobytes() == kept["f"].tobytes()


@pytest.mark.thorough
def test_a_replay_writes_the_recorded_innovations_and_takes_another_calibration(recorded, tmp_path):
    inn, csv_file, known = tmp_path / "inn.csv", tmp_path / "est.csv", tmp_path / "sensor.toml"
    done = command("replay", recorded, "-o", csv_file, "--innovations", inn)
    assert done.returncode == 0, done.stderr
    rows = [row.split(",") for row in inn.read_text().splitlines()[1:]]
    found = sorted((int(Decimal(t_s) * 10**9), kind, float(value)) for t_s, kind, value, _, _ in rows)
    kept = stored(recorded, INNOVATION_TABLE)
    wanted = {(int(row["t_ns"]), KINDS[int(row["kind"])].column) for row in kept}
    assert wanted <= {(t_ns, kind) for t_ns, kind, _ in found}
    bias = "bias_radps = [0.5, 0.0, -0.25]\nsigma_radps = [0.1, 0.1, 0.1]\n"
    known.write_text(f'serial = "x"\n[gyro]\ndate = "2026-01-01"\n{bias}')
    rates = [rates_of(recorded, calibration) for calibration in (None, read_calibration(known))]
    assert rates[0] - rates[1] == pytest.approx(np.tile([0.5, 0.0, -0.25], (len(rates[0]), 1)), abs=1e-12)
    done = command("replay", recorded, "-o", tmp_path / "other.csv", "--calibration", known)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "other.csv").read_bytes() != csv_file.read_bytes()
    assert command("replay", recorded, recorded, "-o", tmp_path, "--innovations", inn).returncode == 64


@pytest.mark.thorough
def test_what_the_filter_estimates_beside_its_solution_is_recorded_once_a_second(recorded, tmp_path):
    import polars  # takes half a second, of each worker

    states = states_rows([entry.data for entry in Capture(recorded) if entry.topic == "/states"])
    estimates = {int(row["t_ns"]): row for row in stored(recorded, ESTIMATE_TABLE)}
    seconds = np.ptp(list(estimates)) * 1e-9
    assert seconds - 2.5 < len(states) < seconds + 2.5
    positioned = states[np.isfinite(states["covariance"][:, 0])]
    sigmas = [estimates[int(row["t_ns"])]["sigma_p"][0] for row in positioned]
    if np.isnan(sigmas[0]):  # the first fix was used since the newest solution
        positioned, sigmas = positioned[1:], sigmas[1:]
    assert len(sigmas) > 3 and np.sqrt(positioned["covariance"][:, 0]) == pytest.approx(np.array(sigmas), rel=1e-6)
    delay = PLACES["time_offset"]
    assert np.isfinite(states["value"][-1, delay]) and np.isnan(states["value"][:, PLACES["odometer_scale"]]).all()
    done = command("replay", recorded, "-o", tmp_path / "est.csv", "--states", tmp_path / "states.csv")
    assert done.returncode == 0, done.stderr
    with (tmp_path / "states.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert seconds - 2.5 < len(rows) < seconds + 2.5
    assert float(rows[-1]["stime_offset_s"]) == pytest.approx(states["sigma"][-1, delay], rel=0.3)
    assert command("replay", recorded, recorded, "-o", tmp_path, "--states", tmp_path / "s").returncode == 64
    folder = tmp_path / "tables"
    folder.mkdir()
    (folder / "states.csv").write_text("of an earlier export")
    done = command("export", recorded, "--csv", folder, "--parquet", folder)
    assert done.returncode == 0, done.stderr
    assert (folder / "states.csv").read_bytes() == (tmp_path / "states.csv").read_bytes()
    theirs = polars.read_parquet(folder / "states.parquet")
    assert theirs.columns == list(rows[0])
    for name in ("cov_an_an", "stime_offset_s"):
        written = [float(row[name]) if row[name] else None for row in rows]
        assert theirs[name].is_null().to_list() == [number is None for number in written]
        known = [number for number in written if number is not None]
        assert theirs[name].drop_nulls().to_list() == pytest.approx(known, rel=1e-8)


def rates_of(path, calibration):
    """Of every sample of a recording, corrected."""
    recording, adapt, found = Recording([path]), adapter(None, (), "tilt"), []
    settings = recording.settings(adapt)
    player = Player(settings, adapt, Initial(), Handlers(lambda s, _: found.append(s["w"].copy())), calibration)
    for entry in recording:
        player.take(entry)
    return np.concatenate(found)


def _bytes(path, kind):
    """All that the device of that kind said, and when each byte of it came."""
    port = next(device.port for device in Capture(path).devices() if device.kind == kind)
    read = reads_of(path, port)
    return b"".join(raw.data for raw in read), np.repeat([raw.t_ns for raw in read], [len(raw.data) for raw in read])


def test_the_clocks_fit_is_recorded_once_a_second(recorded):
    rows = stored(recorded, CLOCK_TABLE)
    span_s = np.ptp(stored(recorded, SAMPLE_TABLE)["t_ns"]) * 1e-9
    assert 0.5 * span_s < len(rows) < span_s + 2.0  # it looks ten times a second, when the machine lets it
    assert (np.diff(rows["t_ns"]) >= 1_000_000_000).all()
    assert np.isfinite(rows["drift"]).sum() >= len(rows) - 5
    assert rows["frames"][-1] <= len(stored(recorded, SAMPLE_TABLE))
    recording, adapt, found = Recording([recorded]), adapter(None, (), None), []
    player = Player(recording.settings(adapt), adapt, Initial(), Handlers())
    for entry in recording:
        player.take(entry)
        if entry.topic == CLOCK_TABLE.topic:
            row = rows[len(found)]
            found.append(row_of(player._selection.inertial, row["port"], row["t_ns"]))
    assert np.concatenate(found).tobytes() == rows.tobytes()


def test_the_recording_holds_what_happened(recorded):
    texts = [json.loads(entry.data)["text"] for entry in Capture(recorded) if entry.topic == "/events"]
    assert "position is valid" in texts
    facts, attached = Capture(recorded).session()
    assert facts["version"]
    assert json.loads(attached["settings.json"])["record"]["path"] == str(recorded)
    assert [len(recording.paths) for recording in group([recorded])[0]] == [1]
    assert recorded.stat().st_size > 10_000


@pytest.mark.thorough
def test_record_says_how_many_bytes_of_each_port_it_has(tmp_path):
    port, absent, path = tmp_path / "imu", tmp_path / "absent", tmp_path / "raw.mcap"
    with (
        emulator("g350", links=[port]),
        process("imud", "record", str(port), str(absent), "-o", str(path), stderr=subprocess.PIPE) as running,
    ):
        while "streaming" not in (line := running.stderr.readline()):
            assert line, "it ended by itself"
        begun = path.stat().st_size
        while path.stat().st_size < begun + 20_000:
            assert running.poll() is None
            time.sleep(0.1)
        running.send_signal(signal.SIGINT)
        _, log = running.communicate()
    said = re.findall(r"\[(\w+) *\] recorded (\d+) bytes +port=(\S+)", log)
    data, _ = _bytes(path, "imu")
    assert said == [("info", str(len(data)), str(port)), ("warning", "0", str(absent))]


def test_record_of_nothing_is_no_success(tmp_path):
    done = command("record", tmp_path / "absent", "-o", tmp_path / "raw.mcap", "--seconds", "0.5")
    assert done.returncode == 69, done.stderr
    assert done.stderr.splitlines()[-1] == "imud: nothing was recorded: no port has sent a byte"


@pytest.mark.thorough
def test_record_has_the_measurements_of_other_programs_too(tmp_path):
    path = tmp_path / "raw.mcap"
    done = command("record", "sim:rest", "sim:rest:velocity", "-o", path, "--seconds", "10")
    assert done.returncode == 0, done.stderr
    said = [json.loads(entry.data) for entry in Capture(path) if entry.topic == "/aiding"]
    assert len(said) > 10 and {message["source"] for message in said} == {"velocity"}
    assert len(reads_of(path)) > 10 and "measurements come: velocity" in done.stderr
