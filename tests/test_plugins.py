"""The example of a plug-in (`docs/plugin`) is installed as a user would install it, and runs in the daemon."""

import os
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from processes import daemon

from imud.drivers.driver import DECODER_FIELDS
from imud.drivers.plugins import plugins
from imud.errors import CannotCreateError, ConfigError, ImudError
from imud.outputs.plugin import opened
from imud.stages import decoding

EXAMPLE = Path(__file__).resolve().parents[1] / "docs" / "plugin"
RATE_DPS = 10.0


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder in which the example is installed."""
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*command, "--target", target, EXAMPLE], capture_output=True, text=True, check=False)
    if "No module named pip" in done.stderr:
        pytest.skip("this environment has no pip")
    assert done.returncode == 0, done.stderr
    return target


def imud(*arguments, path):
    environment = {**os.environ, "PYTHONPATH": str(path)}
    command = [sys.executable, "-m", "imud", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def frame(counter):
    """As its data sheet has it: at rest, but for a turn about the vertical."""
    body = struct.pack(">B6h", counter & 255, 0, 0, round(RATE_DPS * 100), 0, 0, -1000)
    return b"\xa5\x5a" + body + bytes([sum(body) & 255])


@pytest.mark.thorough
def test_driver_estimator_and_output_of_another_package_run_in_the_daemon(installed, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(installed))
    master, slave = os.openpty()
    ended = threading.Event()

    def stream():
        began, counter = time.monotonic(), 0
        while not ended.wait(0.01):
            while counter < (time.monotonic() - began) * 100.0:
                os.write(master, frame(counter))
                counter += 1

    sender = threading.Thread(target=stream)
    sender.start()
    lines = tmp_path / "lines.txt"
    try:
        port = f"{os.ttyname(slave)}:example@115200"
        setting = f'outputs=["lines:{lines}"]'
        with daemon(tmp_path, "--port", port, "--estimator", "strapdown", "--set", setting) as running:
            running.says("numba compiles kernels")
            running.says("of='example strapdown'")
            running.says("Example 6-axis")
            while not lines.exists() or len(rows := [*map(str.split, lines.read_text().splitlines())]) < 4:
                assert running.process.poll() is None, running.log
                time.sleep(0.1)
    finally:
        ended.set()
        sender.join()
        os.close(master)
        os.close(slave)
    (t0, *_, yaw0), (t1, *_, yaw1) = ([float(cell) for cell in row] for row in rows[1:3])
    assert yaw1 - yaw0 == pytest.approx(RATE_DPS * (t1 - t0), abs=1.0)


@pytest.mark.thorough
def test_names_of_plug_ins_are_known_everywhere(installed, tmp_path):
    said = imud("run", "--port", "/dev/absent:example", "--estimator", "strapdown", "--check", path=installed)
    assert said.returncode == 0, said.stderr
    said = imud("run", "--port", "/dev/absent", "--estimator", "strapdow", "--check", path=installed)
    assert said.returncode == 64 and "strapdown" in said.stderr


def test_without_plug_ins_none_is_looked_for(monkeypatch):
    code = "import sys; from imud.drivers.registry import names; names(); print('importlib.metadata' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_plug_in_that_cannot_be_imported_is_left_out(tmp_path):
    folder = tmp_path / "broken-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[imud.drivers]\nbroken = no_such_module:DRIVER\n")
    said = imud("run", "--port", "/dev/absent", "--check", path=tmp_path)
    assert said.returncode == 0, said.stderr
    said = imud("run", "--port", "/dev/absent:broken", "--check", path=tmp_path)
    assert said.returncode != 0 and "plug-in broken (no_such_module:DRIVER) is left out" in said.stderr


@pytest.mark.parametrize("lacking", ["also_speaks", "sends_fixes"])
def test_a_driver_that_is_a_native_protocol_by_half_is_named_with_what_it_lacks(lacking, tmp_path):
    folder = tmp_path / "half-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: half\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[imud.drivers]\nhalf = half:DRIVER\n")
    members = {"also_speaks": '"nmea"', "sends_fixes": "lambda received: False"}
    for left_out, lacks in (({lacking}, True), (set(), False), (set(members), False)):
        lines = [f"DRIVER.{name} = {value}" for name, value in members.items() if name not in left_out]
        code = ["from imud.drivers.nmea.driver import Nmea", "DRIVER = Nmea()", "DRIVER.name = 'half'", *lines]
        (tmp_path / "half.py").write_text("\n".join(code))
        said = imud("run", "--port", "/dev/absent:half", "--check", path=tmp_path)
        assert said.returncode == 0
        assert (f"the driver half of a plug-in lacks {lacking}, " in said.stderr) == lacks
        assert (
            "it queries every silent line, and the driver of the other protocol may be used" in said.stderr
        ) == lacks


def test_a_list_that_cannot_be_read_ends_nothing(tmp_path):
    (tmp_path / "odd-1.0.dist-info" / "entry_points.txt").mkdir(parents=True)
    said = imud("run", "--port", "/dev/absent", "--check", path=tmp_path)
    assert said.returncode == 0, said.stderr


def test_an_output_that_is_not_there_or_does_not_open_is_named(monkeypatch):
    with pytest.raises(ConfigError, match="no plug-in 'absent'"):
        opened("absent:x")

    def refuses(argument):
        raise {"": ValueError("name a file")}.get(argument, OSError("no space"))

    monkeypatch.setitem(plugins("imud.outputs"), "refuses", refuses)
    with pytest.raises(ConfigError, match="outputs: refuses: name a file"):
        opened("refuses")
    with pytest.raises(CannotCreateError, match="refuses:x: no space"):
        opened("refuses:x")


def test_a_decoder_whose_state_lacks_a_field_is_named():
    class Driver:
        name = "incomplete"
        decode = staticmethod(len)

    state = np.zeros(1, [(name, "<i8") for name in DECODER_FIELDS if name not in ("lost", "status")])
    with pytest.raises(ImudError, match="driver incomplete has no field lost, status"):
        decoding(Driver(), state)
