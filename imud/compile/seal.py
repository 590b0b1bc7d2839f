"""The last line of a shared library with kernels: the digests of its sources and of its code, and its machine."""

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from .hashing import digest_of

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "imud"  # our sources: `imud/drivers` is a link in a checkout, a folder where it is installed


def digest(files: Sequence[str], root: Path = ROOT) -> str:
    """Digest of these files of the sources, names and contents. Raises OSError if one is not there."""
    contents = [(name, (root / name).read_bytes()) for name in files]
    return digest_of(*(f"{name}\0{len(content)}\0".encode() + content for name, content in contents))


def defect(library: Path) -> str | None:
    """Why a library must not be loaded; None: it may."""
    try:
        code, _, line = library.read_bytes().rpartition(b"\n")
        seal = json.loads(line)
        if seal["code"] != digest_of(code):
            return "is damaged"
        if seal["machine"] != os.uname().machine:
            return f"is for {seal['machine']}"
        return None if seal["sources"] == digest(seal["files"]) else "is of other sources"
    except FileNotFoundError:
        return "does not exist, or is of sources that do not"
    except OSError as error:
        return str(error)
    except (ValueError, KeyError, TypeError):
        return "is damaged"


def loaded_sources(root: Path = ROOT) -> list[str]:
    """The source files of ours that this process has loaded: whatever the kernels depend on is among them."""
    folder = f"{root / PACKAGE}{os.sep}"
    files = (getattr(module, "__file__", None) for module in list(sys.modules.values()))
    return sorted({Path(f).relative_to(root).as_posix() for f in files if f and f.startswith(folder)})


def seal(library: Path, files: Sequence[str]) -> None:
    """Append the line with the digests of a library's sources and code."""
    code = library.read_bytes()
    line = {"machine": os.uname().machine, "code": digest_of(code), "sources": digest(files), "files": list(files)}
    with library.open("ab") as file:
        file.write(b"\n" + json.dumps(line).encode())
