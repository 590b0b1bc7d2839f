"""What runs with the packages alone that pip installs for plain `imud`, and what its build imports: no extra."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MODULES = {"pyserial": "serial"}  # of packages with another name
ALONE = """
import sys

class Refused:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in {allowed}:
            raise ModuleNotFoundError(f"not installed here: {{name}}", name=name)

sys.meta_path.insert(0, Refused())
"""


def modules(requirements):
    names = [re.match(r"[\w-]+", line)[0] for line in requirements]
    return {MODULES.get(name, name) for name in names}


REQUIRED = modules(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"])


def build_requirements():
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return modules(module._IMPORTED)


def run_with(packages, code):
    allowed = {"imud", *packages, *sys.stdlib_module_names}
    code = ALONE.format(allowed=sorted(allowed)) + code
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_kernels_are_found_with_what_the_wheels_build_installs():
    code = "from imud.kernel_calls import entries\nprint(len(entries()))"
    assert int(run_with(build_requirements(), code)) > 20


def test_the_daemon_the_emulator_and_the_demo_are_imported_without_an_extra():
    run_with(
        REQUIRED, "import imud.daemon.loop, imud.firmware_sim.cli, imud.commands.demo.comparison, imud.api.filters"
    )


def test_every_command_says_without_an_extra_which_arguments_it_has():
    out = run_with(REQUIRED, "from imud.commands import completed_parser\nprint(len(completed_parser()[1]))")
    assert int(out) > 20


def test_the_guard_refuses_an_extra():
    code = "try:\n    import mcap\nexcept ModuleNotFoundError:\n    print('refused')"
    assert run_with(REQUIRED, code) == "refused\n"
