"""Where compiled kernels are kept: never stale, never for ever, and not at all where nothing can be written."""

import os
import shutil
import time

import pytest

from imud.compile import numba_cache


@pytest.fixture
def sources(tmp_path):
    for room in ("imud/math", "drivers"):
        (tmp_path / room).mkdir(parents=True)
        (tmp_path / room / "a.py").write_text("RATE = 7.292115e-5\n")
    (tmp_path / "imud" / "drivers").symlink_to("../drivers")
    return tmp_path


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A machine where no cache directory has been chosen yet."""
    for variable in ("NUMBA_CACHE_DIR", "CACHE_DIRECTORY"):
        monkeypatch.setenv(variable, "")  # so that monkeypatch restores it, whatever `prepare` does
        monkeypatch.delenv(variable)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def test_the_digest_notices_a_constant_in_another_file(sources):
    before = numba_cache.source_digest(sources)
    assert numba_cache.source_digest(sources) == before
    (sources / "drivers" / "a.py").write_text("RATE = 7.292116e-5\n")
    assert numba_cache.source_digest(sources) != before


def test_the_digest_notices_a_new_and_a_renamed_file(sources):
    digests = [numba_cache.source_digest(sources)]
    (sources / "imud" / "b.py").write_text("")
    digests.append(numba_cache.source_digest(sources))
    (sources / "imud" / "b.py").rename(sources / "imud" / "c.py")
    digests.append(numba_cache.source_digest(sources))
    assert len(set(digests)) == 3


@pytest.mark.parametrize("library", ["numba", "llvmlite", "numpy"])
def test_the_digest_notices_another_library(sources, monkeypatch, library):
    before = numba_cache.source_digest(sources)
    version = numba_cache.importlib.metadata.version
    monkeypatch.setattr(numba_cache.importlib.metadata, "version", lambda name: version(name) + "x" * (name == library))
    assert numba_cache.source_digest(sources) != before


def test_the_digest_notices_another_python_and_another_processor(sources, monkeypatch):
    digests = {numba_cache.source_digest(sources)}
    monkeypatch.setattr(numba_cache.sys, "version", "3.99")
    digests.add(numba_cache.source_digest(sources))
    monkeypatch.setattr(numba_cache, "_processor", lambda: "CPU part: 0xd0b")
    digests.add(numba_cache.source_digest(sources))
    monkeypatch.setenv("NUMBA_OPT", "1")
    digests.add(numba_cache.source_digest(sources))
    assert len(digests) == 4


def test_the_processor_is_identified_by_constant_properties():
    described = numba_cache._processor()
    assert described
    assert "MHz" not in described
    assert described == numba_cache._processor()


def test_the_first_writable_folder_is_used(home, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", "/dev/null/imud")
    assert numba_cache.prepare() == home / "cache" / "imud" / f"numba-{numba_cache.source_digest()}"
    assert os.environ["NUMBA_CACHE_DIR"] == str(numba_cache.prepare())


def test_a_service_has_its_own(home, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", f"{home}/service:{home}/other")
    assert numba_cache.prepare().parent == home / "service"


def test_stale_code_is_detected_in_a_folder_that_the_user_names_too(home, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(home / "mine"))
    assert numba_cache.prepare() == home / "mine" / f"numba-{numba_cache.source_digest()}"
    assert numba_cache.prepare() == home / "mine" / f"numba-{numba_cache.source_digest()}"


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "NUMBA_CACHE_DIR"])
def test_without_a_writable_folder_nothing_is_cached(home, monkeypatch, variable):
    monkeypatch.setenv(variable, "/dev/null/x")
    assert numba_cache.prepare() is None
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_a_full_disk_is_not_writable(home, monkeypatch):
    full = shutil._ntuple_diskusage(10**9, 10**9, 0)
    monkeypatch.setattr(numba_cache.shutil, "disk_usage", lambda path: full)
    assert numba_cache.prepare() is None


def test_digests_that_nobody_used_for_weeks_are_removed(home):
    base = home / "cache" / "imud"
    days = {"numba-old": 30, "numba-recent": 3, "other": 30}
    for name, age in days.items():
        (base / name / "sub").mkdir(parents=True)
        (base / name / "sub" / "kernel.nbc").write_text("")
        os.utime(base / name, (time.time() - 86400 * age,) * 2)
    mine = numba_cache.prepare()
    assert sorted(path.name for path in base.iterdir()) == sorted([mine.name, "numba-recent", "other"])


def test_what_is_used_stays(home, monkeypatch):
    mine = numba_cache.prepare()
    os.utime(mine, (0, 0))
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert numba_cache.prepare() == mine
    assert mine.stat().st_mtime > time.time() - 3600
