"""The rooms of the house: which package may import what, read from the import statements themselves."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("imud", "drivers", "firmware_sim")
RUN_TIME = {"numpy", "numba", "llvmlite", "serial", "structlog", "msgspec", "spidev", "gpiod"}
RECORDING = ("drivers/capture.py", "imud/recording/file.py", "imud/commands/export.py")
EXTRAS = {  # file: what it may import that an extra brings
    "imud/commands/web/server.py": {"aiohttp"},
    "imud/commands/web/limits.py": {"aiohttp"},
    **{path: {"mcap"} for path in RECORDING},
}
FORBIDDEN = {  # room: packages it must not know
    "drivers": {"imud", "firmware_sim"},
    "firmware_sim": {"imud", "drivers"},
}
DEVICES = sorted(f"drivers/{path.parent.name}" for path in (ROOT / "drivers").glob("*/driver.py"))
ONLY = {
    room: {"numpy", "drivers"} for room in DEVICES
} | {  # room: all that it may import besides the standard library and itself
    "imud/math": {"numpy", "numba", "llvmlite", "drivers"},
    "drivers/nmea": {"drivers"},
    "drivers/transport": {"serial", "spidev", "gpiod", "drivers"},
}
PORTS = {"serial", "termios", "fcntl", "socket", "select", "time"}  # and waiting: not the business of a device's driver


def imported(path):
    """Absolute names of the modules that a file imports, wherever in it."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            stem = package[: len(package) + 1 - node.level] if node.level else ()
            yield ".".join((*stem, *filter(None, [node.module])))


def top(names):
    return {name.partition(".")[0] for name in names}


def files(room):
    found = sorted((ROOT / room).rglob("*.py"))
    assert found, f"no room {room}"
    return found


def standard(names):
    return {name for name in names if name in sys.stdlib_module_names or name == "__future__"}


@pytest.mark.parametrize("room", FORBIDDEN)
def test_a_package_does_not_know_the_others(room):
    for path in files(room):
        assert not top(imported(path)) & FORBIDDEN[room], path


@pytest.mark.parametrize("room", ONLY)
def test_a_room_imports_no_more_than_it_may(room):
    own = {room.partition("/")[0]}
    for path in files(room):
        others = top(imported(path)) - ONLY[room] - own
        assert others == standard(others), path


def test_arithmetic_knows_only_how_kernels_are_compiled():
    for path in files("imud/math"):
        inside = {name for name in imported(path) if name.startswith(PACKAGES)}
        assert all(name.startswith(("imud.math", "imud.compile.jit")) for name in inside), path


@pytest.mark.parametrize("room", DEVICES)
def test_a_devices_driver_opens_no_port_and_reads_no_clock(room):
    for path in files(room):
        assert not top(imported(path)) & PORTS, path


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_is_needed_at_run_time_that_is_not_declared(package):
    for path in files(package):
        others = top(imported(path)) - RUN_TIME - set(PACKAGES) - EXTRAS.get(str(path.relative_to(ROOT)), set())
        assert others == standard(others), path


def test_the_reading_of_imports_sees_what_is_there(tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    (tmp_path / "drivers" / "x").mkdir(parents=True)
    module = tmp_path / "drivers" / "x" / "y.py"
    module.write_text(
        "import imud.clocks\nfrom ..sample import SAMPLE\nfrom . import z\ndef f():\n    from scipy import fft\n"
    )
    assert set(imported(module)) == {"imud.clocks", "drivers.sample", "drivers.x", "scipy"}
