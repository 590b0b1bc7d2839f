"""Do a release's wheels run where they are for? `python tests/release_roots.py WHEELS ROOTS [ARCH..]` tries it.

For each architecture a small Debian 13 is made in ROOTS, unless it is there, from the packages that debootstrap
fetches: they are unpacked, but not configured, which would take half an hour under qemu. Programs of other processors
run under qemu-user (packages `debootstrap`, `qemu-user-static`). The wheel is installed there, golden traces are
computed and compared with those of the repository, and `imud demo` drives. Needs root, and a network for Debian's
packages. Exit 1 if something fails.
"""

import argparse
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
WHEELS = {"amd64": "x86_64", "arm64": "aarch64", "armhf": "armv7l"}  # Debian's name -> that of the wheel
MIRROR = "http://deb.debian.org/debian"
PACKAGES = (  # what the wheel needs, but not numba; what the goldens need
    *("python3-numpy", "python3-msgspec", "python3-serial", "python3-structlog"),
    "python3-scipy",
)
BINFMT = Path("/proc/sys/fs/binfmt_misc")
EMULATORS = {"arm64": "qemu-aarch64", "armhf": "qemu-arm"}  # as binfmt.d(5) knows them
TRACES = ("attitude-hand", "navigation-boat", "riss", "tilt", "suh-adaptive")  # and all whose names begin so
DEMO_S = 15
PYTHON = "3.13"  # Debian 13's


def run(command: list[str], log: Path) -> None:
    """Run a command, its output in the log. Raises CalledProcessError."""
    with log.open("a") as file:
        print(f"+ {shlex.join(command)}", file=file, flush=True)
        subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, check=True)


def inside(root: Path, script: str, log: Path) -> None:
    """Run a shell script within a root, with /proc and /dev for that time only. Raises CalledProcessError."""
    clean = ["env", "-i", "HOME=/root", "PATH=/usr/bin:/bin:/usr/sbin:/sbin", "PYTHONPATH=/opt/imud"]
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


def make_root(architecture: str, root: Path, log: Path) -> None:
    """A Debian 13 with what the wheel needs of it. Raises CalledProcessError."""
    made = root / "made"
    if made.exists():
        return
    shutil.rmtree(root, ignore_errors=True)
    packages = ",".join(PACKAGES)
    fetch = ["debootstrap", "--variant=minbase", "--download-only", f"--arch={architecture}", f"--include={packages}"]
    run([*fetch, "trixie", str(root), MIRROR], log)
    for package in sorted((root / "var/cache/apt/archives").glob("*.deb")):
        unpack = f"dpkg-deb --fsys-tarfile {shlex.quote(str(package))} | tar -x --keep-directory-symlink -C {root}"
        run(["sh", "-ec", unpack], log)
    for library in (*root.glob("usr/lib/*/blas/*.so.3"), *root.glob("usr/lib/*/lapack/*.so.3")):
        link = library.parents[1] / library.name
        link.unlink(missing_ok=True)
        link.symlink_to(f"{library.parent.name}/{library.name}")  # as their configuration would
    made.touch()


def install(wheel: Path, root: Path, log: Path) -> None:
    """The wheel in /opt/imud, by this machine's pip, and the tests in /opt/tests. Raises CalledProcessError."""
    for folder in ("imud", "tests"):
        shutil.rmtree(root / "opt" / folder, ignore_errors=True)
    shutil.copytree(HERE, root / "opt/tests", ignore=shutil.ignore_patterns("__pycache__", "corpus"))
    platform = wheel.stem.rpartition("-")[2]
    there = ["--platform", platform, "--python-version", PYTHON, "--only-binary=:all:", "--target", f"{root}/opt/imud"]
    run([sys.executable, "-m", "pip", "install", "-q", "--no-deps", *there, str(wheel)], log)


def check(architecture: str, wheels: Path, root: Path) -> bool:
    """Whether all of it went well; says what did not."""
    log = root.with_suffix(".log")
    log.write_text("")
    begin = time.monotonic()
    steps = {
        "kernels": "python3 -c 'from imud.compile import library; assert library.current(), 1'",
        "goldens": f"cd /opt/tests && python3 golden.py --check {' '.join(TRACES)}",
        "demo": f"python3 -m imud demo --seconds {DEMO_S}",
    }
    done = "root"
    try:
        (wheel,) = wheels.glob(f"imud-*-manylinux_*_{WHEELS[architecture]}.whl")
        register(architecture, log)
        make_root(architecture, root, log)
        done = "installation"
        install(wheel, root, log)
        for done, script in steps.items():  # noqa: B007
            inside(root, script, log)
    except (subprocess.CalledProcessError, OSError, ValueError) as error:
        print(f"{architecture}: {done} FAILED: {error}; see {log}", flush=True)
        return False
    print(f"{architecture}: {wheel.name}: goldens and demo, {time.monotonic() - begin:.0f} s; see {log}", flush=True)
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], allow_abbrev=False)
    parser.add_argument("wheels", type=Path, help="folder with the wheels of `release.py --machines`")
    parser.add_argument("roots", type=Path, help="folder for the roots; they are kept")
    parser.add_argument("architectures", nargs="*", metavar="ARCH", help=f"of {', '.join(WHEELS)} (default: all)")
    arguments = parser.parse_args()
    wanted = arguments.architectures or list(WHEELS)
    if unknown := set(wanted) - set(WHEELS):
        parser.error(f"there is no {', '.join(unknown)}")
    roots = arguments.roots.resolve()
    roots.mkdir(parents=True, exist_ok=True)
    good = [check(each, arguments.wheels, roots / each) for each in wanted]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
