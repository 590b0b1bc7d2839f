"""Emulated devices behind faulty lines in memory: what they sent, what arrived, and what a driver made of it."""

import argparse
from dataclasses import dataclass

import numpy as np
from in_c import in_c

from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.registry import by_name
from imud.drivers.sample import SAMPLE, SUSPECT
from imud.firmware_sim import build, cli
from imud.firmware_sim.faults import spec

STEP_S = 0.004


@dataclass(frozen=True)
class Message:
    """One, as it was sent and as it arrived; `fault` is empty where that is the same."""

    t: float
    fault: str
    sent: bytes
    came: bytes


class Log(list):
    """In place of the emulator's `WireLog`."""

    def write(self, t, device, fault, sent, came):
        self.append(Message(t, fault, sent, came))


def emulated(device, *options, faults=""):
    """(device, log) as the command line builds them, and what `--faults` does to it."""
    parser = argparse.ArgumentParser(allow_abbrev=False)
    cli.add_arguments(parser)
    args = parser.parse_args([device, *map(str, options)])
    log = Log()
    parsed = spec.parse(faults, [args.devices[0][0]])[0]
    return build.device(args, build.scene(args), 1.7e9, 0, parsed, log), log


def play(device, seconds, commands=(), begin=0.0):
    """Chunks (time, bytes) that a host hears; commands: (time, bytes) that it sends."""
    waiting, chunks = list(commands), []
    for step in range(round(begin / STEP_S), round(seconds / STEP_S) + 1):
        t = step * STEP_S
        while waiting and waiting[0][0] <= t:
            device.receive(waiting.pop(0)[1], t)
        device.advance(t)
        if data := device.uart.take(t, device.uart.baud):
            chunks.append((t, data))
    return chunks


def registers(text):
    """Writes at one time: address and value in hex."""
    return b"".join(bytes.fromhex(pair) + b"\r" for pair in text.split())


FLAT = registers("B701 B801 BA01 D001 B901")
WINDOWED = registers("FE01 8501 8601 8C03 8DF0 8F70 8801 FE00 8301")
# emulated device, driver, model, samples/s, bytes of a frame, what starts it and when
STREAMS = {
    "g350": ("epson", "M-G350-PD11", 1000.0, 22, [(1.0, FLAT)]),
    "g370": ("epson", "M-G370PDF1", 1000.0, 36, [(1.0, WINDOWED)]),
    "rga300": ("crossbow", "RGA300CA", 100.0, 24, [(0.5, b"C")]),
    "seraccel": ("seraccel", "", 100.0, 0, []),
}


def decode(name, chunks):
    """Samples (SAMPLE) that the device's driver makes of the bytes, and its counters."""
    driver_name, model, rate_hz, length, _ = STREAMS[name]
    driver = by_name(driver_name)
    period_ns = round(1e9 / rate_hz)
    configured = ImuConfigured(Identity(driver_name, model), rate_hz, period_ns, 0, length)
    state, rx, samples = driver.new_state(configured), np.zeros(65536, np.uint8), np.zeros(512, SAMPLE)
    taken, fill = [], 0
    for _, data in chunks:
        rx[fill : fill + len(data)] = np.frombuffer(data, np.uint8)
        n = in_c(driver.decode)(rx, fill + len(data), state, samples)
        fill = int(state["leftover"][0])
        taken.append(samples[:n].tobytes())
    counters = {field: int(state[field][0]) for field in ("frames", "junk", "bad", "lost", "suspect")}
    return np.frombuffer(b"".join(taken), SAMPLE), counters


def matched(reference, samples):
    """For each of `reference`, the index of the same sample in `samples`, in order; -1: it is not there."""
    found, at = [], 0
    values = np.hstack([samples["w"], samples["f"]])
    for row in np.hstack([reference["w"], reference["f"]]):
        same = np.flatnonzero((values[at : at + 400] == row).all(axis=1))
        found.append(at + same[0] if len(same) else -1)
        at = found[-1] + 1 if len(same) else at
    return np.array(found)


def fates(name, faults, seconds, *options):
    """What became of the frames: counts of those sent `good` and `damaged`, of good ones `lost` and `suspected`.

    Also all `samples` that the driver gave.
    """
    device, log = emulated(name, *options, faults=faults)
    chunks = play(device, seconds, STREAMS[name][4])
    samples, _ = decode(name, chunks)
    frames = [m for m in log if is_frame(name, m.sent)]
    intact = [m for m in frames if m.came.endswith(m.sent)]  # behind junk, too
    reference, _ = decode(name, [(m.t, m.sent) for m in intact])
    found = matched(reference, samples)
    suspect = samples["flags"][found[found >= 0]] & SUSPECT != 0
    return {
        "good": len(reference),
        "damaged": len(frames) - len(intact),
        "lost": int((found < 0).sum()),
        "suspected": int(suspect.sum()),
        "samples": samples,
    }


def is_frame(name, message):
    """Whether it is a sample, not an answer or a text."""
    if name == "seraccel":
        return message.startswith(b"X=")
    length = STREAMS[name][3]
    return len(message) == length
