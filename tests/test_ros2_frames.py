"""The frames of the ROS 2 messages: map, odom and base_link, their jumps and gaps, and the local map."""

import math

import numpy as np
import pytest
from poses import solution
from ros2_read import BOTH, SECOND, converted, matrix, read, vector
from scipy.spatial.transform import Rotation

from imud.estimators.records import ATTITUDE_VALID, HEIGHT_VALID, POSITION_VALID, SOLUTION
from imud.recording.enu import LocalMap
from imud.ros2.converter import Converter


def as_matrix(transform):
    found = np.eye(4)
    found[:3, :3] = matrix(transform.rotation)
    found[:3, 3] = vector(transform.translation)
    return found


def drive(n, status):
    """n solutions in a circle of 20 m at 5 m/s, at 100 Hz; position and attitude by closed forms; the sensor is level.

    status: of each as a function of its number.
    """
    rows = np.zeros(n, SOLUTION)
    for k, row in enumerate(rows):
        heading = 0.25 * k / 100.0
        rows[k] = solution(Rotation.from_euler("z", heading).as_matrix())
        row["t_ns"], row["status"] = k * SECOND // 100, status(k)
        row["v"], row["w"] = (5.0 * math.cos(heading), 5.0 * math.sin(heading), 0.0), (0.0, 0.0, 0.25)
        north, east = 20.0 * math.sin(heading), 20.0 - 20.0 * math.cos(heading)
        row["lat"], row["lon"] = 0.6 + north / 6_355_000.0, 2.4 + east / (6_385_000.0 * math.cos(0.6))
    return rows


ALL = ATTITUDE_VALID | POSITION_VALID | HEIGHT_VALID


@pytest.mark.thorough
def test_map_jumps_and_odom_does_not():
    """At half of the way the filter is corrected by 3 m and 0.1 rad."""
    rows = drive(1000, lambda k: ALL)
    for row in rows[500:]:
        row["lat"] += 3.0 / 6_355_000.0
        w, x, y, z = row["q_nb"]
        turn = Rotation.from_euler("z", 0.1) * Rotation.from_quat([x, y, z, w])
        row["q_nb"] = turn.as_quat()[[3, 0, 1, 2]]
        row["v"] = Rotation.from_euler("z", 0.1).apply(row["v"])
    converter, in_odom, in_map = Converter(), [], []
    for row in rows:
        made = converted(row, converter)
        to_odom, to_body = made["/tf"].transforms
        assert (to_odom.header.frame_id, to_odom.child_frame_id) == ("map", "odom")
        assert (to_body.header.frame_id, to_body.child_frame_id) == ("odom", "base_link")
        in_odom.append(as_matrix(to_body.transform))
        in_map.append(as_matrix(to_odom.transform) @ in_odom[-1])
        pose = made["odometry"].pose.pose
        assert in_map[-1][:3, :3] == pytest.approx(matrix(pose.orientation), abs=1e-9)
        assert in_map[-1][:3, 3] == pytest.approx(vector(pose.position), abs=1e-6)
    heading = 0.25 * np.arange(1000) / 100.0
    circle = np.stack([20.0 - 20.0 * np.cos(heading), 20.0 * np.sin(heading), 0.0 * heading], axis=1)  # ENU
    assert np.array(in_odom)[:, :3, 3] == pytest.approx(circle, abs=5e-3)
    assert np.linalg.norm(np.diff(in_odom, axis=0)[:, :3, 3], axis=1).max() == pytest.approx(0.05, rel=1e-3)
    jump = in_map[500][:3, 3] - in_map[499][:3, 3]
    assert jump == pytest.approx([0.05 * np.sin(heading[500]), 3.0 + 0.05 * np.cos(heading[500]), 0.0], abs=0.02)


def test_odom_goes_on_without_a_position_and_map_to_odom_stays():
    converter = Converter()
    made = [converted(row, converter) for row in drive(300, lambda k: ALL if k < 200 else ATTITUDE_VALID)]
    assert "odometry" in made[199]
    assert "odometry" not in made[200]
    last, then = (made[k]["/tf"].transforms[0].transform for k in (199, 299))
    assert as_matrix(then) == pytest.approx(as_matrix(last), abs=0.02)


def test_many_rows_at_once_become_the_messages_that_each_becomes_alone():
    """Positions and attitudes come and go, a gap, a sensor whose rates are not known for a while."""
    rows = np.array(drive(400, lambda k: (0, ATTITUDE_VALID, ALL, ALL, ALL & ~HEIGHT_VALID, POSITION_VALID)[k // 70]))
    rows["t_ns"][200:] += 5 * 10**9
    rows["w"][150:160] = rows["v"][90:95] = np.nan
    together, alone, at = Converter(), Converter(), rows["t_ns"] + 7
    together.sigmas = alone.sigmas = BOTH
    wanted = [
        message for row, unix_ns in zip(rows, at, strict=True) for message in alone.of_solution(row, int(unix_ns))
    ]
    made = [
        (topic, int(unix_ns), data.tobytes())
        for part in (slice(0, 60), slice(60, 61), slice(61, 400))
        for topic, times, block in together.of_solutions(rows[part], at[part])
        for unix_ns, data in zip(times, block.rows(), strict=True)
    ]
    for topic in ("imu/data", "/tf", "odometry", "fix/filtered"):
        assert [m for m in made if m[0] == topic] == [m for m in wanted if m[0] == topic]
    assert len(made) == len(wanted) == 400 + 330 + 2 * 260


def test_a_gap_is_not_reckoned_over():
    converter = Converter()
    rows = drive(300, lambda k: ALL)
    before = converted(rows[0], converter)["/tf"].transforms[1].transform
    after = converted(rows[250], converter)["/tf"].transforms[1].transform
    assert as_matrix(after).tolist() == as_matrix(before).tolist()


def test_the_static_transforms():
    message = Converter().static((1.0, 0.5, -2.0), 3)
    imu, antenna = read("/tf_static", message.data).transforms
    assert (imu.header.frame_id, imu.child_frame_id) == ("base_link", "imu_link")
    assert as_matrix(imu.transform).tolist() == np.eye(4).tolist()
    assert (antenna.header.frame_id, antenna.child_frame_id) == ("base_link", "gnss_link")
    assert vector(antenna.transform.translation).tolist() == [1.0, -0.5, 2.0]  # the antenna is above: up is positive


def test_the_local_map_against_pymap3d():
    pymap3d = pytest.importorskip("pymap3d")
    plane = LocalMap()
    assert plane.place(0.6, 2.4, 50.0) == (0.0, 0.0, 0.0)
    wanted = pymap3d.geodetic2enu(0.6003, 2.3995, 80.0, 0.6, 2.4, 50.0, deg=False)
    assert plane.place(0.6003, 2.3995, 80.0) == pytest.approx(wanted, abs=1e-6)
