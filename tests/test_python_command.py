"""Processes that imud starts run this imud, not one that the current folder holds."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import imud
from imud import __version__
from imud.daemon.simulated import emulated
from imud.process.python import python_command

ROOT = Path(imud.__file__).parents[1]


@pytest.fixture
def beside_another_imud(tmp_path, monkeypatch):
    """The current folder is one with an imud that does nothing but end."""
    other = tmp_path / "imud"
    other.mkdir()
    (other / "__init__.py").write_text("raise SystemExit('another imud')")
    (other / "__main__.py").write_text("")
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("beside_another_imud")
def test_another_imud_in_the_current_folder_is_not_run():
    done = subprocess.run(python_command("imud", "--version"), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.splitlines()[:1]) == (0, [f"imud {__version__}"]), done.stderr


@pytest.mark.usefixtures("beside_another_imud")
def test_an_emulated_port_beside_another_imud():
    with emulated(["sim:car"], 1) as made:
        assert [Path(port).exists() for port in made.ports] == [True]


def test_in_a_checkout_its_own_imud_is_run_also_without_an_installation(monkeypatch):
    monkeypatch.chdir(ROOT)
    command = python_command("imud", "--version")
    command[1:1] = ["-S"]  # without site-packages, and so without what is installed
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": ""})
    assert (done.returncode, done.stdout.splitlines()[:1]) == (0, [f"imud {__version__}"]), done.stderr


def test_no_other_file_runs_a_module_with_python():
    allowed = {"process/python.py", "compile/rebuild.py", "compile/build.py"}  # in this imud; not imud
    found = {
        p.relative_to(ROOT / "imud").as_posix()
        for p in (ROOT / "imud").rglob("*.py")
        if 'executable, "-m"' in p.read_text()
    }
    assert found <= allowed


def test_a_current_folder_that_has_been_deleted_is_named(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    words = [sys.executable, "-P", "-m", "imud", "--port", "sim:rest"]
    done = subprocess.run(
        ["sh", "-c", f"cd {gone} && rmdir {gone} && exec {shlex.join(words)}"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == "imud: the current folder: No such file or directory\n"
    assert done.returncode == 74
