"""A gpsd that plays logs of receivers by gpsd's own gpsfake, as our receiver. Skipped where there is none.

The logs are bursts of our own, in the styles of receivers; gpsd's own collection of real logs was played the same way.
"""

import contextlib
import itertools
import os
import subprocess
import time

import pytest
from gpsd_programs import program
from nmea_lines import gga, rmc
from test_gpsd_real import free_port
from test_nmea_receivers import Burst

from imud.drivers.detect import search
from imud.drivers.driver import GnssConfigured, Options
from imud.drivers.errors import PortAbsentError, PortLostError
from imud.drivers.gpsd.decoder import GpsdDecoder
from imud.drivers.registry import by_name
from imud.drivers.transport.dialogue_runner import run_dialogue
from imud.drivers.transport.line import open_line
from imud.drivers.transport.portspec import PortSpec

EPOCHS = 600  # it plays from its start on: the log has to last until a busy machine has connected
FIXES = 30
LIMIT_S = 120.0  # against hanging


@contextlib.contextmanager
def playing(*logs):
    """A connection to a gpsd that plays the logs once."""
    spec = PortSpec.parse(f"gpsd://127.0.0.1:{free_port()}")
    port = str(spec.server[1])
    command = [program("gpsfake"), "-1", "-q", "-P", port, "-c", "0.02", *map(str, logs)]
    env = {**os.environ, "WRITE_PAD": "0.005", "PATH": f"{os.environ.get('PATH', '')}:/usr/sbin"}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=env) as process:
        try:
            end = time.monotonic() + LIMIT_S
            line = None
            while line is None:
                assert process.poll() is None and time.monotonic() < end, "gpsfake does not listen"
                with contextlib.suppress(PortAbsentError):
                    line = open_line(spec)
                time.sleep(0.05)
            found = run_dialogue(line, search(spec))
            configured = None
            while not isinstance(configured, GnssConfigured):  # as the daemon, which tries again and again
                configured = run_dialogue(line, by_name("gpsd").configure(found, Options()))
                assert time.monotonic() < end, configured
            yield line
            end_of(process)
            with pytest.raises(PortLostError, match="ended the connection"):
                while line.read() or process.poll() is not None:
                    pass
            line.close()
        finally:
            end_of(process)


def end_of(process):
    """End gpsfake: it ends its gpsd on a signal, and itself not always."""
    process.terminate()
    try:
        process.wait(3.0)
    except subprocess.TimeoutExpired:
        process.kill()


def fixes_of(line, are_all):
    """The fixes until `are_all` is true of them; and the decoder."""
    decoder, fixes, end = GpsdDecoder(), [], time.monotonic() + LIMIT_S
    while not are_all(fixes):
        assert time.monotonic() < end, decoder.counters
        fixes += decoder.feed(line.read(), time.monotonic_ns())
        time.sleep(0.002)
    return fixes, decoder


@pytest.mark.thorough
@pytest.mark.parametrize("style", ["mtk-3301", "quectel-LC79D", "nmea-rtk, 10 Hz"])
def test_the_fixes_are_those_of_the_log(tmp_path, style):
    log = tmp_path / "receiver.log"
    bursts = [Burst(style, k) for k in range(EPOCHS)]
    log.write_bytes(b"".join(line for burst in bursts for line in burst.lines))
    with playing(log) as line:
        fixes, _ = fixes_of(line, lambda fixes: len(fixes) >= FIXES)
    said = {round(burst.utc_s, 3): burst for burst in bursts}
    epochs = [bursts.index(said[round(fix.utc_s, 3)]) for fix in fixes]
    assert all(b - a == 1 for a, b in itertools.pairwise(epochs)), "each epoch once"
    assert fixes[-1].dimensions == 3
    for fix, burst in zip(fixes, (bursts[k] for k in epochs), strict=True):
        assert (fix.lat_deg, fix.lon_deg) == pytest.approx((burst.lat, burst.lon), abs=2e-8)
        assert fix.dimensions == 2 or fix.alt_msl_m == pytest.approx(burst.alt, abs=0.05)  # the first may be
        assert fix.speed_mps is None or fix.speed_mps == pytest.approx(burst.kmh / 3.6, abs=0.01)


@pytest.mark.thorough
def test_of_two_receivers_one_counts_and_the_other_takes_over(tmp_path):
    """Both play at once; the first is the one that ends early."""
    short, long = tmp_path / "short.log", tmp_path / "long.log"
    short.write_bytes(b"".join(line for k in range(90) for line in Burst("nmea-rtk, 10 Hz", k).lines))
    times = [f"12{k // 60:02d}{k % 60:02d}.000" for k in range(330)]
    long.write_bytes(b"".join(gga(time_of_day) + rmc(time_of_day, motion="10.0,90.0") for time_of_day in times))
    with playing(short, long) as line:
        fixes, decoder = fixes_of(line, lambda fixes: fixes and fixes[-1].utc_s == 43_200.0 + 320)
    from_long = [abs(fix.lat_deg - (48 + 7.038 / 60)) < 1e-6 for fix in fixes]
    changes = sum(a != b for a, b in itertools.pairwise(from_long))
    assert from_long[-1] and changes <= 1, from_long
    assert decoder.counters["other device"] > 0
