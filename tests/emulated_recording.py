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

STEP_S = 0.016
TICK_HZ = 2000.0
MESSAGE_READS = 64  # about a second's, as the daemon writes them


def record(path, signal, seconds, ideal=False, rate_hz=125.0, gap_s=(0.0, 0.0), **biases):
    """What a G350 says that feels `signal`; from when to when nothing of it is recorded. biases: of `ImuErrors`."""
    errors = ImuErrors(IDEAL if ideal else M_G350, np.random.default_rng(3), TICK_HZ, **biases)
    wire = Emulated(G350(signal, errors))
    found, _ = run(detect(), wire)
    driver = by_name(found.driver)
    configured, _ = run(driver.configure(found, Options(rate_hz=rate_hz)), wire)
    file = RecordingFile(path, {"version": "0", "session": path.stem}, b"{}", 0)
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
    for first in range(0, len(reads), MESSAGE_READS):
        message = reads[first : first + MESSAGE_READS]
        file.write(READS, message[0][1].t_ns, Reads.of(message).encode())
    file.finish()
    return configured.identity


def _ns(wire):
    return round((100.0 + wire.now_s) * 1e9)
