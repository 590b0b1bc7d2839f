"""The pulse per second: the kernel's sysfs in a folder, and epochs that are exact whatever the latency."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imud.clocks.epochs import EpochClock
from imud.commands import main
from imud.configuration.settings import Gnss
from imud.drivers.errors import PortAbsentError
from imud.drivers.registry import by_name
from imud.drivers.transport.pps import PulsePerSecond
from imud.sensors.receiver import Receiver

SECOND_NS = 1_000_000_000
REAL_NS = 1_700_000_000 * SECOND_NS


@pytest.fixture
def sysfs(tmp_path):
    (tmp_path / "pps0").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("text", "age_ns"),
    [
        ("1699999999.900000001#17\n", 99_999_999),
        ("1700000000.000000000#1", 0),
        ("1699999998.400000000#3", None),  # it stopped
        ("1700000001.000000000#3", None),  # the clock was stepped back
        ("", None),  # no pulse yet
        ("rubbish", None),
    ],
)
def test_the_newest_pulse(sysfs, text, age_ns):
    (sysfs / "pps0/assert").write_text(text)
    pulse = PulsePerSecond("/dev/pps0", sysfs, lambda: (REAL_NS, 5_000))
    for _ in range(2):  # the file is read anew each time
        assert pulse.newest_ns() == (None if age_ns is None else 5_000 - age_ns)
    pulse.close()


def test_one_that_is_absent_is_named_with_those_present(sysfs, capsys):
    with pytest.raises(PortAbsentError, match=r"no /dev/pps7; present: /dev/pps0.*pps-gpio"):
        PulsePerSecond("/dev/pps7", sysfs)
    assert main(["run", "--port", "/dev/null", "--set", "gnss.pps=/dev/pps99"]) == 69
    assert "/dev/pps99" in capsys.readouterr().err


@given(st.integers(0, 86_399_999), st.integers(1, SECOND_NS - 1), st.integers(0, 3), st.integers(-(10**15), 10**15))
def test_the_epoch_is_exact_whatever_the_latency(utc_ms, latency_ns, seconds_old, origin_ns):
    epoch_ns = origin_ns + utc_ms * 1_000_000
    pulse_ns = origin_ns + (utc_ms // 1000 - seconds_old) * SECOND_NS
    assert EpochClock(0.15).epoch_ns(utc_ms / 1000.0, epoch_ns + latency_ns, pulse_ns) == epoch_ns


@pytest.mark.parametrize(("pulsed", "error_ns"), [(False, 250_000_000), (True, 0)])
def test_fixes_of_a_slow_receiver(sysfs, pulsed, error_ns):
    """400 ms of latency where 150 are assumed."""
    now_ns = [0]
    (sysfs / "pps0/assert").touch()
    pulse = PulsePerSecond("pps0", sysfs, lambda: (REAL_NS + now_ns[0], now_ns[0])) if pulsed else None
    receiver = Receiver(by_name("nmea"), Gnss(), 0, pulse)
    errors = []
    for second in range(1, 6):
        now_ns[0] = second * SECOND_NS + 400_000_000
        (sysfs / "pps0/assert").write_text(f"{REAL_NS // SECOND_NS + second}.000000000#{second}")
        body = f"GPGGA,1200{second:02d}.00,4700.0000,N,00800.0000,E,1,09,0.9,400.0,M,48.0,M,,"
        checksum = np.bitwise_xor.reduce(np.frombuffer(body.encode(), np.uint8))
        fixes = receiver.feed(f"${body}*{checksum:02X}\r\n".encode(), now_ns[0])
        now_ns[0] += 300_000_000
        turn_ns = now_ns[0]
        now_ns[0] += 40_000_000  # what else was to be done in this turn of the loop
        fixes += receiver.flush(turn_ns)
        errors += [int(fix["t_ns"][0]) - second * SECOND_NS for fix in fixes]
    assert len(errors) >= 4
    assert set(errors) == {error_ns}
