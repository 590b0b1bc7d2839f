"""Messages of ROS 2 and Foxglove: 24 poses and others in our frames (NED, FRD) and in those of robotics (ENU, FLU).
Oracles: plain matrices, scipy's rotations, Monte Carlo, rosbags' message types. Of the other outputs: test_signs.py.
"""

import datetime
import math

import numpy as np
import pytest
from mcap.reader import make_reader
from poses import FRD_IN_FLU, NED_IN_ENU, POSES, G, solution
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from imud.drivers.fix import Fix
from imud.drivers.sample import NO_FORCE, NO_RATE, SAMPLE, SUSPECT
from imud.estimators.records import ATTITUDE_VALID, FIX, HEIGHT_VALID, POSITION_VALID, SOLUTION
from imud.recording.enu import LocalMap
from imud.recording.foxglove import location, transform
from imud.recording.messages import ESTIMATE_TABLE
from imud.ros2 import messages
from imud.ros2.block_writer import BlockWriter, Rows
from imud.ros2.cdr import Cdr
from imud.ros2.converter import Converter
from imud.ros2.definitions import TOPICS, definition
from imud.ros2.messages import Diagnosis, Sigmas
from imud.sensor_errors.profiles import PROFILES, SampleSigma, sample_sigmas
from imud.sensors.gnss import position_sigma

STORE = get_typestore(Stores.ROS2_HUMBLE)
SECOND = 1_000_000_000
GYRO, ACCEL = SampleSigma(0.002, 0.01, 0.005), SampleSigma(0.02, 0.1, 0.01)
BOTH = Sigmas(GYRO, ACCEL)


def matrix(q):
    return Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()


def vector(v):
    return np.array([v.x, v.y, v.z])


def read(topic, data):
    return STORE.deserialize_cdr(data, TOPICS[topic])


def one(make, row, unix_ns, *more):
    """The message that a function for many makes of one row."""
    return make(np.array([row]), np.array([unix_ns]), *more).only()


def converted(row, converter=None, unix_ns=0):
    """By topic, what a solution becomes."""
    made = (converter or Converter()).of_solution(row, unix_ns)
    return {topic: read(topic, data) for topic, _, data in made}


@pytest.mark.parametrize("r_nb", POSES)
def test_the_sign_table(r_nb):
    row = solution(r_nb)
    wanted = NED_IN_ENU @ r_nb @ FRD_IN_FLU.T
    imu = read("imu/data", one(messages.imu, row, 1_500_000_000, BOTH))
    assert matrix(imu.orientation) == pytest.approx(wanted, abs=1e-9)
    assert wanted @ vector(imu.linear_acceleration) == pytest.approx([0, 0, G], abs=1e-9)
    assert wanted @ vector(imu.angular_velocity) == pytest.approx([0, 0, -0.5], abs=1e-9)
    assert (imu.header.frame_id, imu.header.stamp.sec, imu.header.stamp.nanosec) == ("imu_link", 1, 500_000_000)
    assert imu.orientation_covariance[[0, 4, 8]] == pytest.approx([1e-4, 4e-4, 9e-4])
    odometry = converted(row)["odometry"]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
    assert matrix(odometry.pose.pose.orientation) == pytest.approx(wanted, abs=1e-9)
    assert wanted @ vector(odometry.twist.twist.linear) == pytest.approx([2, 1, -3], abs=1e-9)
    assert odometry.pose.covariance.reshape(6, 6).diagonal() == pytest.approx([4, 1, 9, 1e-4, 4e-4, 9e-4])
    estimate = ESTIMATE_TABLE.objects(np.array([row], SOLUTION))[0]
    pose = transform(estimate, 0, LocalMap())
    assert matrix(type("Q", (), pose["rotation"])) == pytest.approx(wanted, abs=1e-9)


def test_a_vehicle_that_heads_east_and_climbs():
    """By scipy's Euler angles: its nose is 90° from north, 10° up, its left side 5° up."""
    row = solution(Rotation.from_euler("ZYX", [90, 10, 5], degrees=True).as_matrix())
    imu = read("imu/data", one(messages.imu, row, 0, BOTH))
    q = [imu.orientation.x, imu.orientation.y, imu.orientation.z, imu.orientation.w]
    assert Rotation.from_quat(q).as_euler("ZYX", degrees=True) == pytest.approx([0, -10, 5], abs=1e-9)


def test_the_covariances_of_rates_and_forces():
    row = solution(np.eye(3))
    row["w"], row["f"] = (0.3, 0.0, 0.4), (0.0, 0.0, -10.0)
    row["sigma_bg"], row["sigma_ba"] = (1e-3, 2e-3, 3e-3), np.nan
    imu = read("imu/data", one(messages.imu, row, 0, BOTH))
    common = 0.002**2 + (0.005 * 0.5) ** 2
    wanted = [common + 1e-6, common + 4e-6, common + 9e-6]
    assert imu.angular_velocity_covariance.reshape(3, 3) == pytest.approx(np.diag(wanted))
    unestimated = 0.02**2 + 0.1**2 + (0.01 * 10.0) ** 2  # the bias is that of the switch-on
    assert imu.linear_acceleration_covariance.reshape(3, 3) == pytest.approx(unestimated * np.eye(3))
    none = read("imu/data", one(messages.imu, row, 0, Sigmas(None, ACCEL)))  # a sensor without gyros
    assert (none.angular_velocity_covariance[0], vector(none.angular_velocity).any()) == (-1.0, False)
    assert none.linear_acceleration_covariance[0] == pytest.approx(unestimated)


def test_white_noise_of_samples_has_the_random_walk_of_the_profile():
    """Integrated over a second, simulated samples walk as far as the data sheet says: 0.2°/√h."""
    gyro, accel = sample_sigmas(PROFILES["m-g350"], 500.0)
    rng = np.random.default_rng(5)
    ends = rng.normal(0.0, gyro.white, (4000, 500)).sum(axis=1) / 500.0
    assert np.degrees(ends.std()) * 60.0 == pytest.approx(0.2, rel=0.04)
    ends = rng.normal(0.0, accel.white, (4000, 500)).sum(axis=1) / 500.0
    assert ends.std() * 60.0 == pytest.approx(0.04, rel=0.04)


@pytest.mark.parametrize(
    ("flags", "rate_known", "force_known"),
    [(0, True, True), (NO_RATE, False, True), (NO_FORCE, True, False), (SUSPECT, False, False)],
)
def test_a_sample_as_measured(flags, rate_known, force_known):
    row = np.zeros(1, SAMPLE)[0]
    row["w"], row["f"], row["flags"] = (0.1, 0.2, 0.3), (1.0, 2.0, -9.0), flags
    imu = read("imu/data_raw", one(messages.imu_raw, row, 7, BOTH))
    assert imu.orientation_covariance[0] == -1.0
    assert (imu.angular_velocity_covariance[0] > 0.0, imu.linear_acceleration_covariance[0] > 0.0) == (
        rate_known,
        force_known,
    )
    if rate_known:
        assert vector(imu.angular_velocity).tolist() == [0.1, -0.2, -0.3]
    if force_known:
        assert vector(imu.linear_acceleration).tolist() == [1.0, -2.0, 9.0]
    assert (imu.header.frame_id, imu.header.stamp.nanosec) == ("imu_link", 7)


def test_the_velocity_in_the_body_has_the_errors_of_velocity_and_attitude():
    """Against 200000 draws of both, with scipy's Euler angles."""
    rpy, sigma_rpy = np.array([0.2, -0.3, 2.0]), np.array([0.01, 0.02, 0.03])
    row = solution(Rotation.from_euler("ZYX", rpy[::-1]).as_matrix())
    row["v"], row["sigma_v"], row["sigma_rpy"] = (12.0, -5.0, 1.0), (0.1, 0.2, 0.3), sigma_rpy
    rng = np.random.default_rng(1)
    n = 200_000
    angles, v = rpy + sigma_rpy * rng.normal(size=(n, 3)), row["v"] + row["sigma_v"] * rng.normal(size=(n, 3))
    drawn = Rotation.from_euler("ZYX", angles[:, ::-1]).inv().apply(v) @ FRD_IN_FLU
    (velocity,), (covariance,) = messages.body_velocity(np.array([row]))
    assert velocity == pytest.approx(drawn.mean(axis=0), abs=0.02)
    assert covariance == pytest.approx(np.cov(drawn.T), rel=0.02, abs=2e-3)
    odometry = converted(row)["odometry"].twist
    assert vector(odometry.twist.linear) == pytest.approx(velocity)
    assert odometry.covariance.reshape(6, 6)[:3, :3] == pytest.approx(covariance)
    assert odometry.covariance.reshape(6, 6).diagonal().min() > 0.0


def test_positions_of_the_filter():
    row = solution(np.eye(3))
    fix = read("fix/filtered", one(messages.filtered_fix, row, 7))
    assert (fix.latitude, fix.longitude, fix.altitude) == (np.degrees(0.6), np.degrees(2.4), 50.0)
    assert fix.position_covariance.reshape(3, 3).diagonal() == pytest.approx([4, 1, 9])
    assert (fix.header.frame_id, fix.status.status, fix.position_covariance_type) == ("base_link", 0, 2)
    where = location(ESTIMATE_TABLE.objects(np.array([row], SOLUTION))[0], 7)
    assert (where["position_covariance"], where["altitude"]) == (fix.position_covariance.tolist(), 50.0)
    row["status"] &= ~HEIGHT_VALID
    fix = read("fix/filtered", one(messages.filtered_fix, row, 7))
    assert np.isnan(fix.altitude)
    assert (fix.position_covariance[8], fix.position_covariance_type) == (1e6, 1)
    assert converted(row)["odometry"].pose.covariance[14] == 1e6
    assert location(ESTIMATE_TABLE.objects(np.array([row], SOLUTION))[0], 7)["altitude"] is None
    row["status"] = 0
    assert list(converted(row)) == ["imu/data"]
    assert converted(row)["imu/data"].orientation_covariance[0] == -1


def a_fix(**known):
    row = np.zeros(1, FIX)
    row["t_ns"], row["lat"], row["lon"], row["height"], row["quality"] = 1, 0.6, 2.4, 50.0, 1
    row["sigma"], row["hdop"] = np.nan, np.nan
    for name, value in known.items():
        row[name] = value
    return row[0]


def test_positions_of_the_receiver():
    def sent(row):
        return {topic: read(topic, data) for topic, _, data in Converter().of_fix(row, 9, None)}["fix"]

    whole = sent(a_fix(sigma=(1.0, 2.0, 3.0), quality=4))
    assert (whole.latitude, whole.longitude, whole.altitude) == (np.degrees(0.6), np.degrees(2.4), 50.0)
    assert whole.position_covariance.reshape(3, 3) == pytest.approx(np.diag([4, 1, 9]))
    assert (whole.header.frame_id, whole.status.status, whole.position_covariance_type) == ("gnss_link", 2, 2)
    by_hdop = sent(a_fix(hdop=2.0))
    assert by_hdop.position_covariance[0] == pytest.approx((2.0 * 2.0) ** 2)  # `uere` per HDOP
    assert by_hdop.position_covariance[8] == pytest.approx((2.2 * 4.0) ** 2)  # `vertical_ratio`
    assert (by_hdop.status.status, by_hdop.position_covariance_type) == (0, 1)
    flat = sent(a_fix(sigma=(1.0, 2.0, np.nan), height=np.nan, quality=2))
    assert np.isnan(flat.altitude)
    assert flat.position_covariance[[0, 4, 8]] == pytest.approx([4, 1, 1e6])
    assert (flat.status.status, flat.position_covariance_type) == (1, 1)
    assert position_sigma(a_fix(hdop=1.0, quality=4))[0] == pytest.approx(0.03)  # RTK


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("host_error_s", [-3.0, 3.0])
def test_the_receivers_time(known, host_error_s):
    """A fix two seconds after midnight, on a host whose clock is still on the day before, or on the same."""
    moment = datetime.datetime(2024, 2, 29, 0, 0, 2, 250_000, datetime.UTC)
    said = Fix(0, 2.25, moment.date() if known else None, 0.0, 0.0, None, None, 1, None, None, None, None)
    unix_ns = round((moment.timestamp() + host_error_s) * 1e9)
    made = {topic: read(topic, data) for topic, _, data in Converter().of_fix(a_fix(), unix_ns, said.utc_ns(unix_ns))}
    reference = made["time_reference"]
    assert reference.time_ref.sec + 1e-9 * reference.time_ref.nanosec == moment.timestamp()
    assert reference.header.stamp.sec * SECOND + reference.header.stamp.nanosec == unix_ns
    assert reference.source == "gnss"
    silent = Fix(0, None, None, 0.0, 0.0, None, None, 1, None, None, None, None)
    assert [topic for topic, _, _ in Converter().of_fix(a_fix(), 0, silent.utc_ns(0))] == ["fix"]


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


def test_diagnostics():
    parts = (
        Diagnosis("inertial sensor", (), "M-G350 7", {"rate_hz": 1000.0, "lost": 0}),
        Diagnosis("receiver", ("receiver: no fix", "x")),
        Diagnosis("receiver", None),
        messages.filter_diagnosis("navigation", "attitude,coasting"),
    )
    (made,) = Converter().of_diagnoses(parts, 5)
    statuses = read("/diagnostics", made.data).status
    listed = [
        (status.name, ord(status.level) if isinstance(status.level, bytes) else status.level) for status in statuses
    ]
    wanted = [("imud: inertial sensor", 0), ("imud: receiver", 1), ("imud: receiver", 3), ("imud: filter", 1)]
    assert listed == wanted
    assert [status.message for status in statuses] == ["ok", "receiver: no fix; x", "there is none", "coasting"]
    assert [(value.key, value.value) for value in statuses[0].values] == [("rate_hz", "1000.0"), ("lost", "0")]
    assert (statuses[0].hardware_id, statuses[3].hardware_id) == ("M-G350 7", "navigation")


def test_the_local_map_against_pymap3d():
    pymap3d = pytest.importorskip("pymap3d")
    plane = LocalMap()
    assert plane.place(0.6, 2.4, 50.0) == (0.0, 0.0, 0.0)
    wanted = pymap3d.geodetic2enu(0.6003, 2.3995, 80.0, 0.6, 2.4, 50.0, deg=False)
    assert plane.place(0.6003, 2.3995, 80.0) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("name", sorted(set(TOPICS.values())))
def test_the_definitions_are_those_of_ros(name):
    ours = get_types_from_msg(definition(name), name)
    for kind, (_, fields) in ours.items():
        assert fields == STORE.get_msgdef(kind).fields, kind


def test_blocks_are_an_mcap_file_that_its_own_library_reads(tmp_path):
    """In order of time, and found by topic, with their checksums."""
    times = {"a": [5, 7, 9], "b": [6], "c": [30, 20]}
    path = tmp_path / "blocks.mcap"
    with path.open("wb") as file:
        writer = BlockWriter(file, "ros2")
        number = {
            name: writer.add_channel(f"/{name}", "cdr", (name, "ros2msg", b"int32 x"), {"k": name}) for name in "ab"
        }

        def block(name):
            at = np.array(times[name])
            return Rows(number[name], at, Cdr(len(at)).text(name).add("i", at))

        writer.write_chunk([block("a"), block("b")])
        number["c"] = writer.add_channel("/c", "cdr", ("c", "ros2msg", b"int32 x"), {})
        writer.write_chunk([block("c")])
        writer.finish()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        statistics = summary.statistics
        assert (statistics.message_count, statistics.message_start_time, statistics.message_end_time) == (6, 5, 30)
        assert [(len(chunk.message_index_offsets), chunk.message_end_time) for chunk in summary.chunk_indexes] == [
            (2, 9),
            (1, 30),
        ]
        read = [(schema.name, m.log_time, m.data) for schema, _, m in reader.iter_messages()]
        sought = [m.log_time for _, _, m in reader.iter_messages(topics=["/a", "/c"])]
        assert summary.channels[number["b"]].metadata == {"k": "b"}
    assert [time for _, time, _ in read] == [5, 6, 7, 9, 20, 30]
    assert all(data == Cdr().text(name).add("i", time).only() for name, time, data in read)
    assert sought == [5, 7, 9, 20, 30]
