"""Compiling happens before it is needed, in a process of its own, and never again."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

LOADING = """
import json, os, sys
from imud.process import runtime
runtime.prepare()
from numba.core.event import install_recorder
from imud import compilation
from imud.estimators import registry
from imud.configuration.settings import Settings
estimator = registry.by_name("tilt")
with install_recorder("numba:compile") as compiled:
    compilation.warm_decoders()
    compilation.warm(estimator, Settings())
    compilation.warm_replay(estimator, Settings())
print(json.dumps({"compiled": len(compiled.buffer), "missing": len(compilation.missing([estimator]))}))
"""


UNCOMPILED = """
import sys
from imud.process import runtime
runtime.prepare()
from imud import compilation
compilation.warm_decoders = compilation.warm = lambda *_: None  # a silent line needs no kernel
from imud.commands import main
sys.exit(main(sys.argv[1:]))
"""


def run(*arguments, cache, **variables):
    environment = {**os.environ, "NO_COLOR": "1", **variables}
    environment.pop("NUMBA_CACHE_DIR")
    if cache:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, env=environment)


@pytest.fixture(scope="module")
def warmed(tmp_path_factory):
    """A cache filled by `imud warmup`, and what that said."""
    cache = tmp_path_factory.mktemp("cache")
    ended = run("-m", "imud", "warmup", "--estimator", "tilt", cache=cache)
    assert ended.returncode == 0, ended.stderr
    return cache, ended.stdout


def test_warmup_says_where(warmed):
    cache, said = warmed
    assert str(cache) in said
    assert list(cache.rglob("*.nbc"))


def test_after_warmup_nothing_is_compiled(warmed):
    ended = run("-c", LOADING, cache=warmed[0])
    assert json.loads(ended.stdout) == {"compiled": 0, "missing": 0}, ended.stderr


@pytest.fixture
def silent():
    """A port on which nobody answers."""
    ends = pty.openpty()
    yield f"{os.ttyname(ends[1])}:epson@460800"
    for end in ends:
        os.close(end)


def test_a_daemon_finds_what_warmup_compiled(warmed, silent, tmp_path):
    arguments = ("--port", silent, "--no-wait", "--listen", str(tmp_path / "s"))
    ended = run("-m", "imud", "run", "--estimator", "tilt", *arguments, cache=warmed[0])
    assert ended.returncode == 69, ended.stderr
    assert " ready " in ended.stderr
    assert "compiling" not in ended.stderr


def test_a_cache_that_cannot_be_written_is_survived(silent, tmp_path):
    arguments = ("--port", silent, "--no-wait", "--listen", str(tmp_path / "s"))
    ended = run("-c", UNCOMPILED, "run", "--estimator", "tilt", *arguments, cache=None, XDG_CACHE_HOME="/dev/null/x")
    assert ended.returncode == 69, ended.stderr
    assert "/dev/null/x/imud" in ended.stderr
    assert " ready " in ended.stderr
    assert "Traceback" not in ended.stderr


def test_warmup_needs_a_place():
    ended = run("-m", "imud", "warmup", "--estimator", "tilt", cache=None, XDG_CACHE_HOME="/dev/null/x")
    assert ended.returncode == 73
    assert "/dev/null/x" in ended.stderr


def test_a_child_fills_the_cache_and_its_failure_is_told(tmp_path, monkeypatch):
    from imud import compilation
    from imud.configuration.settings import Settings
    from imud.estimators import registry

    estimator = registry.by_name("tilt")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compilation, "warm_decoders", lambda: None)
    monkeypatch.setattr(compilation, "warm", lambda *_: Path(tmp_path, str(os.getpid())).touch())
    assert compilation.missing([estimator]) == [estimator]
    assert compilation.compile_apart([estimator], Settings())
    assert compilation.missing([estimator]) == []
    assert not (tmp_path / str(os.getpid())).exists()
    monkeypatch.setattr(compilation, "warm", lambda *_: os._exit(3))
    assert not compilation.compile_apart([estimator], Settings())
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert not compilation.compile_apart([estimator], Settings())
    assert compilation.missing([estimator]) == [estimator]
