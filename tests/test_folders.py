"""Where our files lie, also for a service whose user has no home."""

import errno
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from imud import folders
from imud.compile import numba_cache
from imud.daemon.checkpoint_file import CheckpointFiles
from imud.errors import ImudError
from imud.sensor_errors import calibration, stored_biases
from imud.sensor_errors.profiles import PROFILES


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


@pytest.mark.parametrize(("flags", "says"), [(os.ST_RDONLY, "is read-only"), (0, "no permission")])
def test_a_folder_that_cannot_be_written_to_says_whether_its_file_system_is_read_only(
    flags, says, tmp_path, monkeypatch
):
    assert folders.forbids_writing(tmp_path) == ""
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(os, "statvfs", lambda _: SimpleNamespace(f_flag=flags))
    assert says in folders.forbids_writing(tmp_path) and str(tmp_path) in folders.forbids_writing(tmp_path)


def test_a_full_disk_is_named(tmp_path):
    def write(path, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match=f"No space left on device: '{tmp_path}/b'"):
        folders.save_in([tmp_path / "a", tmp_path / "b"], b"", write)


@pytest.mark.parametrize("write", [folders.replace_file, folders.overwrite_file])
def test_a_file_gets_a_new_content_and_nothing_is_left_beside_it(write, tmp_path):
    path = tmp_path / "new" / "state"
    for content in (b"first", b"the second", b"third"):
        write(path, content)
        assert path.read_bytes() == content
    assert [other.name for other in path.parent.iterdir()] == ["state"]
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_file_that_cannot_be_written_stays_as_it_was(tmp_path):
    (tmp_path / "file").write_bytes(b"old")
    with pytest.raises(OSError, match="file"):
        folders.replace_file(tmp_path / "file" / "state", b"new")
    assert (tmp_path / "file").read_bytes() == b"old"


def test_nothing_is_left_beside_a_file_that_cannot_be_replaced(tmp_path):
    (tmp_path / "state").mkdir()
    with pytest.raises(IsADirectoryError):
        folders.replace_file(tmp_path / "state", b"new")
    assert [other.name for other in tmp_path.iterdir()] == ["state"]


ODD = {
    "a pipe that nobody writes to": os.mkfifo,
    "a device without an end": lambda path: path.symlink_to("/dev/zero"),
    "a folder": Path.mkdir,
    "a link to itself": lambda path: path.symlink_to(path),
    "larger than the memory": lambda path: (path.touch(), os.truncate(path, 1 << 40)),
    "nested deeply": lambda path: path.write_text("a = " + "[" * 100_000),
}


@pytest.mark.parametrize("odd", [odd for odd in ODD if odd != "a folder"])
def test_whatever_else_lies_in_the_place_of_a_file_is_replaced(odd, tmp_path):
    path = tmp_path / "state"
    ODD[odd](path)
    folders.overwrite_file(path, b"new")
    assert path.is_file() and not path.is_symlink() and path.read_bytes() == b"new"


@pytest.mark.parametrize("odd", ODD)
def test_whatever_lies_in_the_place_of_the_daemons_files_it_starts_without_them(odd, tmp_path, monkeypatch):
    for kind in ("state", "runtime"):
        monkeypatch.setenv(f"{kind.upper()}_DIRECTORY", str(tmp_path))
        monkeypatch.delenv(f"XDG_{kind.upper()}_HOME", raising=False)
    for name in (*CheckpointFiles("S", "P").names, stored_biases._name("S"), calibration._name("S")):
        ODD[odd](tmp_path / name)
    assert CheckpointFiles("S", "P").take(10**9) == b""
    nothing = calibration.correction(calibration.Calibration(""), (0.0, 0.0, 0.0))
    assert stored_biases.load("S", nothing, 0, PROFILES["m-g350"]) is None
    with pytest.raises(ImudError, match="calibration-S"):  # reported by the daemon: it is not used
        calibration.load("S", [tmp_path])


def test_what_has_another_name_keeps_its_content_there(tmp_path):
    (tmp_path / "other").write_bytes(b"old")
    os.link(tmp_path / "other", tmp_path / "state")
    folders.overwrite_file(tmp_path / "state", b"new")
    assert (tmp_path / "state").read_bytes() == b"new"
    assert (tmp_path / "other").read_bytes() == b"old"
