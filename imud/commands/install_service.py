"""`imud install-service`: unit, groups, udev rules, man pages, configuration: listed first, then installed.

The steps are printed before anything is changed; the same list is then executed.
"""

import argparse
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError, ImudError, InputMissingError, PermissionDeniedError, UsageError
from ..setup import config
from .reference import man_command, man_configuration, sample

_UNIT_PROGRAM = "/opt/imud/bin/imud"  # the command in the unit in systemd/
_FILES = {  # file in systemd/ -> file of the system
    "imud@.service": "etc/systemd/system/imud@.service",
    "sysusers.conf": "etc/sysusers.d/imud.conf",
    "60-imud.rules": "etc/udev/rules.d/60-imud.rules",
}
_REALTIME = {"realtime.conf": "etc/systemd/system/imud@.service.d/realtime.conf"}
_PAGES = {
    "usr/local/share/man/man1/imud.1": man_command,
    "usr/local/share/man/man5/imud.toml.5": man_configuration,
}


@dataclass(frozen=True)
class Write:
    """A file to be written. An existing file is not overwritten if `keep` is set, because the user edits it."""

    path: Path
    text: str
    keep: bool = False

    def __str__(self) -> str:
        state = "keep" if self.keep and self.path.exists() else "same" if self._is_current() else "write"
        return f"{state:6} {self.path}"

    def _is_current(self) -> bool:
        return self.path.is_file() and self.path.read_text(errors="replace") == self.text

    def execute(self) -> None:
        if (self.keep and self.path.exists()) or self._is_current():
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        new = self.path.with_name(self.path.name + ".new")
        new.write_text(self.text)
        new.chmod(0o644)
        new.replace(self.path)


@dataclass(frozen=True)
class Remove:
    """A file to be deleted."""

    path: Path

    def __str__(self) -> str:
        return f"remove {self.path}"

    def execute(self) -> None:
        self.path.unlink(missing_ok=True)


@dataclass(frozen=True)
class Run:
    """A command to run. One that only speeds things up (`optional`) may be missing or fail."""

    command: tuple[str, ...]
    optional: bool = False

    def __str__(self) -> str:
        return f"run    {shlex.join(self.command)}"

    def execute(self) -> None:
        if self.optional and shutil.which(self.command[0]) is None:
            return
        try:
            subprocess.run(self.command, check=not self.optional)
        except FileNotFoundError as error:
            raise InputMissingError(f"there is no {self.command[0]} on this machine: is systemd installed?") from error
        except subprocess.CalledProcessError as error:
            raise ImudError(f"`{shlex.join(self.command)}` failed with {error.returncode}; see above") from error


Step = Write | Remove | Run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", nargs="?", default="imu", help="of the instance: imud@NAME, /etc/imud/NAME.toml")
    parser.add_argument("--port", action="append", default=[], metavar="DEV[:DRIVER[@BAUD]]", help="as of `imud run`")
    parser.add_argument("--realtime", action="store_true", help="also allow real-time scheduling and locked memory")
    parser.add_argument("--remove", action="store_true", help="remove the service; configuration and state stay")
    parser.add_argument("--dry-run", action="store_true", help="only show what would be done")
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.add_argument("--root", type=Path, default=Path("/"), metavar="DIR", help="a mounted image: files only")


def run(args: argparse.Namespace) -> int:
    if not args.name.replace("-", "").replace("_", "").isalnum():
        raise UsageError(f"{args.name!r} is no name for a service: letters, digits, - and _")
    steps = removal(args.root, args.name) if args.remove else installation(args)
    for step in steps:
        print(step, flush=True)
    if args.dry_run or not (args.yes or _confirmed()):
        return 0
    try:
        for step in steps:
            step.execute()
    except PermissionError as error:
        raise PermissionDeniedError(f"{error.filename}: not permitted; try again with sudo") from error
    print(f"done: {_outcome(args)}")
    return 0


def _outcome(args: argparse.Namespace) -> str:
    """What is there now, and what is left to do."""
    if args.remove:
        return "the service is gone"
    unit = f"imud@{args.name}"
    if args.root != Path("/"):
        there = args.root / _UNIT_PROGRAM.lstrip("/")
        return f"these files only. The service starts {there}; `systemctl --root={args.root} enable {unit}` enables it"
    return f"systemctl status {unit}, journalctl -u {unit}"


def _confirmed() -> bool:
    if not sys.stdin.isatty():
        raise UsageError("there is no terminal to ask on: --yes executes the steps, --dry-run only prints them")
    return input("Do this? [y/N] ").strip().lower() in ("y", "yes")


def installation(args: argparse.Namespace) -> list[Step]:
    """The steps that make imud@NAME run now and after each boot. Raises ImudError if it could not work."""
    program = _program(args.root)
    files = _FILES | (_REALTIME if args.realtime else {})
    steps: list[Step] = [
        Write(args.root / target, _asset(name).replace(_UNIT_PROGRAM, str(program))) for name, target in files.items()
    ]
    steps += [Write(args.root / path, page()) for path, page in _PAGES.items()]
    configuration = args.root / "etc/imud" / f"{args.name}.toml"
    if not configuration.exists():
        if not args.port and args.root == Path("/"):
            raise UsageError("the service needs the sensor's port, as --port /dev/ttyUSB0: see `imud probe`")
        steps.append(Write(configuration, _checked_sample(args.port), keep=True))
    elif args.port:
        raise ConfigError(f"{configuration} is there already: change `ports` in it, and leave --port away")
    return steps + (_systemd_commands(args.name) if args.root == Path("/") else [])


def _systemd_commands(name: str) -> list[Step]:
    return [
        Run(("systemd-sysusers",)),
        Run(("udevadm", "control", "--reload"), optional=True),
        Run(("udevadm", "trigger", "--subsystem-match=tty"), optional=True),
        Run(("systemctl", "daemon-reload")),
        Run(("systemctl", "enable", f"imud@{name}")),
        Run(("systemctl", "restart", f"imud@{name}")),
    ]


def removal(root: Path, name: str) -> list[Step]:
    """Stop and disable imud@NAME; the shared files go with the last instance."""
    steps: list[Step] = (
        [Run(("systemctl", "disable", "--now", f"imud@{name}"), optional=True)] if root == Path("/") else []
    )
    wanted = root.glob("etc/systemd/system/*.wants/imud@*.service")
    if all(link.name == f"imud@{name}.service" for link in wanted):
        targets: Iterable[str] = (*_FILES.values(), *_REALTIME.values(), *_PAGES)
        steps += [Remove(root / target) for target in targets if (root / target).exists()]
    return steps + ([Run(("systemctl", "daemon-reload"))] if root == Path("/") else [])


def _program(root: Path) -> Path:
    """The command that the unit starts. Raises InputMissingError when the service's user could not read it."""
    program = Path(sys.executable).with_name("imud")
    if root != Path("/"):
        return Path(_UNIT_PROGRAM)
    if not program.exists():
        raise InputMissingError(f"there is no {program}: install imud with pip into this Python first")
    if program.is_relative_to("/home") or program.is_relative_to("/root"):
        raise InputMissingError(
            f"imud is installed in {program.parent}, which a service's own user may not read: in its sources\n"
            "  sudo python3 -m venv /opt/imud && sudo /opt/imud/bin/pip install .\n"
            "and run `sudo /opt/imud/bin/imud install-service`"
        )
    return program


def _asset(name: str) -> str:
    """A file of systemd/, from the installed package or from the checkout."""
    package = Path(__file__).parents[1]
    for folder in (package / "systemd", package.parent / "systemd"):
        if (folder / name).is_file():
            return (folder / name).read_text()
    raise InputMissingError(f"the installation lacks its file systemd/{name}: install imud again")


def _checked_sample(ports: list[str]) -> str:
    text = sample(ports)
    config.loads(text)  # the file must be valid
    return text
