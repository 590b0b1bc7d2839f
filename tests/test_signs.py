"""The sign table: in 24 poses every output says of one turning, moving body the same, by plain matrices as the oracle.

An output may tell the attitude as a matrix in its frame, rates (rad/s), specific force (m/s^2), velocity (m/s), the
rate of turn (rad/s). ROS 2 and Foxglove have more to tell: test_recording_ros.py.
"""

import asyncio
import csv
import io
import json
import select
import subprocess

import numpy as np
import pytest
from browser import browser, program
from poses import FRD_IN_FLU, NED_IN_ENU, POSES, G, quaternion, solution
from processes import process
from scipy.spatial.transform import Rotation

from imud import client
from imud.configuration.settings import Settings, SharedMemory, Stream
from imud.estimators.records import SOLUTION
from imud.outputs.binary import BinaryOutputs
from imud.outputs.gpsd_json import Report
from imud.outputs.nmea_sentences import sentences
from imud.outputs.view import View
from imud.recording.enu import LocalMap
from imud.recording.foxglove import location, transform
from imud.recording.messages import ESTIMATE_TABLE
from imud.tables.estimates import EstimateWriter

VELOCITY, TURN = np.array([1.0, 2.0, 3.0]), 0.5  # NED, m/s; rad/s, to starboard
POSE_NUMBER = 1e-3  # rad of latitude, by which a pose is known


def row_of(r_nb, number=0):
    rows = np.zeros(1, SOLUTION)
    rows[0] = solution(r_nb)
    rows["lat"] = POSE_NUMBER * number
    return rows


def view_of(row):
    sensed = (*row["w"][0].tolist(), *row["f"][0].tolist())
    return View(row.tobytes(), 1.7e9, t_mono_ns=int(row["t_ns"][0]), estimator="attitude", sensed=sensed)


def by_angles(roll, pitch, yaw):
    """Degrees; ZYX."""
    return Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()


def by_quaternion(w, x, y, z):
    return Rotation.from_quat([x, y, z, w]).as_matrix()


def polar(track_deg, speed, down):
    a = np.radians(track_deg)
    return np.array([speed * np.cos(a), speed * np.sin(a), down])


def gpsd(kind, row):
    return json.loads(Report(view_of(row)).object(kind))


def gpsd_att(row, _):
    m = gpsd("ATT", row)
    rates, forces = (np.array([m[f"{what}_{axis}"] for axis in "xyz"]) for what in ("gyro", "acc"))
    turn = {"turn": np.radians(m["rot"] / 60.0)} if "rot" in m else {}
    r = by_angles(m["roll"], m["pitch"], m["heading"])
    assert r == pytest.approx(by_angles(m["roll"], m["pitch"], m["yaw"]))
    return {"R": r, "w": np.radians(rates), "f": forces, **turn}


def gpsd_imu(row, _):
    m = gpsd("IMU", row)
    rates, forces = (np.array([m[f"{what}_{axis}"] for axis in "xyz"]) for what in ("gyro", "acc"))
    return {"w": np.radians(rates), "f": forces}


def gpsd_est(row, _):
    m = gpsd("EST", row)
    r = by_quaternion(*(m[f"q{i}"] for i in range(4)))
    assert r == pytest.approx(by_angles(m["roll_deg"], m["pitch_deg"], m["yaw_deg"]), abs=1e-6)
    return {"R": r, "v": np.array([m[f"v{axis}_mps"] for axis in "ned"])}


def gpsd_tpv(row, _):
    m = gpsd("TPV", row)
    assert [m[f"vel{axis}"] for axis in "NED"] == VELOCITY.tolist()
    return {"v": polar(m["track"], m["speed"], -m["climb"])}


def nmea(row, _):
    said = {line[1:6]: line.partition("*")[0].split(",") for line in sentences(view_of(row)).decode().splitlines()}
    heading, roll, pitch = (float(said["PASHR"][i]) for i in (2, 4, 5))
    assert float(said["GPHDT"][1]) == pytest.approx(heading)
    turn = {"turn": np.radians(float(said["GPROT"][1]) / 60.0)} if said["GPROT"][2] == "A" else {}
    speed = float(said["GPVTG"][7]) / 3.6
    assert [float(said["GPRMC"][8]), float(said["GPRMC"][7])] == [float(said["GPVTG"][1]), float(said["GPVTG"][5])]
    return {"R": by_angles(roll, pitch, heading), "v": polar(float(said["GPVTG"][1]), speed, VELOCITY[2]), **turn}


def table(row, _):
    file = io.BytesIO()
    EstimateWriter(file, 0).write(row)
    (cells,) = csv.DictReader(io.StringIO(file.getvalue().decode()))
    m = {name: float(text) for name, text in cells.items()}
    r = by_quaternion(*(m[f"q{i}"] for i in range(4)))
    assert r == pytest.approx(by_angles(m["roll_deg"], m["pitch_deg"], m["yaw_deg"]), abs=1e-6)
    return {"R": r, "v": np.array([m[f"v{axis}_mps"] for axis in "ned"])}


def of_state(state):
    r = by_quaternion(*state.q_nb)
    assert r == pytest.approx(by_angles(*np.degrees([state.roll, state.pitch, state.yaw])), abs=1e-6)
    return {"R": r, "w": np.array(state.w), "f": np.array(state.f), "v": np.array(state.v)}


def stream(row, binary):
    binary.publish(row, 1, 1, 0)
    return of_state(next(binary.reader))


def shared_memory(row, binary):
    binary.publish(row, 1, 1, 0)
    return of_state(client.latest(binary.at / "m"))


def recorded(row, _):
    m = ESTIMATE_TABLE.objects(row)[0]
    vectors = {"w": "w_radps", "f": "f_mps2", "v": "v_mps"}
    return {"R": by_quaternion(*m["q_nb"]), **{key: np.array(m[name]) for key, name in vectors.items()}}


def foxglove(row, _):
    """Also that the place moves east when the longitude grows, and north with the latitude."""
    estimate, plane = ESTIMATE_TABLE.objects(row)[0], LocalMap()
    turn = transform(estimate, 0, plane)["rotation"]
    assert location(estimate, 0)["latitude"] == pytest.approx(np.degrees(row["lat"][0]))
    moved = estimate | {"lat_rad": estimate["lat_rad"] + 1e-6, "lon_rad": estimate["lon_rad"] + 2e-6, "height_m": 53.0}
    place = transform(moved, 0, plane)["translation"]
    assert 10.0 < place["x"] < 13.0 and 6.0 < place["y"] < 6.5 and place["z"] == pytest.approx(3.0, abs=1e-3)
    return {"R": by_quaternion(*(turn[axis] for axis in "wxyz"))}


OUTPUTS = {
    gpsd_att: "NED", gpsd_imu: "NED", gpsd_est: "NED", gpsd_tpv: "NED", nmea: "NED", table: "NED", stream: "NED",
    shared_memory: "NED", recorded: "NED", foxglove: "ENU",
}  # fmt: skip
DECIMALS = {nmea: 1e-2}  # two of a degree; of a speed over ground in knots three


@pytest.fixture(scope="module")
def binary(tmp_path_factory):
    at, poller = tmp_path_factory.mktemp("binary"), select.poll()
    settings = Settings(stream=Stream(listen=str(at / "s")), shared_memory=SharedMemory(path=str(at / "m")))
    outputs = BinaryOutputs(settings, poller, 256)
    outputs.at = at
    with client.connect(at / "s", timeout_s=5.0) as outputs.reader:
        for fd, _ in poller.poll(0):
            outputs.stream.on_event(fd)
        yield outputs
    outputs.close()


@pytest.mark.parametrize("r_nb", POSES)
@pytest.mark.parametrize("output", OUTPUTS, ids=lambda output: output.__name__)
def test_the_sign_table(output, r_nb, binary):
    said, near = output(row_of(r_nb), binary), DECIMALS.get(output, 1e-5)
    to_world, to_body = (NED_IN_ENU, FRD_IN_FLU) if OUTPUTS[output] == "ENU" else (np.eye(3), np.eye(3))
    wanted = {
        "R": to_world @ r_nb @ to_body.T,
        "w": r_nb.T @ [0.0, 0.0, TURN],
        "f": r_nb.T @ [0.0, 0.0, -G],
        "v": VELOCITY,
        "turn": TURN if abs(r_nb[2, 0]) < 0.5 else None,  # not defined where the nose points up or down
    }
    assert said
    for key, found in said.items():
        assert wanted[key] is not None and found == pytest.approx(wanted[key], abs=near), key


async def page_says(page, number):
    """The page's numbers once they are those of the pose."""
    await page.until(f"document.getElementById('place').innerText.includes('{np.degrees(POSE_NUMBER * number):.6f}')")
    rows = "[...document.querySelectorAll('#angles tr, #motion tr, #place tr')]"
    return dict(await page.evaluate(f"{rows}.map(r => [r.cells[0].innerText, parseFloat(r.cells[1].innerText)])"))


@pytest.mark.thorough
@pytest.mark.skipif(program() is None, reason="no Chromium here")
def test_the_sign_table_of_the_live_page(tmp_path):
    pytest.importorskip("aiohttp", reason="the live page needs the extra imud[web]")
    pytest.importorskip("plotly", reason="the live page needs the extra imud[web]")
    writers = []

    async def serve(reader, writer):
        writers.append(writer)
        await reader.read()

    async def look(url):
        server = await asyncio.start_unix_server(serve, tmp_path / "gpsd.sock")
        async with server, browser(tmp_path / "profile") as page:
            await page.open(url)
            while not writers:
                await asyncio.sleep(0.05)
            for number, r_nb in enumerate(POSES, 1):
                row = row_of(r_nb, number)
                row["t_ns"] += number * 10**9
                writers[0].write(Report(view_of(row)).lines(("ATT", "EST")))
                said = await page_says(page, number)
                r = by_angles(said["roll"], said["pitch"], said["heading"])
                assert r == pytest.approx(r_nb, abs=1e-3)
                assert [said[f"v {name}"] for name in ("north", "east", "down")] == VELOCITY.tolist()
                if abs(r_nb[2, 0]) < 0.5:
                    assert said["rate of turn"] == pytest.approx(np.degrees(TURN), abs=0.1)
                drawn = f"import('/page/pose.js').then(m => [0, 1, 2].map(i => m.rotate({quaternion(r_nb).tolist()}, "
                columns = await page.evaluate(f"{drawn}[i === 0, i === 1, i === 2].map(Number))))")
                assert pytest.approx(r_nb, abs=1e-9) == np.array(columns).T
            for writer in writers:
                writer.close()

    listening = ("imud", "web", "--listen=127.0.0.1:0", str(tmp_path / "gpsd.sock"))
    with process(*listening, stdout=subprocess.PIPE) as running:
        asyncio.run(look(running.stdout.readline().strip()))
