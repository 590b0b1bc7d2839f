"""What the wheel and the source distribution hold: one name, `imud`, with the folders that it links to."""

import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).resolve().parents[1]


def packed(builder, root=ROOT):
    """Paths in the distribution, with the sources' paths."""
    return {
        Path(file.distribution_path): Path(file.path)
        for file in builder(str(root)).recurse_included_files()
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


@pytest.mark.thorough
def test_a_wheel_made_from_the_source_distribution_has_the_same_files_and_its_kernels_are_found(wheel, tmp_path):
    """As `pip install imud-….tar.gz` makes it."""
    (archive,) = SdistBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    with tarfile.open(archive) as file:
        file.extractall(tmp_path, filter="data")
    (unpacked,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert set(packed(WheelBuilder, unpacked)) == set(wheel)
    code = "import imud.kernel_calls as c; print(c.__file__, len(c.entries()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=unpacked)
    file, entries = done.stdout.split()
    assert Path(file).is_relative_to(unpacked) and int(entries) > 20
