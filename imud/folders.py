"""Folders for our files: the service manager's first, then the user's own, named by the XDG rules."""

import contextlib
import os
from pathlib import Path

_OWN = {"cache": ".cache", "state": ".local/state"}


def places(kind: str) -> list[Path]:
    """Folders for "cache" or "state", in order of preference; may be none, as a service's user may have no home."""
    found = []
    if service := os.environ.get(f"{kind.upper()}_DIRECTORY"):  # systemd.exec(5)
        found.append(Path(service.split(":")[0]))
    if named := os.environ.get(f"XDG_{kind.upper()}_HOME"):
        found.append(Path(named) / "imud")
    else:
        with contextlib.suppress(RuntimeError):  # nobody knows a home
            found.append(Path.home() / _OWN[kind] / "imud")
    return found
