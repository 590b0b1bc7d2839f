"""ROS 2 messages as another reader of CDR sees them, for the tests of ROS 2."""

import numpy as np
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from imud.ros2.converter import Converter
from imud.ros2.definitions import TOPICS
from imud.ros2.messages import Sigmas
from imud.sensor_errors.profiles import SampleSigma

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
