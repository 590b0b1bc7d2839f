"""Messages of ROS 2 and Foxglove: 24 poses and others in our frames (NED, FRD) and in those of robotics (ENU, FLU).
Oracles: plain matrices, scipy's rotations, Monte Carlo, rosbags' message types. Of the other outputs: test_signs.py.
"""

import datetime
import io

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from poses import FRD_IN_FLU, NED_IN_ENU, POSES, G, solution
from ros2_read import ACCEL, BOTH, SECOND, STORE, converted, matrix, one, read, vector
from rosbags.typesys import get_types_from_msg
from scipy.spatial.transform import Rotation

from imud.drivers.fix import Fix
from imud.drivers.sample import NO_FORCE, NO_RATE, SAMPLE, SUSPECT
from imud.estimators.records import FIX, HEIGHT_VALID, SOLUTION
from imud.recording.enu import LocalMap
from imud.recording.foxglove import location, transform
from imud.recording.messages import ESTIMATE_TABLE
from imud.ros2 import messages
from imud.ros2.block_writer import BlockWriter, Rows
from imud.ros2.cdr import Cdr
from imud.ros2.converter import Converter
from imud.ros2.definitions import TOPICS, definition
from imud.ros2.messages import Diagnosis, Sigmas
from imud.sensor_errors.profiles import PROFILES, sample_sigmas
from imud.sensors.gnss import position_sigma


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


SIGNALLING_NAN = np.array(0x7FF0000000000001, np.uint64).view(np.float64)  # numpy warns when it computes with one


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["lat", "lon"])
@pytest.mark.parametrize("value", [np.nan, -np.inf, SIGNALLING_NAN])
def test_a_valid_position_that_is_no_number_is_no_fix(name, value):
    row = solution(np.eye(3))
    row[name] = value
    fix = read("fix/filtered", one(messages.filtered_fix, row, 7))
    assert (fix.status.status, fix.position_covariance_type) == (-1, 0)
    assert np.isnan(fix.latitude) and np.isnan(fix.longitude)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["sigma_rpy", "sigma_p", "sigma_v", "sigma_bg", "sigma_ba", "w", "f", "v"])
@pytest.mark.parametrize("value", [1e200, -1e308, np.inf, np.nan, SIGNALLING_NAN])
def test_a_covariance_is_finite_whatever_the_state(name, value):
    row = solution(np.eye(3))
    row[name] = value
    converter = Converter()
    converter.sigmas = BOTH
    sent = converted(row, converter)
    odometry = sent["odometry"]
    covariances = [
        *(sent["imu/data"].orientation_covariance, sent["imu/data"].angular_velocity_covariance),
        *(sent["imu/data"].linear_acceleration_covariance, sent["fix/filtered"].position_covariance),
        *(odometry.pose.covariance, odometry.twist.covariance),
    ]
    assert all(np.isfinite(each).all() for each in covariances)
    if name == "sigma_p":
        assert covariances[3].reshape(3, 3).diagonal().min() >= 1e18  # by no means better known than others


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


def test_faults_are_levels_of_diagnostic_status():
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


@pytest.mark.parametrize("name", sorted(set(TOPICS.values())))
def test_the_definitions_are_those_of_ros(name):
    ours = get_types_from_msg(definition(name), name)
    for kind, (_, fields) in ours.items():
        assert fields == STORE.get_msgdef(kind).fields, kind


def test_blocks_are_an_mcap_file_that_its_own_library_reads(tmp_path):
    """In order of time, and found by topic; a damaged byte is noticed."""
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
        reader = make_reader(file)
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
    data = bytearray(path.read_bytes())
    index = summary.chunk_indexes[0]
    data[index.chunk_start_offset + index.chunk_length - 6] ^= 1  # of what is compressed, before its own checksum
    with pytest.raises(zstandard.ZstdError):
        list(make_reader(io.BytesIO(data)).iter_messages())
