"""`[realtime]`: off unless asked for, done before READY, and refused with what to do about it."""

import ctypes
import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from processes import daemon

from imud.configuration.settings import Realtime
from imud.errors import ConfigError, ImudError, PermissionDeniedError
from imud.process import realtime

PR_SET_SECUREBITS, SECBIT_NOROOT, CAP_IPC_LOCK, CAP_SYS_NICE = 28, 1, 14, 23
ALL = ("realtime.lock_memory=true", "realtime.scheduler=fifo", "realtime.priority=7", "realtime.cpus=[0]")


def unprivileged():
    """Runs in the child: root without capabilities, inherited ones either, and limits of nothing."""
    ctypes.CDLL(None).prctl(PR_SET_SECUREBITS, SECBIT_NOROOT, 0, 0, 0)
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))


def start(tmp_path, setting, **options):
    command = ("imud", "run", "--estimator", "tilt", "--port", str(tmp_path / "absent"))
    return subprocess.run(
        [sys.executable, "-m", *command, "--listen", str(tmp_path / "s"), "--set", setting],
        capture_output=True, text=True, check=False, env={**os.environ, "NO_COLOR": "1"}, **options,
    )  # fmt: skip


def test_off_by_default(monkeypatch):
    for name in ("sched_setscheduler", "sched_setaffinity"):
        monkeypatch.setattr(os, name, lambda *_: pytest.fail("asked the kernel for something"))
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: pytest.fail("asked the kernel for something"))
    realtime.apply(Realtime())


def capable():
    """Whether we may lock memory and take a real-time priority: root may, but not in every container."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    wanted = 1 << CAP_IPC_LOCK | 1 << CAP_SYS_NICE
    return int(status["CapEff"], 16) & wanted == wanted


@pytest.mark.skipif(not capable(), reason="may not lock memory and take a real-time priority")
def test_what_is_asked_for_is_so_when_ready(tmp_path):
    settings = [word for setting in ALL for word in ("--set", setting)]
    with daemon(tmp_path, "--estimator", "tilt", "--port", str(tmp_path / "absent"), *settings) as imud:
        pid = imud.process.pid
        assert os.sched_getscheduler(pid) == os.SCHED_FIFO
        assert os.sched_getparam(pid).sched_priority == 7
        assert os.sched_getaffinity(pid) == {0}
        status = Path(f"/proc/{pid}/status").read_text()
        locked = next(line for line in status.splitlines() if line.startswith("VmLck"))
        assert int(locked.split()[1]) > 10_000


@pytest.mark.parametrize("setting", ["realtime.lock_memory=true", "realtime.scheduler=rr"])
def test_a_refusal_of_the_kernel_ends_the_start_and_names_the_remedy(tmp_path, setting):
    ended = start(tmp_path, setting, preexec_fn=unprivileged)
    assert ended.returncode == 77, ended.stderr
    assert setting.partition("=")[0] in ended.stderr
    assert "LimitRTPRIO=" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_processor_that_is_not_there_is_a_mistake_of_the_configuration():
    with pytest.raises(ConfigError, match=r"realtime\.cpus = \[1023\].* there are 0"):
        realtime.apply(Realtime(cpus=(1023,)))


@pytest.mark.parametrize(("code", "kind"), [(errno.EPERM, PermissionDeniedError), (errno.EINVAL, ImudError)])
def test_refusals_of_the_kernel_are_distinguished(monkeypatch, code, kind):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(ImudError, match=r"realtime\.scheduler = fifo at priority 40") as caught:
        realtime.apply(Realtime(scheduler="fifo"))
    assert type(caught.value) is kind
