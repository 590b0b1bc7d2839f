"""The filter of the sensor that was found: what another one after it begins anew, and what goes on."""

from types import SimpleNamespace

import pytest

from imud.configuration.settings import Imu, Settings
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.registry import by_name
from imud.sensor_errors.calibration import Calibration
from imud.sensors.estimator_selection import EstimatorSelection


def test_the_numbering_and_the_counts_continue_with_another_sensor():
    """Subscribers are promised the number of the sample since the daemon's start."""
    selection = EstimatorSelection(Settings(estimator="tilt"), str)
    driver = by_name("seraccel")
    for serial, before in (("1", 0), ("1", 7), ("2", 14)):
        configured = ImuConfigured(Identity("seraccel", "", serial), 100.0, 10_000_000, 0, 0)
        line = SimpleNamespace(counters={})
        sensor = selection.connect(line, driver, configured, Calibration(serial), Settings(), 0)
        assert sensor.samples == before
        lines = b"\n" + b"0512 0512 0717\n" * 7
        sensor.pipeline.rx[: len(lines)] = bytearray(lines)
        sensor.pipeline.ingest(len(lines), 0)
    assert sensor.samples == sensor.totals()["frames"] == 21


def test_a_filter_whose_time_has_run_ahead_of_the_clock_begins_anew():
    """As after a flood of frames of a sensor without a counter. It would stand still, and say nothing, until then."""
    selection, driver = EstimatorSelection(Settings(estimator="tilt"), str), by_name("seraccel")
    configured = ImuConfigured(Identity("seraccel", "", "1"), 100.0, 10_000_000, 0, 0)
    begin_ns, lines = 1_000_000_000_000, b"0512 0512 0717\n" * 100

    def connect_and_feed(now_ns, times):
        sensor = selection.connect(
            SimpleNamespace(counters={}), driver, configured, Calibration("1"), Settings(), now_ns
        )
        for _ in range(times):
            fill = sensor.pipeline.fill
            sensor.pipeline.rx[fill : fill + len(lines)] = bytearray(lines)
            sensor.pipeline.ingest(len(lines), now_ns)
        return int(sensor.newest["t_ns"]) - now_ns

    assert connect_and_feed(begin_ns, 200) > 10_000_000_000
    assert connect_and_feed(begin_ns + 2_000_000_000, 1) < 1_000_000_000


@pytest.mark.parametrize(
    ("named", "chosen", "says"),
    [("mems-2040", "auto", ["'mems-2040', which there is not: consumer-mems is assumed"]),
     ("mems-2040", "m-g350", []), ("m-g350", "auto", []), ("", "auto", [])],
)  # fmt: skip
def test_a_driver_that_names_a_noise_profile_that_there_is_not_is_reported(named, chosen, says):
    settings = Settings(estimator="tilt", imu=Imu(profile=chosen))
    warnings = []
    configured = ImuConfigured(Identity("seraccel", "", profile=named), 100.0, 10_000_000, 0, 0)
    EstimatorSelection(settings, warnings.append).connect(
        SimpleNamespace(counters={}), by_name("seraccel"), configured, Calibration(""), settings, 0
    )
    assert [each in warning for each, warning in zip(says, warnings, strict=True)] == [True] * len(says)
