"""What a release is checked for: `python tests/release.py FOLDER` writes wheel and parts list there, and checks both.

The wheel is built twice, in two folders, and must be the same bytes. The parts list is CycloneDX 1.5: imud and every
package that it needs, as they are installed here, with version and licence. pip-audit, where it is installed, looks
for known vulnerabilities in them.

--machines also makes the wheels of other machines, with `ziglang`, and has their processors' bits compared under qemu
(`other_machines.py`). That takes some minutes; `release_roots.py FOLDER ROOTS` then tries the wheels in Debian.
"""

import argparse
import contextlib
import email
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
MACHINES = (  # as zig names them; the version is the oldest glibc
    *("x86_64-linux-gnu.2.28", "aarch64-linux-gnu.2.28", "arm-linux-gnueabihf.2.31"),
    *("x86_64-linux-musl", "aarch64-linux-musl", "arm-linux-musleabihf"),
)
_NAME = re.compile(r"[A-Za-z0-9._-]+")


def copied(folder: Path) -> Path:
    """The files under version control as they are in the working tree, in a folder of their own."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.split(b"\0")
    for name in filter(None, map(bytes.decode, names)):
        if (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    return folder


def wheel(into: Path, machine: str | None = None) -> Path:
    """Build the wheel from a copy of the sources, for this machine or another; returns its path."""
    environment = {**os.environ, **({"IMUD_TARGET": machine} if machine else {})}
    with tempfile.TemporaryDirectory() as folder:
        source = copied(Path(folder) / "imud")
        made = Path(folder) / "made"
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(made)]
        subprocess.run(command, cwd=source, check=True, stdout=subprocess.DEVNULL, env=environment)
        (built,) = made.glob("*.whl")
        return Path(shutil.copy(built, into))


def library_of(built: Path) -> str:
    """What the compiled library in a wheel is, as an ELF header says it; "none" if the compiler failed."""
    with zipfile.ZipFile(built) as archive:
        if "imud/compile/kernels.so" not in archive.namelist():
            return "none"
        header = archive.read("imud/compile/kernels.so")[:20]
    kinds = {62: "x86-64", 183: "aarch64", 40: "arm"}  # elf(5), e_machine
    return kinds.get(int.from_bytes(header[18:20], "little"), "unknown")


def add_needed(requirements: list[str], found: dict[str, importlib.metadata.Distribution]) -> None:
    """Add the installed packages that these lines require, and what those require; extras are not required."""
    for requirement in requirements:
        match = _NAME.match(requirement)
        if match is None or "extra ==" in requirement:
            continue
        key = match[0].lower().replace("_", "-")
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # for other platforms
            if key not in found:
                found[key] = importlib.metadata.distribution(match[0])
                add_needed(found[key].requires or [], found)


def part(name: str, version: str, licence: str) -> dict[str, object]:
    """One component of the parts list."""
    purl = f"pkg:pypi/{name}@{version}"
    return {
        "type": "library", "name": name, "version": version, "purl": purl, "licenses": [{"license": {"name": licence}}]
    }  # fmt: skip


def parts_list(built: Path) -> dict[str, object]:
    """The software bill of materials of a wheel."""
    with zipfile.ZipFile(built) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        own = email.message_from_bytes(archive.read(name))
    found: dict[str, importlib.metadata.Distribution] = {}
    add_needed(own.get_all("Requires-Dist", []), found)
    parts = [part("imud", own["Version"], own["License-Expression"])]
    for key, distribution in sorted(found.items()):
        meta = distribution.metadata
        licence = meta.get("License-Expression") or (meta.get("License") or "see the package").splitlines()[0]
        parts.append(part(key, distribution.version, licence))
    return {"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1, "components": parts}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], allow_abbrev=False)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--machines", action="store_true", help="also wheels for other machines; compare their bits")
    arguments = parser.parse_args()
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as again:
        built, second = wheel(folder), wheel(Path(again))
        digests = {hashlib.sha256(each.read_bytes()).hexdigest() for each in (built, second)}
    print(f"{built.name}: {'the same bytes twice' if len(digests) == 1 else 'DIFFERS'}, sha256 {sorted(digests)}")
    parts = parts_list(built)
    (folder / "imud.cdx.json").write_text(json.dumps(parts, indent=1))
    print(f"parts list: {len(parts['components'])} packages")  # type: ignore[arg-type]
    audited = audit(parts)
    different = arguments.machines and not other_machines(folder)
    return 1 if len(digests) > 1 or audited or different else 0


def audit(parts: dict[str, object]) -> int:
    """Have pip-audit look for vulnerabilities in the parts; not 0 if there are some, or one could not be looked up."""
    if not importlib.util.find_spec("pip_audit"):
        print("NOT audited: pip install pip-audit")
        return 1
    _, *others = parts["components"]  # type: ignore[misc, attr-defined]
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as needed:
        needed.write("".join(f"{each['name']}=={each['version']}\n" for each in others))
        needed.flush()
        command = [sys.executable, "-m", "pip_audit", "-r", needed.name, "--no-deps", "--disable-pip", "--strict"]
        failed = subprocess.run(command, check=False).returncode
    if failed:
        print("NOT audited, or vulnerable: see above; it needs PyPI's JSON, which a mirror may not have")
    return failed


def other_machines(folder: Path) -> bool:
    """Write the wheels of other machines; returns whether all have their library and their processors our bits."""
    if not importlib.util.find_spec("ziglang"):
        print("NO wheels of other machines: pip install ziglang")
        return False
    complete = True
    for machine in MACHINES:
        built = wheel(folder, machine)
        kind = library_of(built)
        complete &= kind.startswith(machine[:3])
        print(f"{built.name}: library for {kind}", flush=True)
    return subprocess.run([sys.executable, ROOT / "tests/other_machines.py"], check=False).returncode == 0 and complete


if __name__ == "__main__":
    sys.exit(main())
