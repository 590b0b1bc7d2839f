"""Recordings of emulated devices in simulated time: minutes in seconds, with a daemon's bytes and arrivals."""

import msgspec
import numpy as np
from emulated import Emulated
from scripted import run

from imud.drivers.capture_messages import READS, Connection, Raw, Reads, to_builtins
from imud.drivers.detect import detect
from imud.drivers.driver import Options
from imud.drivers.registry import by_name
from imud.firmware_sim.g350 import G350
from imud.firmware_sim.noise import IDEAL, M_G350, ImuErrors
from imud.recording.file import RecordingFile
from imud.recording.measurements import measurement_object
from imud.recording.messages import AIDING

STEP_S = 0.016
TICK_HZ = 2000.0
MESSAGE_READS = 64  # about a second's, as the daemon writes them


def record(path, signal, seconds, ideal=False, rate_hz=125.0, gap_s=(0.0, 0.0), settings=b"{}", aiding=(), **biases):
    """What a G350 says that feels `signal`; from when to when nothing of it is recorded. biases: of `ImuErrors`.

    settings: of the daemon, JSON; aiding: names of sources and rows of MEASUREMENT, in order of arrival.
    """
    errors = ImuErrors(IDEAL if ideal else M_G350, np.random.default_rng(3), TICK_HZ, **biases)
    wire = Emulated(G350(signal, errors))
    found, _ = run(detect(), wire)
    driver = by_name(found.driver)
    configured, _ = run(driver.configure(found, Options(rate_hz=rate_hz)), wire)
    file = RecordingFile(path, {"version": "0", "session": path.stem}, settings, 0)
    connection = Connection(_ns(wire), 0, "/dev/emulated", True, "imu", driver.name, to_builtins(configured))
    file.write("/connections", _ns(wire), msgspec.json.encode(connection))
    wire.outgoing.clear()
    begin, reads = wire.now_s, []
    while wire.now_s - begin < seconds:
        wire.pass_time(STEP_S)
        data = bytes(wire.outgoing)
        wire.outgoing.clear()
        if not gap_s[0] <= wire.now_s - begin < gap_s[1]:
            reads.append((0, Raw(_ns(wire), data)))
    arrivals = [int(row["arrival_ns"]) for _, row in aiding]
    ends = np.searchsorted([raw.t_ns for _, raw in reads], arrivals).tolist()  # a message ends where a measurement came
    begin = 0
    for end, measured in [*zip(ends, aiding, strict=True), (len(reads), None)]:
        for first in range(begin, end, MESSAGE_READS):
            message = reads[first : min(first + MESSAGE_READS, end)]
            file.write(READS, message[0][1].t_ns, Reads.of(message).encode())
        if measured is not None:
            data = msgspec.json.encode(measurement_object(*measured))
            file.write(AIDING, int(measured[1]["arrival_ns"]), data)
        begin = end
    file.finish()
    return configured.identity


def _ns(wire):
    return round((100.0 + wire.now_s) * 1e9)
