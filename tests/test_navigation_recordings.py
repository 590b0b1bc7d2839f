"""Real drives with ground truth, each fix used when it arrived, one default profile, no start values."""

import numpy as np
import pytest
from navigation_runner import SHARED, evaluate

ROOM = SHARED / "navigation"
pytestmark = pytest.mark.skipif(not ROOM.exists(), reason=f"no recordings in {ROOM}")

# recording, fixes: horizontal position m, horizontal velocity m/s, yaw deg, outage s, its median and RMS m
BOUNDS = [
    ("ixr-0412", "rtk", 0.02, 0.05, None, "60", 2.5, 5.0),
    ("ixr-0412", "nmea_grade", 2.5, 0.08, None, "30", 5.0, 8.0),
    ("ixr-0412", "receiver_like", 2.4, 0.08, None, "60", 4.0, 6.0),
    ("dtu-ugv4", "rtk", 0.09, 0.09, 1.4, "30", 7.0, 12.0),
    ("dtu-ugv4", "nmea_grade", 3.2, 0.15, 2.2, "30", 7.0, 20.0),  # two windows begin before the heading is found
    ("dtu-ugv4", "receiver_like", 3.2, 0.12, 1.8, "30", 7.0, 20.0),
]


@pytest.mark.parametrize("name, fixes, position, velocity, yaw, outage, median, rms", BOUNDS)
def test_errors_stay_within_what_was_reached(name, fixes, position, velocity, yaw, outage, median, rms):
    figures = evaluate(name, fixes, outages=(outage,))
    channels, nees = figures["channels"], figures["nees"]
    assert channels["pH"]["rms"] < position
    assert channels["vH"]["rms"] < velocity
    assert nees["pos"]["anees"] < 2.0
    if yaw is not None:
        assert channels["yaw"]["rms"] < yaw
        assert channels["roll"]["rms"] < 0.4
        assert channels["pitch"]["rms"] < 0.6
    ends = figures["outages"][outage]
    assert np.median(ends[:, 0]) < median
    assert np.sqrt(np.mean(ends[:, 0] ** 2)) < rms
    assert np.median(ends[:, 1]) < 2.0
