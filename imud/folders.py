"""Folders for our files: the service manager's first, then the user's own, named by the XDG rules."""

import contextlib
import os
from pathlib import Path

_OWN = {"cache": ".cache", "state": ".local/state"}
_XDG = {"cache": "XDG_CACHE_HOME", "state": "XDG_STATE_HOME", "runtime": "XDG_RUNTIME_DIR"}


def folders_for(kind: str) -> list[Path]:
    """Folders for "cache", "state" or "runtime" (gone at the next boot), in order of preference; may be none.

    A service's user may have no home, and only a session or a service has a runtime folder.
    """
    found = []
    if service := os.environ.get(f"{kind.upper()}_DIRECTORY"):  # systemd.exec(5)
        found.append(Path(service.split(":")[0]))
    if named := os.environ.get(_XDG[kind]):
        found.append(Path(named) / "imud")
    elif kind in _OWN:
        with contextlib.suppress(RuntimeError):  # there is no home
            found.append(Path.home() / _OWN[kind] / "imud")
    return found


def replace_file(path: Path, content: bytes) -> None:
    """Write a file as a whole, in a folder that is made if need be; only the user may read it. Raises OSError."""
    if not path.parent.is_dir():
        path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f".{path.name}-{os.getpid()}")
    with open(new, "wb", opener=lambda name, flags: os.open(name, flags, 0o600)) as file:
        file.write(content)
    new.replace(path)


def save_in(folders: list[Path], name: str, content: bytes) -> None:
    """`replace_file` in the first of the folders that may be written. Raises OSError if there is none."""
    refused = OSError("there is no folder for state")
    for folder in folders:
        try:
            replace_file(folder / name, content)
            return
        except OSError as error:
            refused = error
    raise refused


def boot_id() -> str:
    """Of the machine, another one after each boot."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
