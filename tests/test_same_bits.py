"""gcc, clang and numba give the same words; all golden traces: `python tests/same_bits.py`."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from same_bits import LARGER, digests

from imud.compile import library

TESTS = Path(__file__).resolve().parent
NAMES = ("tilt", "stationary")  # numba compiles their kernels in seconds

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module", autouse=True)
def compiled():
    if library.library() is None:
        pytest.skip("there is no C compiler")


def test_numba_gives_the_bits_of_the_library():
    assert digests(NAMES, IMUD_JIT="1") == digests(NAMES)


def made_by(compiler):
    """Whether the library is that compiler's, which wrote its version into it; gcc's is in those of clang, too."""
    if shutil.which(compiler) is None or library.library() is None:
        return False
    said = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
    code, clang = Path(library.origin()).read_bytes(), b"clang version"
    return said.replace("gcc (", "GCC: (").encode() in code and (clang in code) == (clang in said.encode())


@pytest.mark.parametrize("compiler", [name for name in ("gcc", "clang") if not made_by(name)])
def test_another_compiler_gives_the_same(compiler, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not on this machine")
    assert digests(LARGER, CC=compiler, IMUD_KERNELS=str(tmp_path / "kernels.so")) == digests(LARGER)


def test_for_any_processor_it_is_the_same(tmp_path):
    made = str(tmp_path / "kernels.so")
    subprocess.run([sys.executable, "-m", "imud.compile", made, "--plain"], check=True, cwd=TESTS.parent)
    assert digests(LARGER, IMUD_KERNELS=made) == digests(LARGER)
