"""The service under a real systemd: `python tests/systemd_in_container.py [--root FOLDER]`, as root, some two minutes.

A container (systemd-nspawn) boots a bare Debian, which debootstrap makes once. There `imud install-service` installs
the service for an emulated sensor, and the script tries what docs/service.md promises: start, status, reload, the
watchdog, restart after a crash, what is known soon after each restart, errors of configuration, stop, the rating of
the sandbox. Exit 3 if this machine can
have no such container.
"""

import argparse
import contextlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
PACKAGES = "systemd,systemd-sysv,dbus,python3,libpython3.11-stdlib"
UNIT, FILE, IMPOSSIBLE = "imud@front.service", "/etc/imud/front.toml", 3
SENSORS = "/run/sensor/imu", "/run/sensor/gnss"
RECORDING = "/var/lib/imud/drive.mcap"
EXPOSURE_MAX = 1.2
START_S, WATCHDOG_S = 120.0, 30.0
RECORDED_BYTES = 100_000  # of a file that grows: some seconds of the sensor
LASTED_S = 1.0  # so long after it became valid the log says so (`imud/daemon/change_logger.py`)
PROGRAM = "#!/opt/imud/bin/python\nimport sys\nfrom imud.__main__ import main\nsys.exit(main())\n"


class ImpossibleError(Exception):
    """This machine can have no such container."""


def make_root(root: Path) -> None:
    """A bare Debian in this folder, if it is not there yet. Raises ImpossibleError."""
    if (root / "usr/lib/systemd/systemd").exists():
        return
    print(f"debootstrap makes {root}", flush=True)
    command = ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", "bookworm", str(root)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ImpossibleError(f"debootstrap failed: {done.stdout[-500:]}{done.stderr[-500:]}")


class Machine:
    """The running container. leader: its systemd, as this machine numbers it."""

    def __init__(self, leader: int) -> None:
        self._enter = ["nsenter", "-t", str(leader), "-m", "-u", "-i", "-n", "-p", "-C", "-r", "-w"]

    def run(self, *command: str, check: bool = True) -> str:
        """A command inside; its output. Raises AssertionError if it fails."""
        environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "SYSTEMD_PAGER": "", "SYSTEMD_COLORS": "0"}
        done = subprocess.run(
            [*self._enter, *command], capture_output=True, text=True, check=False, env=environment, timeout=START_S
        )
        assert not check or done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        return done.stdout

    def property(self, name: str) -> str:
        return self.run("systemctl", "show", "-P", name, UNIT).strip()

    def journal(self) -> str:
        return self.run("journalctl", "-u", UNIT, "-o", "cat", "--no-pager")

    def since_ready_s(self, message: str) -> float:
        """When the present run logged a message; NaN: it has not."""
        run = f"_SYSTEMD_INVOCATION_ID={self.property('InvocationID')}"
        lines = self.run("journalctl", run, "-o", "json", "--no-pager", check=False).splitlines()
        times_us = [int(row["__MONOTONIC_TIMESTAMP"]) for row in map(json.loads, lines) if message in row["MESSAGE"]]
        ready_us = int(self.property("ActiveEnterTimestampMonotonic"))
        return 1e-6 * (times_us[0] - ready_us) if times_us else math.nan

    def until(self, what: str, holds: Callable[[], bool], seconds: float = START_S) -> None:
        """Wait. Raises AssertionError with the journal."""
        end_s = time.monotonic() + seconds
        while not holds():
            assert time.monotonic() < end_s, f"not within {seconds:g} s: {what}\n{self.journal()[-3000:]}"
            time.sleep(0.2)
        print(f"ok: {what}", flush=True)


def make_environment(folder: Path, packages: list[str]) -> None:
    """A virtual environment, to be seen as /opt/imud, of the container's Python with these folders of packages."""
    site = folder / "lib/python3.11/site-packages"
    for each in (folder / "bin", site):
        each.mkdir(parents=True)
    (folder / "pyvenv.cfg").write_text("home = /usr/bin\n")
    (folder / "bin/python").symlink_to("/usr/bin/python3")
    (folder / "bin/imud").write_text(PROGRAM)
    (folder / "bin/imud").chmod(0o755)
    (site / "imud.pth").write_text("\n".join(packages) + "\n")
    folder.chmod(0o755)


@contextlib.contextmanager
def booted(root: Path) -> Iterator[Machine]:
    """The container, whose changes are gone with it. Raises ImpossibleError."""
    folders = [path for path in map(Path, sys.path) if "site-packages" in path.parts and path.is_dir()]
    inside = {HERE: "/opt/source"} | {folder: f"/opt/packages/{number}" for number, folder in enumerate(folders)}
    with tempfile.TemporaryDirectory() as name:
        make_environment(Path(name), list(inside.values()))
        binds = [f"--bind-ro={place}:{there}" for place, there in {Path(name): "/opt/imud", **inside}.items()]
        options = ["-q", "-b", "-D", str(root), "--volatile=overlay", "--private-network", "--register=no"]
        command = ["systemd-nspawn", *options, "--keep-unit", f"--machine=imud-{os.getpid()}", *binds]
        with (Path(name) / "console").open("w+") as console:
            container = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=console, stderr=console)
            try:
                yield _started(container, Path(console.name))
            finally:
                container.send_signal(signal.SIGTERM)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    container.wait(30.0)
                container.kill()


def _started(container: subprocess.Popen, console: Path) -> Machine:
    children = Path(f"/proc/{container.pid}/task/{container.pid}/children")
    end_s = time.monotonic() + START_S
    while time.monotonic() < end_s and container.poll() is None:
        with contextlib.suppress(OSError, AssertionError, IndexError, subprocess.TimeoutExpired):
            machine = Machine(int(children.read_text().split()[0]))
            if machine.run("systemctl", "is-system-running", check=False).strip() in ("running", "degraded"):
                return machine
        time.sleep(0.5)
    raise ImpossibleError(f"the container does not boot: {console.read_text()[-1500:]}")


def install(machine: Machine) -> None:
    """The service, for an emulated sensor and receiver."""
    sensor, receiver = SENSORS
    machine.run("mkdir", "/run/sensor")
    machine.run(
        *("systemd-run", "-q", "--unit=sensor", "/opt/imud/bin/imud", "sim", "g350", "nmea", "--patient"),
        *("--yaw-deg", "40", "--link", sensor, "--link", receiver),
    )
    machine.until("the sensors are emulated", lambda: machine.run("ls", "/run/sensor").split() == ["gnss", "imu"])
    machine.run("sh", "-c", f"chmod 666 $(readlink -f {sensor} {receiver})")
    ports = (item for path in SENSORS for item in ("--port", path))
    print(machine.run("/opt/imud/bin/imud", "install-service", "front", *ports, "--yes"))
    machine.run("sed", "-i", '1i initial = "yaw_deg=40"', FILE)
    machine.run("sed", "-i", f'/^.record.  /,/path/s|^# path = ""|path = "{RECORDING}"|', FILE)
    machine.run("systemctl", "restart", UNIT)


def streams(machine: Machine) -> bool:
    """The daemon says that the sensor does."""
    return '"streaming": true' in machine.run("/opt/imud/bin/imud", "status", "--json", check=False)


def size_of_newest_recording(machine: Machine) -> int:
    """In bytes; each run of the daemon records to a file of its own."""
    newest = machine.run("sh", "-c", f"ls -t {RECORDING.replace('.', '*.')} | head -n 1").strip()
    return int(machine.run("stat", "-L", "-c", "%s", newest)) if newest else 0


def try_restarts(machine: Machine) -> None:
    """A heading that only the first run was given is known again. Raises AssertionError."""
    machine.until("the heading is valid", lambda: machine.since_ready_s("heading is valid") > 0.0)
    machine.run("sed", "-i", "/^initial/d", FILE)
    for command in (("restart",), ("kill", "-s", "KILL")):
        time.sleep(7.0)  # the state is written once a second, the biases less often
        before = machine.property("MainPID")
        machine.run("systemctl", *command, UNIT)
        machine.until("another run", lambda before=before: machine.property("MainPID") not in ("0", before))
        machine.until("the heading is valid", lambda: machine.since_ready_s("heading is valid") > 0.0)
        heading, tilt = (machine.since_ready_s(f"{what} valid") - LASTED_S for what in ("heading is", "pitch are"))
        print(f"ok: after systemctl {' '.join(command)} attitude {tilt:.2f} s and heading {heading:.2f} s after READY")


def try_service(machine: Machine) -> None:
    """All that is promised. Raises AssertionError."""
    machine.until("it is started: READY was said", lambda: machine.property("ActiveState") == "active")
    machine.until("samples come from the sensor, through the sandbox", lambda: streams(machine))
    assert machine.property("StatusText"), "STATUS was never said"
    print(f"ok: systemctl status says {machine.property('StatusText')!r}")
    assert machine.property("CPUWeight") == "1000"
    machine.until("a recording grows", lambda: size_of_newest_recording(machine) > RECORDED_BYTES)
    assert "the recording ended" not in machine.journal(), machine.journal()
    first = machine.property("MainPID")

    machine.run("sed", "-i", r"s/^#* *rate_hz = 10.0.*/rate_hz = 5.0/", FILE)
    machine.run("systemctl", "reload", UNIT)
    machine.until("reload reads the configuration again", lambda: "read the configuration again" in machine.journal())
    assert machine.property("MainPID") == first

    time.sleep(7.0)  # the state is written once a second, the biases less often
    machine.run("sh", "-c", f"kill -STOP {first}")
    machine.until("a daemon that hangs is killed by the watchdog", lambda: "atchdog" in machine.journal(), WATCHDOG_S)
    machine.until("and started again", lambda: machine.property("NRestarts") == "2" and streams(machine))
    second = machine.property("MainPID")
    assert second != first

    machine.run("sh", "-c", f"kill -KILL {second}")
    machine.until("one that crashes, too", lambda: machine.property("NRestarts") == "3" and streams(machine))

    begin_s = time.monotonic()
    machine.run("systemctl", "stop", UNIT)
    assert (machine.property("Result"), machine.property("ExecMainStatus")) == ("success", "0"), machine.journal()
    print(f"ok: stop, after {time.monotonic() - begin_s:.1f} s")

    machine.run("sh", "-c", f"echo 'ports = 1' > {FILE}")
    machine.run("systemctl", "start", UNIT, check=False)
    machine.until("an error in the configuration is the end", lambda: machine.property("ActiveState") == "failed")
    assert machine.property("ExecMainStatus") == "78"
    time.sleep(4.0)
    assert machine.property("ActiveState") == "failed", "it was started again"

    rating = machine.run("systemd-analyze", "security", "--no-pager", UNIT).strip().splitlines()[-1]
    exposure = float(rating.rpartition(": ")[2].split()[0])
    assert exposure <= EXPOSURE_MAX, rating
    print(f"ok: {rating.lstrip('→ ')}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], allow_abbrev=False)
    parser.add_argument("--root", type=Path, default=Path("/var/tmp/imud-bookworm"), help="of the bare Debian")
    root = parser.parse_args().root
    try:
        absent = [name for name in ("systemd-nspawn", "debootstrap", "nsenter") if shutil.which(name) is None]
        if os.geteuid() or absent or sys.version_info[:2] != (3, 11):
            raise ImpossibleError(f"it needs root, Python 3.11, and {', '.join(absent) or 'nothing else'}")
        make_root(root)
        with booted(root) as machine:
            install(machine)
            try_restarts(machine)
            try_service(machine)
    except ImpossibleError as error:
        print(f"no container here: {error}")
        return IMPOSSIBLE
    return 0


if __name__ == "__main__":
    sys.exit(main())
