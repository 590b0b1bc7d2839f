"""Barometers and magnetometers of the kernel: what sysfs says, in the daemon's units; read by a thread."""

import errno
import itertools
import json
import os
import select
import time

import pytest
from processes import daemon, emulator

from imud.commands import main
from imud.commands.doctor import iio_polled
from imud.daemon.iio_reader import IioReader
from imud.drivers.errors import PortAbsentError
from imud.drivers.transport.iio_polled import PolledSensor, find_polled, polled_sensors

CHIPS = {  # folder: attributes, as Documentation/ABI/testing/sysfs-bus-iio has them
    # bmp280: (raw + offset) * scale in kilopascal
    "iio:device0": {"name": "bmp280", "in_pressure_raw": "25433600", "in_pressure_scale": "0.000003906"},
    # ak8975: a scale for each axis, in Gauss, and a mount matrix
    "iio:device1": {
        "name": "ak8975",
        "label": "compass",
        **{f"in_magn_{axis}_raw": raw for axis, raw in zip("xyz", ("100", "-40", "-150"), strict=True)},
        **{f"in_magn_{axis}_scale": "0.003" for axis in "xyz"},
        "in_mount_matrix": "0, -1, 0; 1, 0, 0; 0, 0, 1",
    },
    # one that gives kilopascal itself, as dps310 does, and is no magnetometer
    "iio:device2": {"name": "dps310", "in_pressure_input": "101.325000"},
    # hmc5883: one scale for all axes
    "iio:device3": {
        "name": "hmc5883",
        **{f"in_magn_{axis}_raw": raw for axis, raw in zip("xyz", ("200", "0", "400"), strict=True)},
        "in_magn_scale": "0.001",
        "in_magn_offset": "10",
    },
    "iio:device4": {"name": "bmi160", "in_accel_x_raw": "1"},
}


@pytest.fixture(autouse=True)
def sysfs(tmp_path, monkeypatch):
    root = tmp_path / "iio"
    for folder, attributes in CHIPS.items():
        base = root / "sys/bus/iio/devices" / folder
        base.mkdir(parents=True)
        for name, value in attributes.items():
            (base / name).write_text(value + "\n")
    monkeypatch.setenv("IMUD_IIO_ROOT", str(root))
    return root / "sys/bus/iio/devices"


def received(reader, n, timeout_s=10.0):
    found, end = [], time.monotonic() + timeout_s
    while len(found) < n and time.monotonic() < end:
        select.select([reader.fd], [], [], 0.2)
        found += [json.loads(data) for data in reader.datagrams()]
    return found


def test_those_that_there_are():
    there = [(each.name, each.kind) for each in polled_sensors()]
    assert there == [
        ("bmp280", "barometer"),
        ("ak8975", "magnetometer"),
        ("dps310", "barometer"),
        ("hmc5883", "magnetometer"),
    ]


def test_values_in_pascal_and_tesla_in_the_vehicles_axes():
    [bmp280], [dps310] = find_polled("bmp280"), find_polled("device2")
    assert bmp280.read() == pytest.approx((25433600 * 0.000003906 * 1000.0,))
    assert dps310.read() == pytest.approx((101325.0,))
    [ak8975], [hmc5883] = find_polled("compass"), find_polled("iio:device3")
    # the mount matrix makes of (x, y, z) = (0.3, -0.12, -0.45) G: x forward 0.12, y left 0.3, z up -0.45
    assert ak8975.read() == pytest.approx((12e-6, -30e-6, 45e-6))
    assert hmc5883.read() == pytest.approx((21e-6, -1e-6, -41e-6))


def test_a_reading_that_fails_now_and_then_costs_itself_only(sysfs, monkeypatch):
    read, count = PolledSensor.read, itertools.count()

    def fails_every_third_time(sensor):
        if next(count) % 3 == 0:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return read(sensor)

    monkeypatch.setattr(PolledSensor, "read", fails_every_third_time)
    reader = IioReader(("bmp280",), 50.0, select.poll())
    try:
        begin = next(count)
        assert len(received(reader, 20)) >= 20
        assert 1.3 < (next(count) - begin) / 20 < 2.0
        assert not any("Input/output" in text for text in list(reader.messages)[1:])
    finally:
        reader.close()


def test_a_defect_does_not_end_the_reader_but_is_reported(sysfs, monkeypatch):
    def fail(sensor):
        raise ZeroDivisionError

    monkeypatch.setattr(PolledSensor, "read", fail)
    reader = IioReader(("bmp280",), 50.0, select.poll())
    try:
        end = time.monotonic() + 30.0
        while not reader.messages and reader._thread.is_alive() and time.monotonic() < end:
            time.sleep(0.01)
        assert list(reader.messages) == ["iio:bmp280 cannot be read: ZeroDivisionError()"]
        assert reader._thread.is_alive()
    finally:
        reader.close()


def test_one_that_is_not_there_names_those_that_are():
    with pytest.raises(PortAbsentError, match=r"'bmp388'; there are: bmp280 \(iio:device0, barometer\)"):
        find_polled("bmp388")


def test_the_reader_sends_what_other_programs_would_send_and_finds_what_comes_later(sysfs):
    pressure = sysfs / "iio:device0/in_pressure_raw"
    reader = IioReader(("bmp280", "ak8975"), 50.0, select.poll())
    try:
        first = {each["class"]: each for each in received(reader, 6)}
        assert first["BARO"]["pressure"] == pytest.approx(99343.64, abs=0.1)
        assert [first["MAG"][axis] for axis in "xyz"] == pytest.approx([12.0, -30.0, 45.0])
        assert abs(first["MAG"]["t"] - time.time()) < 60.0
        pressure.write_text("\n")  # a driver that fails
        classes, end = [], time.monotonic() + 30.0
        while not any("bmp280 cannot be read" in text for text in reader.messages) and time.monotonic() < end:
            classes += [each["class"] for each in received(reader, 1)]
        assert any("bmp280 cannot be read" in text for text in reader.messages)
        assert {each["class"] for each in received(reader, 6)} == {"MAG"} and classes.count("MAG") > 10
        pressure.write_text("25433600\n")
        assert any(each["class"] == "BARO" for each in received(reader, 400))
    finally:
        reader.close()
    assert not reader._thread.is_alive()


def test_probe_and_doctor_list_them(sysfs, capsys):
    main(["probe"])
    said = capsys.readouterr().out
    assert 'iio:device0: bmp280, barometer, --set aiding.iio=["bmp280"]' in said
    assert "iio:device1: ak8975, magnetometer" in said
    findings = [finding.what for finding in iio_polled(sysfs.parents[3])]
    assert any(text.startswith("IIO barometer dps310 (iio:device2) may be read") for text in findings)


def test_a_daemon_takes_them_beside_its_ports(tmp_path):
    imu, gnss = tmp_path / "imu", tmp_path / "gnss"
    ports = ("--port", str(imu), "--port", str(gnss))
    settings = ("--set", 'aiding.iio=["bmp280", "ak8975"]', "--set", "aiding.magnetometer=true")
    with (
        emulator("g350", "nmea", "--scenario", "rest", links=[imu, gnss]),
        daemon(tmp_path, *ports, *settings) as imud,
    ):
        imud.says("measurements come: barometer")
        imud.says("measurements come: magnetometer")
