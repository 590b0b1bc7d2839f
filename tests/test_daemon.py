"""The daemon as a user meets it: processes, pseudo-terminals and sockets, nothing inside."""

import contextlib
import itertools
import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from datetime import datetime
from pathlib import Path

import pytest
from processes import TIMEOUT_S, daemon, emulator, is_settled, process, silent_tty

from imud import client
from imud.commands import main

REST = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5", "--gyro-bias-dps", "0.3,-0.3,0.3")
EVERY = 20  # of the states, so that the kernel keeps seconds of them for a reader that gets no processor time
OVERLOAD = "cannot keep up"  # says a daemon that for a while has no time to publish


@pytest.mark.thorough
def test_attitude_and_bias_of_a_still_sensor(tmp_path):
    with (
        emulator("g350", *REST, "--accel-bias-mg", "0,0,0", "--patient", links=[tmp_path / "imu"]),
        daemon(tmp_path, "--port", str(tmp_path / "imu")) as imud,
    ):
        est = imud.until(is_settled)
        assert est["roll_deg"] == pytest.approx(10.0, abs=0.3)
        assert est["pitch_deg"] == pytest.approx(-5.0, abs=0.3)
        assert [est[f"bg{axis}_dps"] for axis in "xyz"] == pytest.approx([0.3, -0.3, 0.3], abs=0.1)
        assert "lat_deg" not in est
        imud.comes_at(1000.0, 0.02)
        assert "/numba/" not in Path(f"/proc/{imud.process.pid}/maps").read_text(), "numba compiled something"
        imud.process.send_signal(signal.SIGTERM)
        assert imud.process.wait(TIMEOUT_S) == 0
        assert "lost=0" in imud.log


@pytest.mark.thorough
def test_a_daemon_that_was_killed_goes_on_where_it_was(tmp_path):
    with emulator("g350", *REST, "--patient", links=[tmp_path / "imu"]):
        with daemon(tmp_path, "--port", str(tmp_path / "imu")) as imud:
            settled_ns = imud.until(is_settled)["t_mono_ns"]
            imud.until(lambda m: m["class"] == "EST" and m["t_mono_ns"] > settled_ns + 3_000_000_000)
            imud.process.kill()
            imud.process.wait()
        with daemon(tmp_path, "--port", str(tmp_path / "imu")) as imud:
            est = imud.until(lambda message: message["class"] == "EST")
            assert est["bgx_dps"] == pytest.approx(0.3, abs=4.0 * est["sbgx_dps"])
            imud.says("the filter goes on where an earlier run of the daemon ended")
            est = imud.until(lambda m: m["class"] == "EST" and m["sroll_deg"] < 1.0)
            assert est["roll_deg"] == pytest.approx(10.0, abs=3.0 * est["sroll_deg"])


def test_the_first_client_finds_the_present_state(tmp_path):
    """Without a client nothing is prepared for one: who connects then must not receive an old state."""
    with (
        emulator("g350", *REST, "--patient", links=[tmp_path / "imu"]),
        daemon(tmp_path, "--port", str(tmp_path / "imu")) as imud,
    ):
        before = datetime.fromisoformat(imud.until(lambda message: message["class"] == "EST")["time"])
        imud.client.close()
        time.sleep(2.0)
        with socket.socket(socket.AF_UNIX) as late:
            late.connect(str(tmp_path / "gpsd.sock"))
            late.sendall(b"?POLL;\n?DEVICES;\n")
            version, poll, devices = [json.loads(row) for row in itertools.islice(late.makefile("rb"), 3)]
        assert version["class"] == "VERSION"
        assert (datetime.fromisoformat(poll["time"]) - before).total_seconds() > 1.0
        assert [device["path"] for device in devices["devices"]] == [str(tmp_path / "imu")]


def test_the_configuration_is_read_again(tmp_path):
    imu, gnss, file = tmp_path / "imu", tmp_path / "gnss", tmp_path / "imud.toml"
    file.write_text("[gnss]\nmax_hdop = 20.0\n")
    ports = ("--port", str(imu), "--port", str(gnss))
    with (
        emulator("g350", "nmea", "--scenario", "rest", links=[imu, gnss]),
        daemon(tmp_path, *ports, "--config", str(file)) as imud,
    ):
        imud.until(lambda m: m["class"] == "EST" and "position" in m["state"])
        file.write_text("[gnss]\nmax_hdop = -1.0\nfoo = 3\n")
        imud.process.send_signal(signal.SIGHUP)
        imud.says("the configuration stays as it was")
        imud.says("gnss.foo: unknown key")
        file.unlink()
        os.mkfifo(file)  # as /dev/fd/63 of `--config <(…)` is; nobody writes to it
        imud.process.send_signal(signal.SIGHUP)
        imud.says("it is no regular file")
        file.unlink()
        file.write_text("estimator = 'attitude'\n[gnss]\nmax_hdop = 0.1\n")
        imud.process.send_signal(signal.SIGHUP)
        imud.says("changed=gnss.max_hdop")
        imud.says("takes effect at the next start: estimator")
        imud.says("no fixes: coasting")
        imud.process.send_signal(signal.SIGTERM)
        assert imud.process.wait(TIMEOUT_S) == 0


@pytest.mark.thorough
def test_live_subscribers_miss_nothing_beside_one_that_stalls(tmp_path):
    stream, memory = tmp_path / "stream", tmp_path / "state"
    settings = ("--set", f"stream.listen={stream}", "--set", f"shared_memory.path={memory}")
    with (
        emulator("g350", *REST, "--patient", links=[tmp_path / "imu"]),
        daemon(tmp_path, "--port", str(tmp_path / "imu"), *settings) as imud,
        client.connect(stream) as stalled,
        contextlib.ExitStack() as stack,
    ):
        imud.says("roll and pitch are valid")
        live = [stack.enter_context(client.connect(stream, EVERY, TIMEOUT_S)) for _ in range(3)]
        last = [next(states) for states in live]
        for _ in range(3000 // EVERY):
            for i, states in enumerate(live):
                state = next(states)
                assert state.seq == last[i].seq + EVERY or OVERLOAD in imud.log
                last[i] = state
        kept = itertools.takewhile(lambda state: state.seq < last[0].seq, stalled)
        assert len(list(kept)) < 3000 - EVERY
        assert last[0].roll == pytest.approx(math.radians(10.0), abs=0.02)
        assert last[0].pitch == pytest.approx(math.radians(-5.0), abs=0.02)
        assert client.latest(memory).seq >= last[0].seq
        assert client.latest(memory).utc_s == pytest.approx(time.time(), abs=10.0)
    assert client.latest(memory) is None


def test_position_with_a_receiver_a_stop_and_a_reconnect(tmp_path):
    imu, gnss = tmp_path / "imu", tmp_path / "gnss"
    ports = ("--port", str(imu), "--port", str(gnss))
    with daemon(tmp_path, *ports) as imud:
        imud.says("there is no")
        with emulator("g350", "nmea", "--scenario", "rest", links=[imu, gnss]):
            est = imud.until(lambda m: m["class"] == "EST" and "position" in m["state"])
            assert est["lat_deg"] == pytest.approx(35.6586, abs=1e-3)
            assert est["lon_deg"] == pytest.approx(139.7454, abs=1e-3)
            tpv = imud.until(lambda m: m["class"] == "TPV" and m["mode"] == 3)
            assert tpv["lat"] == pytest.approx(35.6586, abs=1e-3)
            said = len(imud.log)
            before = imud.until(lambda m: m["class"] == "EST")
            imud.process.send_signal(signal.SIGSTOP)
            time.sleep(6.0)  # longer than either device may be silent
            imud.process.send_signal(signal.SIGCONT)
            after = imud.until(lambda m: m["class"] == "EST" and m["t_mono_ns"] > before["t_mono_ns"] + 8_000_000_000)
            assert "trying again" not in imud.log[said:], "a daemon that was stopped blames the devices"
        imud.says("went away")
        with emulator("g350", "nmea", "--scenario", "rest", links=[imu, gnss]):
            imud.until(lambda m: m["class"] == "EST" and m["seq"] > after["seq"] + 1000)
        assert imud.process.poll() is None


def run(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "imud", *arguments], capture_output=True, text=True, check=False,
        env={**os.environ, "NO_COLOR": "1"},
    )  # fmt: skip


def run_on(tmp_path, port, *arguments):
    return run("run", "--port", str(port), "--no-wait", "--listen", str(tmp_path / "gpsd.sock"), *arguments)


def test_a_missing_device_without_waiting(tmp_path):
    ended = run_on(tmp_path, tmp_path / "absent")
    assert (ended.returncode, ended.stdout) == (69, "")
    assert "absent" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_file_is_no_port(tmp_path):
    (tmp_path / "file").write_text("")
    ended = run_on(tmp_path, tmp_path / "file")
    assert ended.returncode == 74, ended.stderr


def test_a_silent_line_without_waiting(tmp_path):
    with silent_tty() as (_, path):
        ended = run_on(tmp_path, path)
        assert ended.returncode == 69, ended.stderr
        assert path in ended.stderr


def test_noise_is_no_device(tmp_path):
    with silent_tty() as (master, path):
        stop = threading.Event()

        def babble():
            noise = os.urandom(4096)
            while not stop.wait(0.01):
                os.write(master, noise[:100])

        thread = threading.Thread(target=babble)
        thread.start()
        try:
            ended = run_on(tmp_path, path)
        finally:
            stop.set()
            thread.join()
        assert ended.returncode == 69, ended.stderr
        assert "Traceback" not in ended.stderr


def test_a_port_in_use_names_its_holder(tmp_path):
    with silent_tty() as (_, path):
        holder = f"import serial,sys; p=serial.Serial({path!r}, exclusive=True); print(1, flush=True); sys.stdin.read()"
        with subprocess.Popen([sys.executable, "-c", holder], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
            other.stdout.readline()
            ended = run_on(tmp_path, path)
            other.kill()
        assert ended.returncode == 74, ended.stderr
        assert str(other.pid) in ended.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["run"], 64, "no port"),
        (["fly"], 64, "fly"),
        (["run", "--port", "/dev/null:toaster"], 64, "toaster"),
        (["run", "--port", "/dev/x", "--estimator", "guess"], 64, "guess"),
        (["run", "--port", "/dev/x", "--set", "imu.rate=3"], 78, "imu.rate"),
        (["run", "--port", "/dev/x", "--config", "/nonexistent.toml"], 78, "/nonexistent.toml"),
        (["run", "--port", "/dev/x", "--listen", "0.0.0.0:0"], 78, "allow_remote"),
        (["replay", "--imu", "/nonexistent.csv", "-o", "-"], 66, "/nonexistent.csv"),
    ],
)
def test_exit_codes(arguments, code, says, capsys):
    with pytest.raises(SystemExit) as ended:
        sys.exit(main(arguments))
    assert ended.value.code == code
    out, err = capsys.readouterr()
    assert (out, says in err, "Traceback" in err) == ("", True, False), err


@pytest.mark.thorough
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_a_signal_ends_the_compiling_by_numba(tmp_path, number, code):
    pytest.importorskip("numba", reason="where it cannot be installed, the kernels come compiled")
    log = (tmp_path / "log").open("w")
    command = ("imud", "run", "--port", str(tmp_path / "absent"), "--listen", str(tmp_path / "gpsd.sock"))
    environment = {**os.environ, "NO_COLOR": "1", "IMUD_JIT": "1", "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    with log, process(*command, stderr=log, env=environment) as running:
        while not list(tmp_path.glob("cache/**/*.nbi")):  # the first kernel is done, many are to come
            assert running.poll() is None
            time.sleep(0.02)
        running.send_signal(number)
        assert running.wait(TIMEOUT_S) == code
    said = (tmp_path / "log").read_text()
    assert "ready" not in said
    assert "Traceback" not in said
    assert not (tmp_path / "gpsd.sock").exists()


def signalled(program, name):
    """How a program in Python ends that sends itself the signal of this name."""
    return subprocess.run(
        [sys.executable, "-c", program.format(name=name)],
        check=False,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )


_COMPILING = """
import os, signal, sys, types
import imud.__main__, imud.commands

class Compiler:
    def is_locked(self):
        return True

def command():
    sys.modules["numba.core.compiler_lock"] = types.SimpleNamespace(global_compiler_lock=Compiler())
    try:
        os.kill(os.getpid(), signal.{name})
    finally:
        print("an exception was raised inside the compiler")

imud.commands.main = command
sys.exit(imud.__main__.main())
"""


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 0), ("SIGINT", 130)])
def test_a_signal_raises_nothing_inside_the_compiler(name, code):
    ended = signalled(_COMPILING, name)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", "")


_HALF_MADE = """
import contextlib, os, signal, sys
import imud.__main__, imud.commands

class HalfMade:
    def __init__(self):
        os.kill(os.getpid(), signal.{name})
        self.handle = 1

    def __del__(self):
        print(self.handle)

def command():
    with contextlib.suppress(BaseException):
        HalfMade()
    return 5

imud.commands.main = command
sys.exit(imud.__main__.main())
"""


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_what_a_signal_leaves_half_made_goes_without_a_word(name):
    ended = signalled(_HALF_MADE, name)
    assert (ended.returncode, ended.stdout, ended.stderr) == (5, "", "")


_DELETED = """
import os, signal, sys, time
import imud.__main__, imud.commands

class Deleted:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})

def command():
    Deleted()
    time.sleep(600)

imud.commands.main = command
sys.exit(imud.__main__.main())
"""


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 0), ("SIGINT", -signal.SIGINT)])
def test_a_signal_that_comes_while_an_object_is_deleted_is_not_lost(name, code):
    """Python ignores an exception there."""
    ended = signalled(_DELETED, name)
    assert (ended.returncode, ended.stdout) == (code, "")


def test_a_hang_up_that_nohup_had_ignored_ends_nothing(tmp_path):
    log = tmp_path / "log"
    command = ("imud", "run", "--port", str(tmp_path / "absent"), "--listen", str(tmp_path / "gpsd.sock"))
    with (
        log.open("w") as file,
        process(*command, stderr=file, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)) as running,
    ):
        while "ready" not in log.read_text():
            assert running.poll() is None
            time.sleep(0.05)
        running.send_signal(signal.SIGHUP)
        running.send_signal(signal.SIGTERM)
        assert running.wait(TIMEOUT_S) == 0


def test_ctrl_c_ends_with_130_and_no_traceback(tmp_path):
    with daemon(tmp_path, "--port", str(tmp_path / "absent")) as imud:
        imud.process.send_signal(signal.SIGINT)
        assert imud.process.wait(TIMEOUT_S) == 130
        assert "Traceback" not in imud.log
