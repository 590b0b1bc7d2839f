"""How long a receiver may be silent: one that sends rarely, but regularly, is kept; what has ended is not."""

import pytest
from nmea_lines import gga
from ubx_messages import eoe, message, pvt

from imud.configuration.settings import Gnss
from imud.drivers.registry import by_name
from imud.sensors.receiver import Receiver
from imud.sensors.silence import SILENCE_NS, SLOWEST_NS, SilenceLimit

SECOND = 1_000_000_000
STALE = "receiver: stale, nothing new comes"


def burst(limit, at_s, length_s=0.4):
    """Five sentences."""
    for k in range(5):
        limit.add(round((at_s + k * length_s / 4) * SECOND), True)


def silences(limit, bursts):
    """After each burst, how long the stream may be silent, in s; and whether it was kept until the next one."""
    found = []
    for at_s in bursts:
        kept = at_s * SECOND - limit.last_ns < limit.limit_ns
        burst(limit, at_s)
        found.append((limit.limit_ns / SECOND, kept))
    return found


@pytest.mark.parametrize("period_s", [0.1, 0.2, 1, 1.9])
def test_a_receiver_of_every_second_is_away_after_five_seconds(period_s):
    limit = SilenceLimit(0)
    found = silences(limit, [k * period_s for k in range(1, round(30 / period_s))])
    assert all(kept for _, kept in found)
    assert {limit_s for limit_s, _ in found[round(6 / period_s) :]} == {SILENCE_NS / SECOND}


@pytest.mark.parametrize("period_s", [5, 7, 10, 30, 60])
@pytest.mark.parametrize("first_s", [0.0, 0.9])
def test_a_receiver_of_a_long_period_is_kept_also_if_a_burst_is_lost(period_s, first_s):
    found = silences(SilenceLimit(0), [first_s + period_s * k for k in (0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14)])
    assert all(kept for _, kept in found)
    assert all(limit_s <= 2.5 * 2 * period_s + 5 for limit_s, _ in found[1:])


def test_one_whose_period_is_a_long_one_no_more_is_away_as_soon_as_any():
    limit = SilenceLimit(0)
    silences(limit, range(1, 62, 10))
    assert limit.limit_ns > 20 * SECOND
    silences(limit, range(62, 300))
    assert limit.limit_ns == SILENCE_NS


def test_before_a_stream_has_shown_its_period_it_has_the_time_of_the_slowest():
    limit = SilenceLimit(0)
    assert limit.limit_ns == SLOWEST_NS
    burst(limit, 0.2)
    assert limit.limit_ns == SLOWEST_NS


@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_a_receiver_of_every_second_is_known_for_one_before_its_first_five_seconds_are_over(period_s):
    """Then a spare takes over as soon as at any other time, also after each reconnection of a loose line."""
    limit = SilenceLimit(0)
    silences(limit, [k * period_s for k in range(round(2.6 / period_s))])
    assert limit.limit_ns == SILENCE_NS and limit.period_ns == 0


@pytest.mark.parametrize("first_s", [1, 4])
def test_a_single_pause_is_no_period(first_s):
    limit = SilenceLimit(0)
    silences(limit, [*range(first_s), *range(first_s + 50, first_s + 54)])
    assert limit.limit_ns == SILENCE_NS and limit.period_ns == 0


@pytest.mark.parametrize("period_s", [10, 30])
def test_a_slow_receiver_is_kept_from_its_first_period_on(period_s):
    limit = SilenceLimit(0)
    burst(limit, 0.1)
    assert limit.limit_ns > period_s * SECOND
    burst(limit, 0.1 + period_s)
    assert 2 * period_s * SECOND < limit.limit_ns <= 2.5 * period_s * SECOND


def test_what_never_comes_at_equal_times_does_not_make_the_limit_grow_for_ever():
    limit, at_s = SilenceLimit(0), 0.0
    for k in range(1, 20):
        at_s += 2.4**k
        burst(limit, at_s)
    assert limit.limit_ns == 2.5 * SLOWEST_NS
    silences(limit, [at_s + k for k in range(1, 700)])
    assert limit.limit_ns == SILENCE_NS


def test_bytes_of_no_use_are_no_silence():
    """Another device at the same adapter; the rest of a burst, and the first bytes of the next one, are none."""
    limit = SilenceLimit(0)
    silences(limit, range(1, 62, 10))
    limit.add(limit.last_ns + SECOND // 2, False)  # RTCM after the sentences
    assert limit.limit_ns > 20 * SECOND
    limit.add(limit.last_ns + 10 * SECOND, False)  # the next burst begins
    assert limit.limit_ns == 15 * SECOND
    burst(limit, 71)
    assert limit.limit_ns > 20 * SECOND
    for k in range(100):
        limit.add(limit.last_ns + 2 * SECOND + k * SECOND // 10, False)
    assert limit.limit_ns == 7 * SECOND


def test_a_receiver_of_each_tenth_second_is_well_until_it_ends():
    receiver, faults = Receiver(by_name("nmea"), Gnss(), 0), {}
    for second in range(100):
        if second % 10 == 9 and second < 80:
            receiver.feed(gga(f"12{second // 60:02d}{second % 60:02d}.000"), second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
        faults[second] = receiver.faults(second * SECOND + SECOND // 2)
    assert receiver.fix_count == 8
    assert [second for second in range(10, 100) if faults[second]] == list(range(79 + 15, 100))
    assert faults[99] == (STALE,) and receiver.out_of_limits(99 * SECOND) == ("gnss_age_s",)
    assert receiver.last_data_ns + receiver.silence_ns == (79 + 25) * SECOND


def test_a_receiver_of_two_protocols_is_away_when_its_positions_end_and_other_messages_go_on():
    """A u-blox that was reset sends NMEA again, and what it keeps in its flash."""
    receiver = Receiver(by_name("ubx"), Gnss(), 0)
    for second in range(30):
        at_ns, itow = second * SECOND, 1000 * second
        positions = pvt(itow) + eoe(itow) if second < 10 else gga(f"1200{second:02d}.000")
        receiver.feed(positions + message("NAV", "NAV-SAT", iTOW=itow, version=1, numSvs=0), at_ns)
        receiver.flush(at_ns + SECOND // 2)
    assert receiver.last_data_ns + receiver.silence_ns == 14 * SECOND


def test_messages_beside_the_positions_of_a_slow_receiver_do_not_shorten_its_period():
    receiver = Receiver(by_name("ubx"), Gnss(), 0)
    for second in range(61):
        itow = 1000 * second
        positions = pvt(itow) + eoe(itow) if second % 10 == 0 else b""
        receiver.feed(positions + message("NAV", "NAV-SAT", iTOW=itow, version=1, numSvs=0), second * SECOND)
    assert receiver.last_data_ns + receiver.silence_ns == 85 * SECOND
