"""Small Debian roots of other processors, whose programs run under qemu-user.

They are made from the packages that debootstrap fetches: unpacked, but not configured, which would take half an hour
under qemu. Needs root, the packages `debootstrap` and `qemu-user-static`, and a network for Debian's packages.
In forky, 32-bit programs open terminals by calls that qemu-user 7.2 (Debian 12) does not know; 11.1 does.
"""

import shlex
import shutil
import subprocess
from pathlib import Path

MIRROR = "http://deb.debian.org/debian"
PACKAGES = (  # what the wheel needs, but not numba; what the goldens need
    *("python3-numpy", "python3-msgspec", "python3-serial"),
    "python3-scipy",
)
BINFMT = Path("/proc/sys/fs/binfmt_misc")
EMULATORS = {"arm64": "qemu-aarch64", "armhf": "qemu-arm"}  # as binfmt.d(5) knows them
# Debian's arm64 programs sign their return addresses where the processor can. A Cortex-A72, a Raspberry Pi 4's, cannot;
# qemu's own model can, and then Python takes eleven times as long.
PROCESSORS = {"arm64": "cortex-a72"}
SUITE = "trixie"  # Debian 13


def run(command: list[str], log: Path) -> None:
    """Run a command, its output in the log. Raises CalledProcessError."""
    with log.open("a") as file:
        print(f"+ {shlex.join(command)}", file=file, flush=True)
        subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, check=True)


def inside(architecture: str, root: Path, script: str, log: Path) -> None:
    """Run a shell script within a root, with /proc and /dev for that time only. Raises CalledProcessError."""
    clean = ["env", "-i", "HOME=/root", "PATH=/usr/bin:/bin:/usr/sbin:/sbin", "PYTHONPATH=/opt/imud"]
    if architecture in PROCESSORS:
        clean.append(f"QEMU_CPU={PROCESSORS[architecture]}")
    mounts = f"mount -t proc proc {root}/proc && mount --rbind /dev {root}/dev"
    chroot = shlex.join([*clean, "chroot", str(root), "sh", "-euc", script])
    run(["unshare", "--mount", "sh", "-euc", f"{mounts} && {chroot}"], log)


def register(architecture: str, log: Path) -> None:
    """Have the kernel run this architecture's programs under qemu, if systemd did not do so at the start."""
    if architecture not in EMULATORS:
        return
    if not (BINFMT / "register").exists():
        run(["mount", "-t", "binfmt_misc", "binfmt_misc", str(BINFMT)], log)
    if not (BINFMT / EMULATORS[architecture]).exists():
        line = Path(f"/usr/lib/binfmt.d/{EMULATORS[architecture]}.conf").read_text().strip()
        (BINFMT / "register").write_text(line)


def python_of(root: Path) -> str:
    """Version of the Python in a root, as pip wants it."""
    return (root / "usr/bin/python3").readlink().name.removeprefix("python")


def make_root(architecture: str, root: Path, log: Path, suite: str = SUITE) -> None:
    """A Debian with what the wheel needs of it. Raises CalledProcessError."""
    made = root / "made"
    if made.exists():
        return
    shutil.rmtree(root, ignore_errors=True)
    packages = ",".join(PACKAGES)
    fetch = ["debootstrap", "--variant=minbase", "--download-only", f"--arch={architecture}", f"--include={packages}"]
    run([*fetch, suite, str(root), MIRROR, "sid"], log)  # sid: the script, which is every suite's
    for package in sorted((root / "var/cache/apt/archives").glob("*.deb")):
        unpack = f"dpkg-deb --fsys-tarfile {shlex.quote(str(package))} | tar -x --keep-directory-symlink -C {root}"
        run(["sh", "-ec", unpack], log)
    for library in (*root.glob("usr/lib/*/blas/*.so.3"), *root.glob("usr/lib/*/lapack/*.so.3")):
        link = library.parents[1] / library.name
        link.unlink(missing_ok=True)
        link.symlink_to(f"{library.parent.name}/{library.name}")  # as their configuration would
    made.touch()
