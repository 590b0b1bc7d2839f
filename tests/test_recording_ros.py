"""The sign table of ROS 2 and Foxglove: 24 poses, our frames (NED, FRD) and those of robotics (ENU, FLU), by plain
matrices and rosbags. Of the other outputs: test_signs.py.
"""

import numpy as np
import pytest
from poses import FRD_IN_FLU, NED_IN_ENU, POSES, G, solution
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from imud.estimators.records import HEIGHT_VALID, SOLUTION
from imud.recording import ros
from imud.recording.enu import LocalMap
from imud.recording.foxglove import location, transform
from imud.recording.messages import ESTIMATE_TABLE

STORE = get_typestore(Stores.ROS2_HUMBLE)


def matrix(q):
    """Of x, y, z, w."""
    v, w = np.array([q.x, q.y, q.z]), q.w
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def vector(v):
    return np.array([v.x, v.y, v.z])


@pytest.mark.parametrize("r_nb", POSES)
def test_the_sign_table(r_nb):
    row = solution(r_nb)
    wanted = NED_IN_ENU @ r_nb @ FRD_IN_FLU.T
    imu = STORE.deserialize_cdr(ros.imu(row, 1_500_000_000), "sensor_msgs/msg/Imu")
    assert matrix(imu.orientation) == pytest.approx(wanted, abs=1e-9)
    assert wanted @ vector(imu.linear_acceleration) == pytest.approx([0, 0, G], abs=1e-9)
    assert wanted @ vector(imu.angular_velocity) == pytest.approx([0, 0, -0.5], abs=1e-9)
    assert (imu.header.frame_id, imu.header.stamp.sec, imu.header.stamp.nanosec) == ("base_link", 1, 500_000_000)
    assert imu.orientation_covariance[[0, 4, 8]] == pytest.approx([1e-4, 4e-4, 9e-4])
    odometry = STORE.deserialize_cdr(ros.odometry(row, 0, LocalMap()), "nav_msgs/msg/Odometry")
    assert matrix(odometry.pose.pose.orientation) == pytest.approx(wanted, abs=1e-9)
    assert wanted @ vector(odometry.twist.twist.linear) == pytest.approx([2, 1, -3], abs=1e-9)
    assert odometry.pose.covariance.reshape(6, 6).diagonal()[:3] == pytest.approx([4, 1, 9])
    spread = odometry.twist.covariance.reshape(6, 6).diagonal()[:3]
    assert spread == pytest.approx((wanted.T**2) @ [0.04, 0.01, 0.09], abs=1e-9)
    estimate = ESTIMATE_TABLE.objects(np.array([row], SOLUTION))[0]
    pose = transform(estimate, 0, LocalMap())
    assert matrix(type("Q", (), pose["rotation"])) == pytest.approx(wanted, abs=1e-9)


def test_positions():
    row = solution(np.eye(3))
    fix = STORE.deserialize_cdr(ros.nav_sat_fix(row, 7), "sensor_msgs/msg/NavSatFix")
    assert (fix.latitude, fix.longitude, fix.altitude) == (np.degrees(0.6), np.degrees(2.4), 50.0)
    assert fix.position_covariance.reshape(3, 3).diagonal() == pytest.approx([4, 1, 9])
    assert (fix.status.status, fix.position_covariance_type) == (0, 2)
    where = location(ESTIMATE_TABLE.objects(np.array([row], SOLUTION))[0], 7)
    assert (where["position_covariance"], where["altitude"]) == (fix.position_covariance.tolist(), 50.0)
    row["status"] &= ~HEIGHT_VALID
    fix = STORE.deserialize_cdr(ros.nav_sat_fix(row, 7), "sensor_msgs/msg/NavSatFix")
    assert np.isnan(fix.altitude)
    assert location(ESTIMATE_TABLE.objects(np.array([row], SOLUTION))[0], 7)["altitude"] is None
    row["status"] = 0
    assert ros.odometry(row, 0, LocalMap()) is None
    imu = STORE.deserialize_cdr(ros.imu(row, 0), "sensor_msgs/msg/Imu")
    assert imu.orientation_covariance[0] == -1


def test_the_local_map_against_pymap3d():
    pymap3d = pytest.importorskip("pymap3d")
    plane = LocalMap()
    assert plane.place(0.6, 2.4, 50.0) == (0.0, 0.0, 0.0)
    wanted = pymap3d.geodetic2enu(0.6003, 2.3995, 80.0, 0.6, 2.4, 50.0, deg=False)
    assert plane.place(0.6003, 2.3995, 80.0) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("name", ["sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "nav_msgs/msg/Odometry"])
def test_the_definitions_are_those_of_ros(name):
    ours = get_types_from_msg(ros.definition(name), name)
    for kind, (_, fields) in ours.items():
        assert fields == STORE.get_msgdef(kind).fields, kind
