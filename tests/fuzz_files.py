"""Surfaces beside the devices' bytes and gpsd's protocol: datagrams, RTCM, sysfs, what a restart finds, tables."""

import math
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
from framer_properties import Decoder
from pyrtcm import calc_crc24q
from replay_in_process import new_filter, replay

from imud.compile.hashing import digest_of
from imud.configuration.settings import Gnss, Imu, Initial, Settings
from imud.daemon.checkpoint_file import CheckpointFiles
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.errors import SpecError
from imud.drivers.iio.layout import Layout, LayoutError, layout_of
from imud.drivers.iio.setup import NoTriggerError, commands
from imud.drivers.registry import by_name
from imud.drivers.rtcm import RtcmFramer
from imud.drivers.sample import SAMPLE
from imud.drivers.transport.portspec import PortSpec
from imud.errors import ImudError
from imud.estimators import registry
from imud.estimators.records import FIX, SOLUTION
from imud.folders import boot_id
from imud.pipeline import Filter, Stored
from imud.sensor_errors import calibration, stored_biases
from imud.sensor_errors.profiles import profile_of
from imud.sensors.aiding import DatagramDecoder
from imud.tables.inputs import read_aiding
from imud.tables.nmea_log import fixes_of_log

RATE_HZ, G = 100.0, 9.80665
UNIX_NS = 1_800_000_000 * 10**9
SETTINGS = Settings(imu=Imu(profile="m-g350"))
AT_REST = Initial(lat_deg=48.0, lon_deg=11.0, height_m=500.0, yaw_deg=90.0)


def resting(begin_s: float, seconds: float) -> np.ndarray:
    """Samples (array of SAMPLE) of a level sensor at rest."""
    n = round(seconds * RATE_HZ)
    samples = np.zeros(n, SAMPLE)
    samples["t_ns"] = round(begin_s * 1e9) + np.arange(n) * round(1e9 / RATE_HZ)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (n, 3))
    samples["w"], samples["f"] = noise, noise - (0.0, 0.0, G)
    samples["temperature"] = math.nan
    return samples


def fixes() -> np.ndarray:
    """Fixes (array of FIX), once a second."""
    rows = np.zeros(10, FIX)
    for name in ("sigma", "sigma_v", "v", "hdop", "course"):
        rows[name] = math.nan
    rows["t_ns"] = np.arange(10) * 10**9
    rows["arrival_ns"] = rows["t_ns"] + 10**8
    rows["lat"], rows["lon"], rows["height"] = math.radians(48.0), math.radians(11.0), 500.0
    rows["quality"], rows["satellites"] = 1, 9
    return rows


@cache
def _filter(name: str) -> tuple[Filter, bytes, bytes]:
    """A filter after ten seconds at rest, its state, and its checkpoint."""
    samples = resting(0.0, 10.0)
    filter_ = new_filter(name, samples, SETTINGS, AT_REST)
    replay(filter_, samples, fixes())
    return filter_, filter_.state.tobytes(), filter_.checkpoint()


def _must_be_sane(solutions: np.ndarray) -> None:
    """No infinite number, and no uncertainty below zero; NaN is what is not known."""
    for name in SOLUTION.names or ():
        assert not np.isinf(solutions[name].astype(float)).any(), name
        assert not name.startswith("sigma") or not (solutions[name] < 0.0).any(), name
    assert np.isfinite(solutions["q_nb"]).all()
    assert np.isfinite(solutions["sigma_rpy"]).all()


def aiding(data: bytes) -> None:
    """A datagram, and what the filter makes of it."""
    filter_, state, _ = _filter("navigation")
    filter_.state[:] = np.frombuffer(state, filter_.state.dtype)
    receiver, now_ns = DatagramDecoder(), 10 * 10**9
    for _, measurement in receiver.decode(data[:4096], filter_.estimator.sources, now_ns, UNIX_NS):
        filter_.aid(measurement)
    samples = resting(10.0, 0.3)
    solutions = np.zeros(len(samples), SOLUTION)
    filter_.run(samples, solutions)
    _must_be_sane(solutions)
    receiver.update(now_ns)
    assert msgspec.json.encode([receiver.faults(now_ns), receiver.properties(now_ns), receiver.messages])


def rtcm(data: bytes) -> None:
    """In two chunks and in one: the same frames, whole, in their order."""
    at = len(data) // 3
    counts, framer = Counter[str](), RtcmFramer(Counter[str]())
    whole = list(RtcmFramer(counts).feed(data))
    assert [*framer.feed(data[:at]), *framer.feed(data[at:])] == whole
    assert all(frame[0] == 0xD3 and calc_crc24q(frame) == 0 for frame in whole)
    assert sum(map(len, whole)) + counts["noise bytes"] <= len(data)


def _attributes(data: bytes) -> tuple[dict[str, dict[str, str]], dict[str, dict[str, str]]]:
    """Lines such as `iio:device0/name=chip` as sysfs would have them."""
    found: dict[str, dict[str, str]] = {}
    for line in data.decode("utf-8", "replace").splitlines():
        path, _, value = line.partition("=")
        folder, _, name = path.partition("/")
        if name:
            found.setdefault(folder, {})[name] = value
    devices = {name: one for name, one in found.items() if not name.startswith("trigger")}
    return dict(list(devices.items())[:2]), {name: one for name, one in found.items() if name.startswith("trigger")}


def iio(data: bytes) -> None:
    """What sysfs says of devices and triggers."""
    devices, triggers = _attributes(data)
    if not devices:
        return
    with suppress(LayoutError, NoTriggerError):
        before, begin = commands(devices, triggers, 1000.0)
        assert all("\n" not in name + value for name, value in before + begin)
        layout = layout_of(list(devices.values()))
        assert Layout.from_text(layout.to_text()).to_text() == layout.to_text()
        scans = b"".join(bytes([number]) + bytes(range(256))[:size] for number, size in enumerate(layout.sizes))
        configured = ImuConfigured(Identity("iio", "chip"), RATE_HZ, 10**7, 0, 1, layout=layout.to_text())
        decoder = Decoder(by_name("iio"), configured).feed(scans * 3)
        for sample in decoder.samples:
            assert np.isfinite(sample["w"]).all() and np.isfinite(sample["f"]).all()


def _in_folder(variable: str, name: str, data: bytes, read: Callable[[], None]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / name).write_bytes(data)
        before = os.environ.get(variable)
        os.environ[variable] = folder
        try:
            read()
        finally:
            os.environ.pop(variable) if before is None else os.environ.update({variable: before})


def calibrated(data: bytes) -> None:
    """A calibration file, and samples corrected by it."""

    def read() -> None:
        with suppress(ImudError):
            known = calibration.read(Path(os.environ["STATE_DIRECTORY"]) / "calibration-X.toml")
            corrected = calibration.correction(known, (0.0, 0.0, 0.0))
            filter_ = new_filter("attitude", resting(0.0, 1.0), SETTINGS)
            filter_.correction[:] = corrected
            samples = resting(0.0, 0.3)
            solutions = np.zeros(len(samples), SOLUTION)
            filter_.run(samples, solutions)
            assert np.isfinite(samples["w"]).all() and np.isfinite(samples["f"]).all()
            _must_be_sane(solutions)

    _in_folder("STATE_DIRECTORY", "calibration-X.toml", data, read)


def biases(data: bytes) -> None:
    """Stored biases; BOOT and NOW stand for the right values."""
    nothing = calibration.correction(calibration.Calibration(""), (0.0, 0.0, 0.0))
    now_ns = time.monotonic_ns()
    data = data.replace(b"BOOT", boot_id().encode()).replace(b"NOW", str(now_ns - 10**9).encode())

    def read() -> None:
        found = stored_biases.load("X", nothing, now_ns, profile_of(SETTINGS))
        if found is not None:
            filter_ = new_filter("navigation", resting(0.0, 1.0), SETTINGS)
            filter_.restore_biases(found)
            _must_be_sane(replay(filter_, resting(0.0, 0.3))[0])

    _in_folder("STATE_DIRECTORY", stored_biases._name("X"), data, read)


def checkpoint(data: bytes) -> None:
    """The file of a checkpoint: only one that this machine has written is taken."""

    def read() -> None:
        found = CheckpointFiles("S", "P").take(10**10)
        assert found in (b"", b"as it was")
        assert not list(Path(os.environ["RUNTIME_DIRECTORY"]).iterdir())

    _in_folder("RUNTIME_DIRECTORY", CheckpointFiles("S", "P").names[0], _stamped(data), read)


def _stamped(data: bytes) -> bytes:
    now = time.monotonic_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    data = data.replace(b"BOOT", boot_id().encode())
    return data.replace(b"NOW", str(now[0]).encode()).replace(b"UP", str(now[1]).encode())


def resumed(name: str) -> Callable[[bytes], None]:
    """A checkpoint of a filter, as a recording brings it, that may hold any numbers: first where, then which."""

    def take(data: bytes) -> None:
        _, _, whole = _filter(name)
        at = int.from_bytes(data[:3], "little") % len(whole)
        changed = whole[:at] + data[3:] + whole[at + len(data[3:]) :]
        filter_ = new_filter(name, resting(0.0, 1.0), SETTINGS)
        filter_.restore(Stored(None, changed[: len(whole)]))
        samples = resting(13.0, 0.3)
        solutions = np.zeros(len(samples), SOLUTION)
        filter_.run(samples, solutions)
        later = fixes()[:1]
        later["t_ns"] = later["arrival_ns"] = 13_200_000_000
        filter_.update(later)

    return take


def port(data: bytes) -> None:
    """`--port` of the user."""
    with suppress(SpecError):
        spec = PortSpec.parse(data.replace(b"\0", b"").decode("utf-8", "surrogateescape"))
        assert str(spec) and (spec.baud is None or spec.baud > 0)
        assert PortSpec.parse(str(spec)) == spec
        assert (spec.spi, spec.server, spec.iio).count(None) >= 2


def _file(data: bytes, read: Callable[[Path], object]) -> None:
    with tempfile.NamedTemporaryFile() as file:
        file.write(data)
        file.flush()
        with suppress(ImudError):
            read(Path(file.name))


def nmea_log(data: bytes) -> None:
    """A receiver's log for `imud replay --gnss`."""
    _file(data, lambda path: fixes_of_log(path, 0, 0, Gnss()))


def aiding_csv(data: bytes) -> None:
    """A table for `imud replay --aiding`, of each source."""
    for source in registry.by_name("navigation").sources:
        _file(data, lambda path, source=source: read_aiding(source, path, 0))


_CALIBRATION = calibration.Calibration(
    "X",
    calibration.Gyro("2026-11-23", (0.01, 0.0, -0.01), (1e-4,) * 3, 25.0, (1e-5,) * 3, (1e-6,) * 3),
    calibration.Accelerometer(
        "2026-11-23", (0.1, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.01,) * 3, 0.01, 6
    ),
    calibration.Mounting("2026-11-23", (0.0, 0.0, 90.0), (0.1,) * 3),
)
CALIBRATIONS = (calibration._toml(_CALIBRATION).encode(),)
BIASES = (
    b'{"serial":"X","boot_id":"BOOT","monotonic_ns":NOW,"correction":'
    + msgspec.json.encode(stored_biases._numbers(calibration.correction(calibration.Calibration(""), (0.0, 0.0, 0.0))))
    + b',"biases":{"gyro_radps":[0,0,0],"gyro_sigma_radps":[1e-4,1e-4,1e-4],"accel_mps2":[0,0,0],'
    b'"accel_sigma_mps2":[0.01,0.01,0.01]}}',
)
CHECKPOINTS = (
    b'{"sensor":"S","port":"P","boot_id":"BOOT","monotonic_ns":NOW,"boottime_ns":UP,"digest":"'
    + digest_of(b"as it was").encode()
    + b'"}\nas it was',
)
CHANGES = (b"\0\0\0", b"\x40\0\0" + b"\xff" * 8, b"\x80\0\0" + np.float64(math.nan).tobytes())
TABLES = (b"t_s,heading_deg,sigma_deg\n0.5,48.0,1.0\n", b"t_s,speed_mps,arrival_s\n0.5,1.0,0.7\n")
DATAGRAMS = (
    b'{"class":"POSE","lat":48.0,"lon":11.0,"height":500.0,"yaw":90,"sn":0.1,"se":0.1,"sd":0.1,"syaw":1}\n',
    b'{"class":"VEL","vn":0,"ve":0,"vd":0,"svn":0.1}\n{"class":"BODYVEL","vx":0,"vy":0,"vz":0,"svx":0.1}\n',
    b'{"class":"HDG","heading":123.4,"sigma":0.3,"t":1800000000.0}\n{"class":"MAG","x":20,"y":1,"z":40,"sigma":1}\n',
    b'{"class":"ODO","speed":1.5,"sigma":0.1}\n',
    b'{"class":"BARO","pressure":95000.0}\n{"class":"BARO","height":500.0,"sigma":1.0}\n',
)
SYSFS = (
    b"iio:device0/name=chip\niio:device0/in_anglvel_scale=0.001\niio:device0/in_accel_scale=0.01\n"
    b"iio:device0/sampling_frequency=100\niio:device0/sampling_frequency_available=100 200 400\n"
    b"iio:device0/current_timestamp_clock=realtime\niio:device0/trigger/current_trigger=\n"
    b"iio:device0/mount_matrix=1, 0, 0; 0, 1, 0; 0, 0, 1\niio:device0/in_temp_scale=1\niio:device0/in_temp_offset=5\n"
    + b"".join(
        b"iio:device0/scan_elements/in_%s_%s=%s\n" % (name, part, value)
        for i, name in enumerate((*(b"%s_%c" % (q, a) for q in (b"anglvel", b"accel") for a in b"xyz"), b"timestamp"))
        for part, value in (
            (b"en", b"1"),
            (b"index", b"%d" % i),
            (b"type", b"le:s64/64>>0" if name == b"timestamp" else b"be:s16/16>>0"),
        )
    )
    + b"trigger0/name=chip-dev0\ntrigger1/name=timer\ntrigger1/sampling_frequency=100\n",
)
