"""The last line of a shared library with kernels: the digests of its sources and of its code."""

import functools
import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from .hashing import digest_of
from .levels import of_processor

ROOT = Path(__file__).resolve().parents[2]
OTHER_SOURCES = "is of other sources"
PACKAGE = "imud"  # our sources: `imud/drivers` is a link in a checkout, a folder where it is installed


def digests(files: Iterable[str], root: Path = ROOT) -> dict[str, str]:
    """Digest of each of these files of the sources, by its name. Raises OSError if one is not there."""
    return {name: digest_of((root / name).read_bytes()) for name in files}


def all_sources(root: Path = ROOT) -> list[str]:
    """The files of the sources that there are."""
    folders = os.walk(root / PACKAGE, followlinks=True)
    return [
        os.path.relpath(f"{folder}/{file}", root)
        for folder, _, files in folders
        for file in files
        if file.endswith(".py")
    ]


def _together(sources: Mapping[str, str]) -> str:
    """One digest of names and contents."""
    return digest_of(*(f"{name}\0{digest}\n".encode() for name, digest in sources.items()))


def drivers(root: Path = ROOT) -> set[str]:
    """The modules of the drivers that there are: a new one's kernels are in no library that was made before."""
    return {path.relative_to(root).as_posix() for path in (root / PACKAGE / "drivers").glob("*/driver.py")}


def processor(program: bytes | memoryview) -> bytes:
    """The kind of processor that an ELF file is for: its class, byte order and machine (elf(5)).

    The name of the running kernel does not show it: it may be of 64 bits and this program of 32.
    """
    return bytes(program[4:6]) + bytes(program[18:20])


@functools.cache
def _this_program() -> bytes:
    with Path("/proc/self/exe").open("rb") as file:
        return file.read(20)


def defect(library: Path) -> str | None:
    """Why a library must not be loaded; None: it may."""
    try:
        content = library.read_bytes()
        end = content.rfind(b"\n")
        code, seal = memoryview(content)[:end], json.loads(content[end + 1 :])
        if seal["code"] != digest_of(code):
            return "is damaged"
        if processor(code) != processor(_this_program()):
            return "is for another processor"
        if not set(seal["levels"]).intersection(of_processor()):
            return "is for processors with AVX2"
        is_of_these = seal["sources"] == _together(digests(seal["files"])) and drivers() <= set(seal["files"])
        return None if is_of_these else OTHER_SOURCES
    except FileNotFoundError:
        return "does not exist, or is of sources that do not"
    except OSError as error:
        return str(error)
    except (ValueError, KeyError, TypeError):
        return "is damaged"


def loaded_sources() -> list[str]:
    """The source files of ours that this process has loaded: whatever the kernels depend on is among them."""
    folder = f"{ROOT / PACKAGE}{os.sep}"
    files = (getattr(module, "__file__", None) for module in list(sys.modules.values()))
    return sorted({Path(f).relative_to(ROOT).as_posix() for f in files if f and f.startswith(folder)})


def seal(library: Path, sources: Mapping[str, str], levels: Sequence[str]) -> None:
    """Append the line with the digests of a library's sources and code. sources: `digests` of those it was made of.

    levels: of processors, for which it has kernels.
    """
    code = library.read_bytes()
    line = {"code": digest_of(code), "sources": _together(sources), "files": list(sources), "levels": list(levels)}
    with library.open("ab") as file:
        file.write(b"\n" + json.dumps(line).encode())
