"""Do the tests pass on aarch64? `python tests/aarch64_tests.py FOLDER [FILE..]` runs them under qemu-user.

In FOLDER a small Debian 13 for arm64 is made, unless it is there (see `debian_roots.py`, also for what it needs), and
the wheel for it, which needs the packages `hatchling` and `ziglang`. pip installs the wheel there with the packages of
the tests; the tests come from the working tree. Without FILE it is a choice: the whole suite would take hours, and
tests that call kernels one by one need numba, which is not there. Those that qemu is too slow for are not run, and
named with the reason. Exit 1 if a test fails.
"""

import argparse
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from debian_roots import inside, make_root, python_of, register, run
from release import copied, wheel

TARGET = "aarch64-linux-gnu.2.28"
PLATFORMS = ("manylinux2014_aarch64", "manylinux_2_17_aarch64", "manylinux_2_28_aarch64")
PACKAGES = (  # without those for pages, notebooks, numba
    *("numpy>=2.0", "msgspec>=0.19", "pyserial>=3.5", "structlog>=25.5", "scipy", "mcap", "protobuf>=5"),
    *("pytest", "pytest-timeout", "hypothesis", "pynmeagps", "pyubx2", "pymap3d", "mpmath"),
)
KERNELS = "imud/compile/kernels.so"
DAEMON = sorted(path.stem for path in Path(__file__).parent.glob("test_*daemon*.py"))
TESTS = ("test_nmea", "test_ubx", "test_tilt", *DAEMON)  # what needs no numba
TWO_SENSORS = "daemon and emulators of two sensors need two processors for themselves under qemu"
SPARES = "test_daemon_spares.py::test_"
LEFT_OUT = {  # what qemu is too slow for, and why
    f"{SPARES}one_in_use_whose_rates_gravity_contradicts_is_replaced_by_the_spare": TWO_SENSORS,
    "test_daemon_spare_restarts.py::test_how_a_spare_sits_is_known_over_a_restart": TWO_SENSORS,
    f"{SPARES}a_spare_that_sits_otherwise_than_the_settings_say_is_turned_once_motion_has_shown_it": (
        "one process emulates two sensors in motion, which needs 1.2 processors under qemu"
    ),
}
TIMEOUT_S = 1200  # of one test


def install(folder: Path, root: Path, log: Path) -> None:
    """Wheel and packages where Python finds them by itself, the working tree in /opt/source, with the wheel's kernels:
    some tests set PYTHONPATH to it. Raises CalledProcessError.
    """
    packages, source = root / f"usr/local/lib/python{python_of(root)}/dist-packages", root / "opt/source"
    for path in (packages, source, root / "opt/imud"):  # the last: of `release_roots.py`
        shutil.rmtree(path, ignore_errors=True)
    built = wheel(folder, TARGET)
    copied(source)
    platforms = [option for name in (built.stem.rpartition("-")[2], *PLATFORMS) for option in ("--platform", name)]
    there = [*platforms, "--python-version", python_of(root), "--only-binary=:all:", "--target", str(packages)]
    pip = [sys.executable, "-m", "pip", "install", "-q", *there]
    run([*pip, *PACKAGES], log)
    run([*pip, "--no-deps", str(built)], log)
    shutil.copy(packages / KERNELS, source / KERNELS)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], allow_abbrev=False)
    parser.add_argument("folder", type=Path, help="for the root, the wheel and the log; it is kept")
    parser.add_argument("files", nargs="*", metavar="FILE", help=f"of tests (default: {', '.join(TESTS)})")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    root, log = folder / "arm64", folder / "tests.log"
    log.write_text("")
    files = [f"{Path(name).stem}.py" for name in arguments.files or TESTS]
    pytest = f"python3 -m pytest -o addopts= -p no:cacheprovider -v -rfEs --timeout={TIMEOUT_S}"
    left_out = shlex.join(f"--deselect=tests/{name}" for name in LEFT_OUT)
    try:
        register("arm64", log)
        make_root("arm64", root, log)
        install(folder, root, log)
        inside("arm64", root, f"cd /opt/source/tests && {pytest} {left_out} {shlex.join(files)}", log)
    except (subprocess.CalledProcessError, OSError) as error:
        print(f"arm64 FAILED: {error}")
        return 1
    finally:
        print(*(f"left out: {name}: {why}" for name, why in LEFT_OUT.items()), sep="\n")
        print("".join(log.read_text(errors="replace").splitlines(keepends=True)[-40:]), f"log: {log}", sep="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
