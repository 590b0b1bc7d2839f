"""What the wheel and the source distribution hold: one name, `imud`, with the folders that it links to."""

import subprocess
import sys
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).resolve().parents[1]


def packed(builder):
    """Paths in the distribution, with the sources' paths."""
    return {
        Path(file.distribution_path): Path(file.path)
        for file in builder(str(ROOT)).recurse_included_files()
        if "__pycache__" not in file.path
    }


@pytest.fixture(scope="module")
def wheel():
    return packed(WheelBuilder)


@pytest.mark.parametrize("folder", ["drivers", "firmware_sim"])
def test_the_folders_are_part_of_imud(folder, wheel):
    inside = {path.relative_to(f"imud/{folder}") for path in wheel if path.is_relative_to(f"imud/{folder}")}
    there = {path.relative_to(ROOT / folder) for path in (ROOT / folder).rglob("*.py")}
    assert there <= inside
    for packages in (wheel, packed(SdistBuilder)):
        assert Path("imud", folder, "__init__.py") in packages


def test_the_wheel_has_no_other_name(wheel):
    assert {path.parts[0] for path in wheel} == {"imud"}


def test_the_modules_are_found_under_their_name():
    code = "import imud.drivers.sample as s, imud.firmware_sim.motion as m; print(s.__file__, m.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    file, name = done.stdout.split()
    assert Path(file).resolve() == ROOT / "drivers" / "sample.py" and name == "imud.firmware_sim.motion"
