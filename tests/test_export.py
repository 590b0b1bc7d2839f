"""`imud export` of a recording without an inertial sensor: a receiver alone."""

import argparse
import csv

import msgspec
import pytest
from nmea_lines import gga

from drivers.capture import Connection, Raw
from imud.commands import export
from imud.errors import BadDataError
from imud.recording.file import RecordingFile

SECOND = 1_000_000_000


def recorded(path, fixes):
    file = RecordingFile(path, {"version": "0", "session": "boat"}, b"{}", 0)
    said = Connection(0, 0, "/dev/ttyUSB0", True, "gnss", "nmea", {"identity": {"driver": "nmea", "model": ""}})
    file.write("/connections", 0, msgspec.json.encode(said))
    for second in range(fixes):
        for t_ns, data in ((second * SECOND, gga(f"12000{second}.000")), (second * SECOND + SECOND // 2, b"")):
            file.write("/raw/0", t_ns, msgspec.json.encode(Raw(t_ns, data)))
    file.finish()
    return path


def exported(recording, folder):
    return export.run(argparse.Namespace(recording=[recording], csv=folder, ros2=None, rate=0.0))


def test_fixes_without_an_inertial_sensor_are_exported(tmp_path, capsys):
    assert exported(recorded(tmp_path / "boat.mcap", 5), tmp_path / "boat") == 0
    rows = list(csv.DictReader((tmp_path / "boat" / "gnss.csv").open()))
    assert [(int(float(row["arrival_s"])), float(row["height_m"])) for row in rows] == [(s, 592.3) for s in range(5)]
    assert "no samples of an inertial sensor in it: there are fixes only" in capsys.readouterr().err


def test_a_recording_with_neither_samples_nor_fixes_is_bad_data(tmp_path):
    with pytest.raises(BadDataError, match="no samples of an inertial sensor"):
        exported(recorded(tmp_path / "boat.mcap", 0), tmp_path / "boat")
