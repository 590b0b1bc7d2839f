"""A recording as a daemon makes it, of the vehicle in `signals`, but written as fast as it goes."""

import math
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from imud.drivers.capture_messages import CONNECTIONS, READS, Connection, Entry, Raw, Reads, to_builtins
from imud.drivers.driver import GnssConfigured, Identity, ImuConfigured
from imud.firmware_sim import sentences
from imud.firmware_sim.fixes import Fix

from ... import __version__
from ...configuration.settings import Initial, Record, Settings
from ...math.arrays import Records
from ...recording.clock_fit import row_of
from ...recording.player import Handlers, Player
from ...recording.protocol import MessageKind
from ...recording.writer import RecordingWriter
from . import signals

IMU, GNSS = range(2)  # ports
START_NS, START_UTC = 1_000_000_000_000, 1_700_000_000.0  # of the first sample
_LATE_NS = 30_000.0  # mean of what an arrival is later than at best
_CONFIGURED: dict[int, ImuConfigured | GnssConfigured] = {
    IMU: ImuConfigured(Identity("epson", "M-G350"), float(signals.RATE_HZ), 1_000_000, 0, signals.FRAME),
    GNSS: GnssConfigured(Identity("nmea", "")),
}


def _reports(seconds: int) -> list[tuple[int, bytes]]:
    """Arrivals, ns, and bytes of the receiver's epochs."""
    found = []
    for row in signals.fixes(seconds):
        t, arrival = float(row["t_ns"]) * 1e-9, float(row["arrival_ns"]) * 1e-9
        place = math.degrees(row["lat"]), math.degrees(row["lon"]), float(row["height"])
        fix = Fix(t, arrival, *place, float(row["speed"]), math.degrees(row["course"]), 1.0)
        epoch = sentences.Epoch(START_UTC + t, fix, True)
        texts = [text for form in (sentences.gga, sentences.rmc, sentences.vtg) for text in form(epoch)]
        found.append((START_NS + int(row["arrival_ns"]), b"".join(map(sentences.with_checksum, texts))))
    return found


def _reads(seconds: int) -> Iterator[list[tuple[int, Raw]]]:
    """What is read from the ports, second by second: a frame at a time, as from a PTY."""
    frames, rate = signals.frames(seconds * signals.RATE_HZ), signals.RATE_HZ
    arrivals = START_NS + np.arange(len(frames), dtype=np.int64) * (1_000_000_000 // rate)
    arrivals += np.random.default_rng(2).exponential(_LATE_NS, len(frames)).astype(np.int64)
    reports = _reports(seconds)
    for first in range(0, len(frames), rate):
        rows = zip(arrivals[first : first + rate].tolist(), frames[first : first + rate], strict=True)
        reads = [(IMU, Raw(t_ns, frame.tobytes())) for t_ns, frame in rows]
        while reports and reports[0][0] <= arrivals[first : first + rate][-1]:
            reads.append((GNSS, Raw(*reports.pop(0))))
        yield sorted(reads, key=lambda read: read[1].t_ns)


def write_recording(path: Path, seconds: int) -> None:
    """With raw bytes, estimates, samples and innovations as by the default settings."""
    settings = Settings(record=Record(path=str(path)), ports=("/dev/imu", "/dev/gnss"))
    facts = {"session": "bench", "version": __version__}
    start = {"record": settings.record, "facts": facts, "ports": settings.ports, "settings": settings}
    writer = RecordingWriter(msgspec.json.decode(msgspec.json.encode(start)), lambda *line: None)
    known: list[tuple[MessageKind, Records]] = []

    def on_step(samples: Records, solutions: Records) -> None:
        known.extend([(MessageKind.SAMPLES, samples.copy()), (MessageKind.SOLUTIONS, solutions.copy())])

    def on_update(fix: Records, innovations: Records) -> None:
        known.extend([(MessageKind.FIX, fix.copy()), (MessageKind.INNOVATIONS, innovations.copy())])

    player = Player(settings, lambda recorded: settings, Initial(), Handlers(on_step, on_update))
    for port, configured in _CONFIGURED.items():
        kind, driver = ("imu", "epson") if port == IMU else ("gnss", "nmea")
        connection = Connection(START_NS, port, settings.ports[port], True, kind, driver, to_builtins(configured))
        data = msgspec.json.encode(connection)
        player.take(Entry(CONNECTIONS, "", START_NS, data))
        writer.take(MessageKind.CONNECTION, port, START_NS, data)
    for reads in _reads(seconds):
        for port, raw in reads:
            writer.take(MessageKind.RAW, port, raw.t_ns, raw.data)
        player.take(Entry(READS, "", START_NS, Reads.of(reads).encode()))
        assert player.inertial is not None
        known.append((MessageKind.CLOCK, row_of(player.inertial, IMU, player.now_ns)))
        for message, rows in known:
            writer.take(message, IMU, int(rows[0]["t_ns"]), rows.tobytes())
        known.clear()
        writer.commit()
    writer.finish()
