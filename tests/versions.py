"""Which Pythons and which versions of its dependencies imud runs with: `python tests/versions.py PYTHON…`.

For each interpreter (a path, or a name on PATH) the wheel is installed into a fresh environment, with the newest
versions that pip finds, and CORE runs there: kernels, golden traces, the daemon. `--lowest` installs the lowest
versions that pyproject.toml allows instead, of everything that imud itself needs (`>=` becomes `==`). `--all` runs all
tests. The tests run on the installed wheel, in a folder without imud's sources. Exit 1 if any of them fails.

An interpreter of another Debian: `debootstrap --include=python3-venv sid ROOT`, and there, in a chroot with the clone
and a wheel of it, `python3 tests/versions.py --wheel FILE`.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from release import ROOT, wheel

EXTRAS = ("completion", "parquet", "plots", "record", "web")
TOOLS = (  # of the tests; always the newest
    *("hypothesis", "mpmath", "pymap3d", "pynmeagps", "pytest", "pytest-timeout", "pytest-xdist", "pyubx2", "rosbags"),
    *("prometheus-client", "scipy", "allantools", "gpxpy", "polars", "protobuf", "hatchling"),
)
CORE = tuple(
    f"test_{name}.py"
    for name in (
        *("elementary", "rotation", "earth", "kalman", "clock", "compile_entry", "attitude", "navigation_strapdown"),
        *("golden", "smoothing", "api", "config", "completion", "recording", "export", "report", "status", "daemon"),
        *("web", "gpsd_server", "plugins"),
    )
)
COPIED = ("tests", "docs", "drivers", "firmware_sim", "README.md", "CONTRIBUTING.md", "pyproject.toml", "systemd")


def lowest(project: dict[str, object]) -> list[str]:
    """Constraints: each lower bound of the package and of EXTRAS as the only version."""
    extras = project["optional-dependencies"]
    assert isinstance(extras, dict)
    required = [*project["dependencies"], *(line for extra in EXTRAS for line in extras[extra])]
    pinned = []
    for line in required:
        requirement, _, marker = line.partition(";")
        match = re.fullmatch(r"([A-Za-z0-9_.-]+)\s*>=\s*([0-9.]+).*", requirement.strip())
        if match is None:
            raise ValueError(f"{line!r} has no lower bound")
        pinned.append(f"{match[1]}=={match[2]}" + (f"; {marker.strip()}" if marker else ""))
    return sorted(set(pinned))


def run(*command: object, **options: object) -> int:
    """The exit code of a command whose output goes to stderr."""
    return subprocess.run([str(word) for word in command], stdout=sys.stderr, check=False, **options).returncode


def check(python: str, built: Path, constraints: Path | None, tests: list[str], folder: Path) -> str:
    """Install and test with one interpreter; what came of it."""
    environment = folder / "venv"
    if run(python, "-m", "venv", environment):
        return "no environment"
    inside = environment / "bin/python"
    install = [inside, "-m", "pip", "install", "-qq", "--disable-pip-version-check"]
    limits = ["--constraint", constraints] if constraints else []
    extras = EXTRAS if tests else (*EXTRAS, "test")
    if run(*install, *limits, f"{built}[{','.join(extras)}]", *TOOLS):
        return "cannot be installed"
    for name in COPIED:
        (shutil.copytree if (ROOT / name).is_dir() else shutil.copy2)(ROOT / name, folder / name)
    command = [inside, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "2", "--dist", "loadfile", *tests]
    return "failed" if run(*command, cwd=folder, env={**os.environ, "PYTHONPATH": ""}) else "passed"


def versions(python: Path) -> str:
    """Of Python, and of what is compiled for it."""
    code = (
        "import importlib.metadata as m, platform; found = {d.name: d.version for d in m.distributions()}; "
        "print(platform.python_version(), *(f'{n} {found[n]}' for n in ('numpy', 'numba', 'msgspec') if n in found))"
    )
    return subprocess.run([python, "-c", code], capture_output=True, text=True, check=False).stdout.strip()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pythons", nargs="*", default=[sys.executable], metavar="PYTHON")
    parser.add_argument("--lowest", action="store_true", help="the lowest versions of the dependencies")
    parser.add_argument("--wheel", type=Path, metavar="FILE", help="instead of one that is built")
    parser.add_argument("--all", action="store_true", help="all tests, with everything of the extra `test`")
    parser.add_argument("--tests", nargs="+", default=CORE, metavar="FILE", help="of tests/ (default: the core)")
    args = parser.parse_args()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    tests = [] if args.all else [f"tests/{name}" for name in args.tests]
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        built = args.wheel or wheel(Path(folder))
        constraints = Path(folder) / "lowest.txt" if args.lowest else None
        if constraints:
            constraints.write_text("\n".join(lowest(project)) + "\n")
        for k, python in enumerate(args.pythons):
            place = Path(folder) / str(k)
            place.mkdir()
            outcome = check(python, built, constraints, tests, place)
            failed |= outcome != "passed"
            print(f"{outcome}: {versions(place / 'venv/bin/python') or python}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
