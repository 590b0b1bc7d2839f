"""Do a release's wheels run where they are for? `python tests/release_roots.py WHEELS ROOTS [ARCH..]` tries it.

For each architecture a small Debian 13 is made in ROOTS by debootstrap, unless it is there; programs of other
processors run under qemu-user (packages `debootstrap`, `qemu-user-static`). The wheel is installed there, golden traces
are computed and compared with those of the repository, and `imud demo` drives. Needs root, and a network for Debian's
and Python's packages. Takes some 10 minutes for each architecture. Exit 1 if something fails.
"""

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
WHEELS = {"amd64": "x86_64", "arm64": "aarch64", "armhf": "armv7l"}  # Debian's name -> that of the wheel
MIRROR = "http://deb.debian.org/debian"
PACKAGES = ("ca-certificates", "python3-numpy", "python3-pip", "python3-scipy", "python3-serial", "python3-venv")
COMPILED = {"armhf": ("gcc", "libc6-dev", "python3-dev")}  # for msgspec, which has no wheel there
TRACES = ("navigation", "attitude", "riss", "tilt", "suh-adaptive")  # and all whose names begin so: most of them
DEMO_S = 15


def run(command: list[str], log: Path) -> None:
    """Run a command, its output in the log. Raises CalledProcessError."""
    with log.open("a") as file:
        print(f"+ {shlex.join(command)}", file=file, flush=True)
        subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, check=True)


def inside(root: Path, script: str, log: Path) -> None:
    """Run a shell script within a root, with /proc and /dev for that time only. Raises CalledProcessError."""
    kept = {name: text for name, text in os.environ.items() if name.startswith("PIP_") and "://" not in text}
    kept.pop("PIP_FIND_LINKS", None)  # a folder of this machine
    clean = ["env", "-i", "HOME=/root", "PATH=/usr/bin:/bin:/usr/sbin:/sbin", *(f"{k}={v}" for k, v in kept.items())]
    mounts = f"mount -t proc proc {root}/proc && mount --rbind /dev {root}/dev"
    chroot = shlex.join([*clean, "chroot", str(root), "sh", "-euc", script])
    run(["unshare", "--mount", "sh", "-euc", f"{mounts} && {chroot}"], log)


def make_root(architecture: str, root: Path, log: Path) -> None:
    """A Debian 13 with what the wheel needs of it. Raises CalledProcessError."""
    made = root / "made"
    if made.exists():
        return
    packages = ",".join([*PACKAGES, *COMPILED.get(architecture, ())])
    first = ["debootstrap", "--variant=minbase", "--foreign", f"--arch={architecture}", f"--include={packages}"]
    run([*first, "trixie", str(root), MIRROR], log)
    inside(root, "/debootstrap/debootstrap --second-stage", log)
    for file in ("/etc/resolv.conf", "/etc/ssl/certs/ca-certificates.crt"):
        shutil.copy(file, root / file.lstrip("/"))
    made.touch()


def install(wheel: Path, root: Path, log: Path) -> None:
    """The wheel in a fresh environment of the root, and what the tests' goldens need. Raises CalledProcessError."""
    shutil.copy(wheel, root / "tmp")
    shutil.rmtree(root / "opt" / "tests", ignore_errors=True)
    shutil.copytree(HERE, root / "opt" / "tests", ignore=shutil.ignore_patterns("__pycache__", "corpus"))
    environment = "rm -rf /opt/imud && python3 -m venv --system-site-packages /opt/imud"
    inside(root, f"{environment} && /opt/imud/bin/pip install -q msgspec structlog", log)
    inside(root, f"/opt/imud/bin/pip install -q --no-deps /tmp/{wheel.name}", log)  # it has no use for numba


def check(architecture: str, wheels: Path, root: Path) -> bool:
    """Whether all of it went well; says what did not."""
    log = root.with_suffix(".log")
    log.write_text("")
    begin = time.monotonic()
    steps = {
        "kernels": "/opt/imud/bin/python -c 'from imud.compile import library; assert library.current(), 1'",
        "goldens": f"cd /opt/tests && /opt/imud/bin/python golden.py --check {' '.join(TRACES)}",
        "demo": f"/opt/imud/bin/imud demo --seconds {DEMO_S}",
    }
    done = "root"
    try:
        (wheel,) = wheels.glob(f"imud-*-manylinux_*_{WHEELS[architecture]}.whl")
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
