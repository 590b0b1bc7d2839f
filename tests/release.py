"""What a release is checked for: `python tests/release.py FOLDER` writes wheel and parts list there, and checks both.

The wheel is built twice, in two folders, and must be the same bytes. The parts list (`parts_list.py`) must be valid
CycloneDX, which the package `cyclonedx-python-lib[json-validation]` says, and the packages in it have no known
vulnerabilities, which `pip-audit` says.

--machines also makes the wheels of other machines, with `ziglang`, and has their processors' bits compared under qemu
(`other_machines.py`). That takes some minutes; `release_roots.py FOLDER ROOTS` then tries the wheels in Debian.
"""

import argparse
import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
MACHINES = (  # as zig names them; the version is the oldest glibc
    *("x86_64-linux-gnu.2.28", "aarch64-linux-gnu.2.28", "arm-linux-gnueabihf.2.31"),
    *("x86_64-linux-musl", "aarch64-linux-musl", "arm-linux-musleabihf"),
)


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


def main() -> int:
    from parts_list import defect, parts_list  # needs packages; other scripts import this module without them

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
    found = defect(parts)
    print(f"parts list: {len(parts['components'])} packages, {'valid' if found is None else f'NOT VALID: {found}'}")
    audited = audit(parts)
    different = arguments.machines and not other_machines(folder)
    return 1 if len(digests) > 1 or found or audited or different else 0


def audit(parts: dict[str, Any]) -> int:
    """Have pip-audit look for vulnerabilities in the parts that are installed; not 0 if there are some, or one could
    not be looked up.
    """
    if not importlib.util.find_spec("pip_audit"):
        print("NOT audited: pip install pip-audit")
        return 1
    installed = [part for part in parts["components"] if "version" in part]
    absent = [part["name"] for part in parts["components"] if part not in installed]
    print(f"not installed here, so not audited: {', '.join(absent) or 'none'}")
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as needed:
        needed.write("".join(f"{part['name']}=={part['version']}\n" for part in installed))
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
