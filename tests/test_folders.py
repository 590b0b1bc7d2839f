"""Where our files lie, also for a service whose user has no home."""

from pathlib import Path

import pytest

from imud import folders
from imud.compile import numba_cache


@pytest.fixture
def nobody(monkeypatch):
    """A user that no database knows, as systemd's DynamicUser with PrivateUsers."""
    for name in ("HOME", "XDG_CACHE_HOME", "XDG_STATE_HOME", "CACHE_DIRECTORY", "STATE_DIRECTORY", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", lambda uid: (_ for _ in ()).throw(KeyError(uid)))


def test_without_a_home_there_is_the_services_folder_or_none(nobody, monkeypatch):
    assert folders.folders_for("state") == []
    assert numba_cache.candidates() == []
    monkeypatch.setenv("CACHE_DIRECTORY", "/var/cache/imud:/var/cache/other")
    assert folders.folders_for("cache") == [Path("/var/cache/imud")]


def test_the_users_own(monkeypatch):
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", "/home/somebody")
    monkeypatch.setenv("XDG_STATE_HOME", "/elsewhere")
    assert folders.folders_for("cache") == [Path("/home/somebody/.cache/imud")]
    assert folders.folders_for("state") == [Path("/elsewhere/imud")]


def test_a_file_is_replaced_as_a_whole_and_nothing_is_left_beside_it(tmp_path):
    path = tmp_path / "new" / "state"
    for content in (b"first", b"second"):
        folders.replace_file(path, content)
        assert path.read_bytes() == content
    assert [other.name for other in path.parent.iterdir()] == ["state"]
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_file_that_cannot_be_written_stays_as_it_was(tmp_path):
    (tmp_path / "file").write_bytes(b"old")
    with pytest.raises(OSError, match="file"):
        folders.replace_file(tmp_path / "file" / "state", b"new")
    assert (tmp_path / "file").read_bytes() == b"old"
