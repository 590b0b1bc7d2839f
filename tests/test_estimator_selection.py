"""The filter of the sensor that was found: what another one after it begins anew, and what goes on."""

from types import SimpleNamespace

from imud.configuration.settings import Settings
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
