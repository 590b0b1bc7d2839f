"""The surfaces at which bytes from outside come in, each as a function that takes any bytes and must not raise.

What a user or peer did wrong is reported by an ImudError or CaptureError, or an answer; anything else is a defect.
"""

import contextlib
import ctypes
import functools
import json
import math
import os
import shutil
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import fuzz_clients
import fuzz_decoders
import fuzz_dialogues
import fuzz_files
import msgspec
from pyrtcm import calc_crc24q

from imud import client
from imud.commands import reference
from imud.configuration.settings import Initial, Settings
from imud.drivers.capture_messages import READS, Connection, Raw, Reads
from imud.drivers.registry import by_name
from imud.errors import ConfigError, ImudError
from imud.firmware_sim import fixes, ublox
from imud.outputs.addresses import parse_address
from imud.outputs.gpsd_dialogue import Policy, ReceiveBuffer, answer
from imud.outputs.gpsd_json import Report
from imud.outputs.view import Device, View
from imud.recording.file import RecordingFile
from imud.recording.player import Handlers, Player
from imud.recording.samples import read_samples
from imud.recording.source import adapter, group
from imud.setup import config
from imud.tables.inputs import read_fixes


@dataclass(frozen=True)
class Surface:
    """take: the function; examples: inputs to begin with; words: what to insert; tries: in each run of the tests."""

    take: Callable[[bytes], None]
    examples: tuple[bytes, ...]
    words: tuple[bytes, ...] = (b"\0", b"\n", b"\xff")
    tries: int = 300


def gpsd(data: bytes) -> None:
    """Requests; every answer is JSON on one line."""
    receive_buffer, policy = ReceiveBuffer(), Policy(10.0)
    report = Report(View(devices=(Device("/dev/ttyUSB0", "epson"),)))
    receive_buffer.feed(data)
    while request := receive_buffer.next_request():
        answered = answer(request, policy, report)
        policy = answered.policy
        assert 0.001 <= policy.rate_hz <= 1000.0
        for text in answered.objects:
            assert "class" in json.loads(text) and "\n" not in text


def toml(data: bytes) -> None:
    with contextlib.suppress(ConfigError, UnicodeDecodeError):
        assert isinstance(config.loads(data.decode()), Settings)


def override(data: bytes) -> None:
    with contextlib.suppress(ConfigError):
        assert isinstance(config.load(None, [os.fsdecode(data.replace(b"\0", b""))]), Settings)


def address(data: bytes) -> None:
    text = data.decode("latin-1")
    if "." not in text.strip("0123456789.:") and not any(c.isalpha() for c in text):  # no name is looked up
        with contextlib.suppress(ConfigError):
            parse_address(text, 2947)


def nmea(data: bytes) -> None:
    driver = by_name("nmea")
    assert driver.kind == "gnss"
    for unchecked in (False, True):
        decoder = driver.new_decoder(unchecked)
        for fix in [*decoder.feed(data, 10**9), *decoder.flush(1 << 62)]:
            assert abs(fix.lat_deg) <= 90.0 and abs(fix.lon_deg) <= 180.0


def _fixes(name: str) -> Callable[[bytes], None]:
    def take(data: bytes) -> None:
        driver = by_name(name)
        assert driver.kind == "gnss"
        decoder = driver.new_decoder()
        for fix in [*decoder.feed(data, 10**9), *decoder.flush(1 << 62)]:
            assert abs(fix.lat_deg) <= 90.0 and abs(fix.lon_deg) <= 180.0
        assert len(decoder.sky.satellites) < 1000

    return take


def _file(data: bytes, suffix: str, read: Callable[[Path], object]) -> None:
    with tempfile.NamedTemporaryFile(suffix=suffix) as file:
        file.write(data)
        file.flush()
        with contextlib.suppress(ImudError):
            read(Path(file.name))


def mcap(data: bytes) -> None:
    def read(path: Path) -> None:
        (recording, *_), _ = group([path])
        adapt = adapter(None, (), None)
        player = Player(recording.settings(adapt), adapt, Initial(), Handlers())
        for entry in recording:
            player.take(entry)

    _file(data, ".mcap", read)


def imu_csv(data: bytes) -> None:
    def read(path: Path) -> None:
        samples, _, _ = read_samples(path)
        assert len(samples) > 1 and (samples["t_ns"][1:] > samples["t_ns"][:-1]).all()

    _file(data, ".csv", read)


def gnss_csv(data: bytes) -> None:
    _file(data, ".csv", lambda path: read_fixes(path, 0))


def shared(data: bytes) -> None:
    """As it is, and as of a daemon that runs: both clients read the same, or nothing."""
    _read_shared(data)
    life = struct.pack("<qQ16s", time.monotonic_ns(), 1, client.boot_id())
    if len(data) == client.SHARED_SIZE:
        _read_shared(data[: -len(life)] + life)


def _read_shared(data: bytes) -> None:
    found: list[client.State | None] = []

    def read(path: Path) -> None:
        usual, client._WRITE_NS = client._WRITE_NS, 2_000_000  # no writer is at work here, for which one would wait
        try:
            with contextlib.suppress(client.ProtocolError):
                found.append(client.latest(path))
        finally:
            client._WRITE_NS = usual

    _file(data, ".state", read)
    if (reader := c_reader()) is not None and len(data) == client.SHARED_SIZE:
        state = ctypes.create_string_buffer(client.RECORD.size)
        if reader(ctypes.create_string_buffer(data, len(data)), state):
            assert state.raw == data[8 : 8 + client.RECORD.size]
        else:
            assert not found or found[0] is None


@functools.cache
def c_reader() -> Callable[..., int] | None:
    """imud_read() of the C header; None: there is no compiler. Where a number overflows it aborts."""
    if shutil.which("cc") is None:
        return None
    with tempfile.TemporaryDirectory() as name:
        source, library = Path(name) / "reader.c", Path(name) / "reader.so"
        call = "int get(void *shared, struct imud_state *state) { return imud_read(shared, state); }"
        source.write_text(f"{reference.c_header()}\n{call}\n")
        subprocess.run(["cc", "-std=c11", "-ftrapv", "-shared", "-fPIC", source, "-o", library], check=True)
        reader: Callable[..., int] = ctypes.CDLL(str(library)).get
        return reader


def stream(data: bytes) -> None:
    with contextlib.suppress(client.ProtocolError):
        client.decode(data)


def web(data: bytes) -> None:
    from imud.commands.web.server import is_own_name, is_own_origin

    host, _, origin = data.decode("latin-1").partition("\n")
    is_own_name(host)
    is_own_origin(origin, host)


def _recording() -> bytes:
    said = Connection(10**9, 0, "/dev/x", True, "gnss", "nmea", {"identity": {"driver": "nmea", "model": ""}})
    with tempfile.TemporaryDirectory() as folder:
        file = RecordingFile(Path(folder) / "a", {"version": "0"}, msgspec.json.encode(Settings()), 0)
        file.write("/connections", 10**9, msgspec.json.encode(said))
        file.write(READS, 2 * 10**9, Reads.of([(0, Raw(2 * 10**9, b"$GPGGA,\r\n"))]).encode())
        file.finish()
        return (Path(folder) / "a").read_bytes()


_GGA = b"$GPGGA,081437.000,5212.981473,N,00653.102458,E,1,3,2.88,102.907,M,47.093,M,,*5E\r\n"
_SENTENCES = (_GGA, b"$GPGLL,4807.038,N,01131.000,E,120000,A,A*50\r\n", b"$GPRMC,120000,V,,,,,,,,,,N*40\r\n")
_UBX = ublox.Report(
    1.8e9, fixes.Fix(0.0, 0.1, 48.0, 11.0, 500.0, 5.0, 90.0, 0.8, velocity_mps=(0.0, 5.0, 0.1)), heading_deg=90.0
)
_REPORTS = (
    b'{"class":"TPV","device":"/dev/a","mode":3,"time":"2026-11-23T01:10:07.000Z","lat":35.6,"lon":139.7,"track":89.4,'
    b'"altHAE":59.3,"altMSL":22.6,"speed":13.4}\n',
    b'{"class":"SKY","device":"/dev/a","hdop":1.0,"satellites":[{"PRN":21,"el":62.0,"az":41.0,"ss":45.0,"used":true,'
    b'"gnssid":0,"svid":21}]}\n',
    b'{"class":"TOFF","device":"/dev/a","real_sec":1795396207,"real_nsec":0,"clock_sec":1795396207,"clock_nsec":1417}\n',
    b'{"class":"GST","device":"/dev/a","time":"2026-11-23T01:10:07.000Z","lat":1.0,"lon":1.0,"alt":2.0}\n',
)
_IMU = b"t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2\n" + b"".join(
    b"%.2f,0,0,0,0,0,-9.8\n" % (0.01 * i) for i in range(5)
)
_JSON = (b"{", b"}", b"[", b'"', b":", b",", b"null", b"true", b"\\u0000", b"1e999", b"NaN")
_TOML = (
    b"[",
    b"]",
    b"=",
    b"\n",
    b"[gnss]\n",
    b"latency_s",
    b"nmea.rate_hz",
    b"inf",
    b"nan",
    b'"""',
    b"1979-05-27",
    b".",
)
_DOUBLES = (
    *(struct.pack("<d", number) for number in (math.nan, math.inf, 1e308, 5e-324, -1.0)),
    *(b"\xff" * 8, b"\0" * 7 + b"\x80"),
)
_RTCM = b"\xd3\0\2\x3e\xd0" + calc_crc24q(b"\xd3\0\2\x3e\xd0").to_bytes(3, "big")
_FEW = 40  # of those that take milliseconds
_PORT = (b":", b"@", b"gpsd://", b"iio:", b"spi:", b"replay:", b"[", b"]", b"99999999999")
_RECORD = client.MAGIC + b"\1\0" + bytes(client.RECORD.size - 6)
_SHARED = b"\2" + bytes(7) + _RECORD + _RECORD[:8]
SURFACES = {
    "gpsd": Surface(
        gpsd,
        (
            b'?WATCH={"enable":true,"json":true,"rate":10,"class":"TPV"};\n',
            b"?POLL;?DEVICES;",
            b"?DEVICE={};",
            b"POST /",
        ),
        (*_JSON, b"?WATCH=", b"?DEVICE=", b";", b"?", b"rate", b"GET "),
    ),
    "toml": Surface(
        toml, (b'ports = ["/dev/ttyUSB0"]\n[gnss]\nlatency_s = 0.2\n[imu]\nmount_rpy_deg = [0, 0, 1]\n',), _TOML
    ),
    "override": Surface(
        override, (b"gnss.latency_s=0.2", b"navigation.lever_arm_m=[0,0,1]", b"realtime.cpus=[0]"), _TOML
    ),
    "address": Surface(
        address, (b"127.0.0.1:2947", b"[::1]:2947", b"/run/imud.sock", b":0"), (b":", b"[", b"]", b"/", b"%")
    ),
    "nmea": Surface(nmea, _SENTENCES, (b"$", b",", b"*", b"\r\n", b"GPGSV", b"PMTK", b"\xb5b")),
    "ubx": Surface(
        _fixes("ubx"),
        tuple(form(_UBX) for form in ublox._FORMS.values()),
        (b"\xb5b", b"\xb5b\x01\x07\x5c\0", b"\xd3\0"),
    ),
    "gpsd-reports": Surface(_fixes("gpsd"), _REPORTS, (*_JSON, b"-1", b"1e400", b"\n")),
    "mcap": Surface(mcap, (_recording(),), (b"\x06", b"\x0c", b"\x09", b"\0\0\0\0\0\0\0\x80")),
    "imu-csv": Surface(imu_csv, (_IMU,), (b",", b"\n", b"nan", b"1e999", b'"')),
    "gnss-csv": Surface(
        gnss_csv, (b"t_s,lat_deg,lon_deg,height_m\n0.5,48.0,11.0,500\n",), (b",", b"\n", b"nan", b"1e999", b'"')
    ),
    "shared": Surface(
        shared, (bytes(client.SHARED_SIZE), *(_SHARED + client.LIVENESS.pack(t, 1, b"") for t in (0, -1 << 63)))
    ),
    "stream": Surface(stream, (_RECORD,)),
    "web": Surface(
        web, (b"127.0.0.1:8080\nhttp://127.0.0.1:8080", b"[::1]\nnull"), (b"[", b"]", b"@", b"#", b"http://", b":")
    ),
    "web-request": Surface(
        fuzz_clients.web_request, fuzz_clients.REQUESTS, (b"\r\n", b":", b"%00", b"../", b"\x81\xfe"), tries=_FEW
    ),
    "status": Surface(fuzz_clients.answered, fuzz_clients.STATUSES, _JSON),
    "live-fixes": Surface(fuzz_clients.live_fixes, fuzz_clients.FIXES, (*_JSON, b"\n")),
    "live-states": Surface(fuzz_clients.live_states, fuzz_clients.STATES, _DOUBLES),
    "aiding": Surface(
        fuzz_files.aiding, fuzz_files.DATAGRAMS, (*_JSON, b"\n", b'"t"', b"sigma", b"1e308", b"-1"), tries=_FEW
    ),
    "rtcm": Surface(fuzz_files.rtcm, (_RTCM * 2, b"noise" + _RTCM), (b"\xd3\0", b"\xd3\3\xff")),
    "iio-sysfs": Surface(
        fuzz_files.iio, fuzz_files.SYSFS, (b"\n", b"=", b"_en=1", b"/", b"nan", b"1e999", b"X9", b"["), tries=_FEW
    ),
    "calibration": Surface(fuzz_files.calibrated, fuzz_files.CALIBRATIONS, (*_TOML, b"1e308"), tries=_FEW),
    "biases": Surface(fuzz_files.biases, fuzz_files.BIASES, (*_JSON, b"1e308", b"-1"), tries=_FEW),
    "checkpoint": Surface(fuzz_files.checkpoint, fuzz_files.CHECKPOINTS, (*_JSON, b"BOOT", b"NOW", b"UP"), tries=_FEW),
    **{
        f"resume-{name}": Surface(fuzz_files.resumed(name), fuzz_files.CHANGES, _DOUBLES, tries=_FEW)
        for name in ("navigation", "attitude", "riss")
    },
    "port": Surface(
        fuzz_files.port, (b"/dev/ttyUSB0:nmea@9600", b"gpsd://[::1]:2947/dev/a", b"iio:chip", b"spi:0.0"), _PORT
    ),
    "nmea-log": Surface(fuzz_files.nmea_log, (b"".join(_SENTENCES),), (b"$", b",", b"*", b"\r\n", b"235959.99")),
    "aiding-csv": Surface(
        fuzz_files.aiding_csv, fuzz_files.TABLES, (b",", b"\n", b"nan", b"1e999", b'"', b"sigma_deg"), tries=_FEW
    ),
    "dialogue": Surface(fuzz_dialogues.dialogue, fuzz_dialogues.EXAMPLES, fuzz_dialogues.WORDS, tries=_FEW),
    "recognise": Surface(
        fuzz_dialogues.recognise, (*_SENTENCES, fuzz_dialogues.GREETING), (b"$", b"\xb5b", b"\x20", b"\r", b"UU")
    ),
    "stream-request": Surface(fuzz_decoders.stream_request, (client.DIVISOR.pack(10), b"")),
    **{
        name: Surface(partial(fuzz_decoders.decode, name), fuzz_decoders.examples(name))
        for name in fuzz_decoders.SENSORS
    },
}
