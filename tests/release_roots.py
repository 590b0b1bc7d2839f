"""Do a release's wheels run where they are for? `python tests/release_roots.py WHEELS ROOTS [ARCH..]` tries it.

For each architecture a small Debian 13, or another one by --suite, is made in ROOTS, unless it is there (see
`debian_roots.py`, also for what it needs). The wheel is installed there, golden traces are computed and compared with
those of the repository, and `imud demo` drives, with the sensor at 125 samples/s: qemu is slow. Exit 1 if something
fails.
"""

import argparse
import shutil
import subprocess
import sys
import time
from pathlib import Path

from debian_roots import SUITE, inside, make_root, python_of, register, run

HERE = Path(__file__).parent
WHEELS = {"amd64": "x86_64", "arm64": "aarch64", "armhf": "armv7l"}  # Debian's name -> that of the wheel
STRUCTLOG = "structlog>=25.5"  # Debian 13's is older
TRACES = ("attitude-hand", "navigation-boat", "riss", "tilt", "suh-adaptive")  # and all whose names begin so
DEMO_S = 15


def install(wheel: Path, root: Path, log: Path) -> None:
    """The wheel in /opt/imud, by this machine's pip, and the tests in /opt/tests. Raises CalledProcessError."""
    for folder in ("imud", "tests"):
        shutil.rmtree(root / "opt" / folder, ignore_errors=True)
    shutil.copytree(HERE, root / "opt/tests", ignore=shutil.ignore_patterns("__pycache__", "corpus"))
    platform = wheel.stem.rpartition("-")[2]
    there = ["--platform", platform, "--python-version", python_of(root), "--target", f"{root}/opt/imud"]
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--only-binary=:all:"]
    run([*pip, *there, str(wheel), STRUCTLOG], log)


def check(architecture: str, wheels: Path, root: Path, suite: str) -> bool:
    """Whether all of it went well; says what did not."""
    log = root.with_suffix(".log")
    log.write_text("")
    begin = time.monotonic()
    steps = {
        "kernels": "python3 -c 'from imud.compile import library; assert library.current(), 1'",
        "goldens": f"cd /opt/tests && python3 golden.py --check {' '.join(TRACES)}",
        "demo": f"python3 -m imud demo --seconds {DEMO_S} --set imu.rate_hz=125",
    }
    done = "root"
    try:
        (wheel,) = wheels.glob(f"imud-*-manylinux_*_{WHEELS[architecture]}.whl")
        register(architecture, log)
        make_root(architecture, root, log, suite)
        done = "installation"
        install(wheel, root, log)
        for done, script in steps.items():  # noqa: B007
            inside(architecture, root, script, log)
    except (subprocess.CalledProcessError, OSError, ValueError) as error:
        print(f"{architecture}: {done} FAILED: {error}; see {log}", flush=True)
        return False
    print(f"{architecture}: {wheel.name}: goldens and demo, {time.monotonic() - begin:.0f} s; see {log}", flush=True)
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], allow_abbrev=False)
    parser.add_argument("wheels", type=Path, help="folder with the wheels of `release.py --machines`")
    parser.add_argument("roots", type=Path, help="folder for the roots; they are kept")
    parser.add_argument("architectures", nargs="*", metavar="ARCH", help=f"of {', '.join(WHEELS)} (default: all)")
    parser.add_argument("--suite", default=SUITE, help=f"of Debian (default {SUITE})")
    arguments = parser.parse_args()
    wanted = arguments.architectures or list(WHEELS)
    if unknown := set(wanted) - set(WHEELS):
        parser.error(f"there is no {', '.join(unknown)}")
    roots = arguments.roots.resolve()
    roots.mkdir(parents=True, exist_ok=True)
    good = [check(each, arguments.wheels, roots / each, arguments.suite) for each in wanted]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
