"""The emulator sends a recording's own bytes: in memory word for word, to a daemon as `imud replay` has them."""

import json

import numpy as np
import pytest
from emulated import REST, Emulated, device
from emulated_recording import record
from nmea_lines import gga
from processes import TIMEOUT_S, daemon, emulator
from recorded import message, reads_of
from scripted import run

from imud.drivers.detect import detect
from imud.drivers.driver import Options
from imud.drivers.registry import by_name
from imud.firmware_sim.recorded_bytes import BytePlayback, choose, read
from imud.firmware_sim.replay import DataError
from imud.recording.file import RecordingFile
from imud.recording.samples import samples_of

RATE_HZ = 125.0


def received(path, port=0):
    return [(raw.t_ns, raw.data) for raw in reads_of(path, port)]


def test_the_host_hears_the_recorded_bytes_when_it_starts_the_stream_each_time_anew(tmp_path):
    path = tmp_path / "drive.mcap"
    record(path, REST, 3.0, rate_hz=RATE_HZ)
    (port,), playback = choose(read(path), ["g350"], loop=False)
    wire = Emulated(BytePlayback(device("g350", 460800).unit, port, playback, leads=True))
    wanted = b"".join(data for _, data in received(path))
    for _ in range(2):
        found, _ = run(detect(), wire)
        run(by_name(found.driver).configure(found, Options(rate_hz=RATE_HZ)), wire)
        begin = bytes(wire.outgoing)
        wire.outgoing.clear()
        heard = begin + wire.stream(2.0, step_s=1e-3)
        at = wanted.find(heard)
        assert 0 <= at < 60 * 22  # frames that the dialogue has used
        assert len(heard) > 1.5 * RATE_HZ * 22
        assert wire.stream(2.0, step_s=1e-3) == wanted[at + len(heard) :]


def test_a_loop_goes_on_from_the_beginning(tmp_path):
    path = tmp_path / "drive.mcap"
    record(path, REST, 1.0, rate_hz=RATE_HZ)
    (port,), playback = choose(read(path), ["g350"], loop=True)
    wire = Emulated(BytePlayback(device("g350", 460800).unit, port, playback, leads=True))
    wire.host_baud = 460800
    wire.stream(1.0, step_s=1e-3)
    for command in (b"\xb7\x04\r", b"\xb8\x04\r", b"\xba\x01\r", b"\xb9\x01\r"):
        wire.receive_from(command)
    once = b"".join(data for _, data in received(path))
    assert (once * 4).startswith(wire.stream(2.5, step_s=1e-3))


def test_bytes_come_at_their_recorded_distances_and_a_receiver_keeps_in_step(tmp_path):
    """An inertial sensor that starts late: the receiver beside it has no fix until then, and then the recorded ones."""
    path = tmp_path / "both.mcap"
    imu = [(10**9 * k // 10, b"\xaa\x55" + bytes([k]) * 22) for k in range(20, 50)]
    gnss = [(10**9 * k + 10**8, gga(f"12000{k}.000")) for k in range(6)]
    write(path, {"crossbow": imu, "nmea": gnss})
    ports, playback = choose(read(path), ["rga300", "nmea"], loop=False)
    units = [device(name, baud, **({"no_fix_s": 1e9} if name == "nmea" else {})).unit
             for name, baud in (("rga300", 38400), ("nmea", 9600))]  # fmt: skip
    first, second = (
        Emulated(BytePlayback(unit, port, playback, leads))
        for unit, port, leads in zip(units, ports, (True, False), strict=True)
    )
    first.host_baud, second.host_baud = 38400, 9600
    before = first.stream(5.0, step_s=1e-3) + second.stream(5.0, step_s=1e-3)
    assert before.count(b",E,0,") >= 3 and b",E,1," not in before
    first.receive_from(b"C")
    times, heard = [], b""
    for _ in range(3000):
        if said := first.stream(0.001, step_s=1e-3):
            heard += said
            times += [first.now_s] * (len(heard) % 24 == 0)
    assert heard == b"".join(data for _, data in imu)
    assert np.diff(times) == pytest.approx(0.1, abs=0.0085)  # the first one is not held up by the line
    text = second.stream(4.0, step_s=1e-3)
    assert text.endswith(b"".join(data for t_ns, data in gnss if t_ns >= imu[0][0]))
    assert text.count(b",E,1,") == 4


def write(path, devices, request=None):
    """A recording with these chunks, by driver."""
    file = RecordingFile(path, {"version": "0", "session": "x"}, b"{}", 0)
    models = {"crossbow": "DMU RGA300CA", "nmea": "NMEA receiver", "epson": "M-G999"}
    for number, driver in enumerate(devices):
        configured = {"identity": {"driver": driver, "model": models[driver]}, "request": request}
        said = {"t_ns": 0, "port": number, "path": "x", "driver": driver, "configured": configured}
        file.write("/connections", 0, json.dumps(said).encode())
    for number, chunks in enumerate(devices.values()):
        for t_ns, data in chunks:
            file.write("/raw", t_ns, message(t_ns, data, number))
    file.finish()


@pytest.mark.parametrize(
    ("devices", "request_", "wanted", "says"),
    [
        ({"crossbow": [(1, b"x")]}, None, ["g350"], r"no g350 .* rga300 \(DMU RGA300CA\).*imud export --csv"),
        ({"epson": [(1, b"x")]}, None, ["g350"], r"no emulated device \(M-G999\).*imud export --csv"),
        ({"crossbow": [(1, b"x")]}, None, ["rga300", "rga300"], "not so many"),
        ({"crossbow": [(1, b"x")]}, {"command": "Rw=="}, ["rga300"], "polled.*imud export --csv"),
        ({"crossbow": []}, None, ["rga300"], "no bytes of a device.*--record"),
    ],
)
def test_a_recording_that_does_not_fit_is_refused_with_what_to_do(tmp_path, devices, request_, wanted, says):
    path = tmp_path / "x.mcap"
    write(path, devices, request_)
    with pytest.raises(DataError, match=says):
        choose(read(path), wanted, loop=False)


def test_a_damaged_recording_is_refused_with_what_to_do(tmp_path):
    path = tmp_path / "x.mcap"
    write(path, {"crossbow": [(k, bytes([k])) for k in range(200)]})
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(DataError, match=r"damaged.*imud run --port replay:"):
        read(path)


@pytest.mark.thorough
def test_a_daemon_on_the_emulator_has_the_samples_of_the_recording(tmp_path):
    path, imu = tmp_path / "drive.mcap", tmp_path / "imu"
    record(path, REST, 4.0, rate_hz=RATE_HZ)
    again = ("--record", str(tmp_path / "again.mcap"), "--set", f"imu.rate_hz={RATE_HZ}")
    with (
        emulator("g350", "--replay", str(path), "--patient", links=[imu]),
        daemon(tmp_path, "--port", str(imu), "--estimator", "attitude", *again) as imud,
    ):
        imud.says("nothing new comes")
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
    first, second = (samples_of(tmp_path / name)[0] for name in ("drive.mcap", "again.mcap"))
    n = len(second)
    assert n > 3.0 * RATE_HZ
    for name in ("w", "f", "temperature"):
        assert (second[name] == first[name][-n:]).all()
