"""Which package, folder and file may import what, read from the import statements themselves."""

import ast
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from import_graph import import_graph, import_statements, in_folders

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("imud", "drivers", "firmware_sim")
RUN_TIME = {"numpy", "numba", "llvmlite", "serial", "structlog", "msgspec", "spidev", "gpiod"}
RECORDING = (
    "drivers/capture.py",
    "imud/recording/file.py",
    "imud/ros2/block_writer.py",
    "firmware_sim/recorded_bytes.py",
)
EXTRAS = {  # file: what it may import that an extra brings
    "imud/commands/web/server.py": {"aiohttp"},
    "imud/commands/completion.py": {"shtab"},
    "imud/commands/export/parquet_folder.py": {"pyarrow"},
    "imud/commands/foxglove/server.py": {"foxglove"},
    "imud/commands/ros2/node.py": {"rclpy"},
    "imud/estimators/earth_field.py": {"pygeomag"},
    "imud/commands/web/limits.py": {"aiohttp"},
    **{path: {"mcap"} for path in RECORDING},
    "drivers/capture.py": {"lz4", "mcap", "zstandard"},  # the others are what mcap needs
    "imud/ros2/block_writer.py": {"mcap", "zstandard"},
}
FORBIDDEN = {  # room: packages it must not know
    "drivers": {"imud", "firmware_sim"},
    "firmware_sim": {"imud", "drivers"},
}
DEVICES = sorted(f"drivers/{path.parent.name}" for path in (ROOT / "drivers").glob("*/driver.py"))
FLOORS = (  # lowest first; a file imports from its own floor or below; of several paths that fit the longest counts
    ("drivers",),  # the protocol of drivers, samples, fixes, errors
    ("drivers/transport", *DEVICES),
    ("drivers/detect.py", "firmware_sim"),
    ("firmware_sim/faults",),
    (
        "firmware_sim/iio.py",
        "firmware_sim/iio_polled.py",
        "firmware_sim/programs.py",
        "firmware_sim/build.py",
        "firmware_sim/emulator.py",
        "firmware_sim/cli.py",
        "firmware_sim/__main__.py",
    ),
    ("firmware_sim/bench.py",),
    ("firmware_sim/stand_in",),
    (
        "imud/__init__.py",
        "imud/client.py",
        "imud/errors.py",
        "imud/filter_state_names.py",
        "imud/folders.py",
        "imud/late_imports.py",
        "imud/progress.py",
    ),
    ("imud/compile",),
    ("imud/math", "imud/figures.py"),
    ("imud/configuration", "imud/process"),
    ("imud/clocks", "imud/sensor_errors", "imud/sensor_monitor"),
    ("imud/estimators", "imud/estimators/ahrs", "imud/estimators/papers", "imud/estimators/riss"),
    ("imud/estimators/ins/state.py", "imud/estimators/ins/types.py"),
    tuple(f"imud/estimators/ins/{folder}/records.py" for folder in ("aiding", "alignment", "glr_tests", "integrity")),
    ("imud/estimators/ins/core.py",),
    ("imud/estimators/ins/mechanization.py", "imud/estimators/ins/vehicle_axes.py"),
    ("imud/estimators/ins/ekf.py",),
    ("imud/estimators/ins/noise_density.py",),
    (
        "imud/estimators/ins/checkpoint.py",
        "imud/estimators/ins/error_model.py",
        "imud/estimators/ins/filter_states.py",
        "imud/estimators/ins/findings.py",
        "imud/estimators/ins/integrity/alternating_receiver.py",
        "imud/estimators/ins/lever_arm.py",
        "imud/estimators/ins/setup.py",
        "imud/estimators/ins/solution.py",
        "imud/estimators/ins/source_estimates.py",
    ),
    (  # what has to see every step of the Kalman filter
        "imud/estimators/ins/glr_tests",
        "imud/estimators/ins/process_noise.py",
        "imud/estimators/ins/time_evidence.py",
        "imud/estimators/ins/boresights.py",
        "imud/estimators/ins/integrity/position_jump.py",
        "imud/estimators/ins/integrity/reset_inflation.py",
        "imud/estimators/ins/alignment/force_integrals.py",
        "imud/estimators/ins/alignment/vector_pairs.py",
        "imud/estimators/ins/alignment/velocity_change.py",
    ),
    ("imud/estimators/ins/fusion.py",),
    ("imud/estimators/ins/bias_changes.py", "imud/estimators/ins/stationarity.py", "imud/estimators/ins/rest.py"),
    ("imud/estimators/ins/aiding",),
    ("imud/estimators/ins/alignment",),
    ("imud/estimators/ins/integrity", "imud/estimators/ins/rest_gap.py", "imud/estimators/ins/power_on.py"),
    ("imud/estimators/ins/propagation.py", "imud/estimators/ins/damaged_readings.py"),
    ("imud/estimators/ins/imu_sample.py",),
    ("imud/estimators/ins/fusion_horizon.py", "imud/estimators/ins/velocity_epoch.py"),
    ("imud/estimators/ins/gnss_fix.py", "imud/estimators/ins/sources.py"),
    ("imud/estimators/ins/filter.py",),
    ("imud/estimators/ins/parameters.py",),
    ("imud/estimators/ins/__init__.py",),
    ("imud/setup", "imud/stages.py"),
    ("imud/pipeline.py",),
    ("imud/sensors",),
    ("imud/outputs", "imud/tables"),
    ("imud/recording", "imud/batch.py", "imud/smoothing"),
    ("imud/daemon/fast_loop.py", "imud/ros2"),
    ("imud/kernel_calls.py",),
    ("imud/daemon",),
    ("imud/experiments", "imud/api"),
    ("imud/commands", "imud/compile/__main__.py"),
    ("imud/__main__.py",),
)
FLOOR = {place: floor for floor, places in enumerate(FLOORS) for place in places}
ONLY = {
    room: {"numpy", "drivers"} for room in DEVICES
} | {  # room: all that it may import besides the standard library and itself
    "imud/math": {"numpy", "numba", "llvmlite", "drivers"},
    "drivers/nmea": {"drivers"},
    "drivers/transport": {"serial", "spidev", "gpiod", "drivers"},
}
PORTS = {"serial", "termios", "fcntl", "socket", "select", "time"}  # and waiting: not the business of a device's driver


def origin(path, node):
    """The absolute name of the module from which a statement of a file imports."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    stem = package[: len(package) + 1 - node.level] if node.level else ()
    return in_folders(".".join((*stem, *filter(None, [node.module]))))


def imported(path):
    """Absolute names of the modules that a file imports."""
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            yield from (in_folders(alias.name) for alias in node.names)
        else:
            yield origin(path, node)


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
    for path in files("imud/math"):  # drivers: for drivers.elementary
        inside = {name for name in imported(path) if name.startswith(PACKAGES)}
        assert all(name.startswith(("imud.math", "imud.compile.jit", "drivers")) for name in inside), path


@pytest.mark.parametrize("room", DEVICES)
def test_a_devices_driver_opens_no_port_and_reads_no_clock(room):
    for path in files(room):
        assert not top(imported(path)) & PORTS, path


@pytest.mark.thorough
@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_is_needed_at_run_time_that_is_not_declared(package):
    for path in files(package):
        others = top(imported(path)) - RUN_TIME - set(PACKAGES) - EXTRAS.get(str(path.relative_to(ROOT)), set())
        assert others == standard(others), path


def place_of(file):
    """The folder or file of FLOORS to which a file belongs."""
    fitting = [place for place in FLOOR if file == place or file.startswith(f"{place}/")]
    assert fitting, f"{file}: no floor in FLOORS"
    return max(fitting, key=len)


@pytest.fixture(scope="module")
def graph():
    """For each file the files that it imports."""
    return import_graph(ROOT, PACKAGES)


def circle(graph):
    """A circle in the graph, or nothing."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_every_module_of_the_floors_exists(graph):
    assert {place_of(file) for file in graph} == set(FLOOR)


def test_no_file_imports_from_a_higher_floor(graph):
    upward = [(a, b) for a, others in graph.items() for b in others if FLOOR[place_of(a)] < FLOOR[place_of(b)]]
    assert not upward


def test_no_circle_between_files(graph):
    assert not circle(graph)


def test_no_circle_between_places(graph):
    between = {place: set() for place in FLOOR}
    for file, others in graph.items():
        between[place_of(file)] |= {place_of(other) for other in others} - {place_of(file)}
    assert not circle(between)


def test_imud_is_the_only_name_that_is_imported():
    """The wheel has no other; `drivers` is another project's on PyPI."""
    for path in [file for room in (*PACKAGES, "tests") for file in files(room)]:
        statements = import_statements(path)
        names = {node.module for node in statements if isinstance(node, ast.ImportFrom) and not node.level}
        assert not top(names) & {"drivers", "firmware_sim"}, path


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_are_relative_within_a_package_and_absolute_between_packages(package):
    for path in files(package):
        if "stand_in" in path.parts:  # top-level modules, in the place of spidev and gpiod
            continue
        statements = import_statements(path)
        names = {alias.name for node in statements if isinstance(node, ast.Import) for alias in node.names}
        assert package not in top(map(in_folders, names)), path
        for node in statements:
            if isinstance(node, ast.ImportFrom):
                own = top({origin(path, node)}) == {package}
                assert own == (node.level > 0), f"{path}:{node.lineno}"


def test_sensors_do_not_know_outputs(graph):
    outputs = {file for file in graph if file.startswith("imud/outputs/")}
    assert not [file for file, others in graph.items() if file.startswith("imud/sensors/") and others & outputs]


@pytest.mark.parametrize("package", PACKAGES)
def test_no_shipped_file_imports_a_test(package):
    tests = {path.stem for path in (ROOT / "tests").glob("*.py")} | {"tests"}
    for path in files(package):
        assert not top(imported(path)) & tests, path


def test_the_readme_of_imud_names_each_of_its_folders():
    text = (ROOT / "imud" / "README.md").read_text()
    links = {"drivers", "firmware_sim"}  # to the folders beside it, which docs/architecture.md names
    folders = {path.parent.name for path in (ROOT / "imud").glob("*/__init__.py")} - links
    assert {name for name in folders if f"| `{name}/` |" not in text} == set()


def test_the_graph_of_imports_sees_what_is_there(tmp_path):
    (tmp_path / "p" / "q").mkdir(parents=True)
    for name, text in {
        "p/__init__.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .a import f\n",
        "p/a.py": "from typing import TYPE_CHECKING\nfrom .q import b\nif TYPE_CHECKING:\n    from .q.c import D\n",
        "p/q/__init__.py": "",
        "p/q/b.py": "def f():\n    from .. import a\n",
        "p/q/c.py": "import p.q.b\nfrom ..a import f\n",
    }.items():
        (tmp_path / name).write_text(text)
    found = import_graph(tmp_path, ("p",))
    assert found["p/__init__.py"] == set()
    assert found["p/a.py"] == {"p/q/b.py", "p/q/c.py"}
    assert found["p/q/b.py"] == {"p/a.py"}
    assert found["p/q/c.py"] == {"p/q/b.py", "p/a.py"}
    assert circle(found)


def test_the_reading_of_imports_sees_what_is_there(tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    (tmp_path / "drivers" / "x").mkdir(parents=True)
    module = tmp_path / "drivers" / "x" / "y.py"
    module.write_text(
        "import imud.clocks\nfrom imud.drivers import fix\nfrom ..sample import SAMPLE\nfrom . import z\n"
        "def f():\n    from scipy import fft\n"
    )
    assert set(imported(module)) == {"imud.clocks", "drivers", "drivers.sample", "drivers.x", "scipy"}
