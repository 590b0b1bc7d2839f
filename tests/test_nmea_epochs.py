"""Epochs: which sentences make one fix, and when it is ready."""

from datetime import date
from fractions import Fraction

import pytest
from nmea_lines import decode, gga, line, rmc, vtg

from imud.drivers.nmea.burst_silence import SILENCE_NS
from imud.drivers.nmea.decoder import NmeaDecoder


class Receiver:
    """Feeds bursts to a decoder a second apart, each sentence 20 ms after the other; flushes in between."""

    def __init__(self, flush=True):
        self.decoder, self.now_ns, self.flush = NmeaDecoder(), 10**12, flush
        self.fixes = []

    def burst(self, *sentences):
        """Indices of the sentences that completed a fix; -1: the flush."""
        begin_ns, completed = self.now_ns, []
        for i, sentence in enumerate(sentences):
            self.now_ns += 20_000_000
            for fix in self.decoder.feed(sentence, self.now_ns):
                self.fixes.append(fix)
                completed.append(i)
        self.now_ns = begin_ns + 10**9
        if self.flush:
            for fix in self.decoder.flush(self.now_ns - 20_000_000):
                self.fixes.append(fix)
                completed.append(-1)
        return completed


def at(k):
    return f"{120000 + k}.000"


def slow_rmc(time):
    """Without speed and course, so that VTG has to give them."""
    return rmc(time, motion=",")


def test_the_sentence_that_ends_a_burst_is_learned():
    receiver = Receiver()
    completed = [receiver.burst(gga(at(k)), slow_rmc(at(k)), vtg(kmh=str(k))) for k in range(5)]
    assert completed == [[-1], [-1], [2], [2], [2]]
    assert [fix.utc_s for fix in receiver.fixes] == [43200 + k for k in range(5)]
    assert [fix.speed_mps for fix in receiver.fixes] == [float(Fraction(k) * 10 / 36) for k in range(5)]
    assert {fix.date for fix in receiver.fixes} == {date(1994, 3, 23)}
    assert receiver.fixes[0].arrival_ns == 10**12 + 20_000_000
    assert receiver.fixes[3].arrival_ns == 10**12 + 3 * 10**9 + 20_000_000


@pytest.mark.parametrize("flush", [True, False])
@pytest.mark.parametrize(
    "order", [(gga,), (rmc,), (gga, rmc), (rmc, gga), (gga, vtg), (vtg, gga), (rmc, vtg, gga), (gga, rmc, vtg)]
)
def test_any_order_of_sentences_gives_each_epoch_once_with_its_own_speed(order, flush):
    receiver = Receiver(flush)
    for k in range(6):
        make = {gga: lambda: gga(at(k)), vtg: lambda: vtg(kmh=str(k)), rmc: lambda: slow_rmc(at(k))}  # noqa: B023
        receiver.burst(*[make[kind]() for kind in order])
    receiver.fixes += receiver.decoder.flush(receiver.now_ns)
    assert [fix.utc_s for fix in receiver.fixes] == [43200 + k for k in range(6)]
    if vtg in order:  # the very first sentence may be the end of a burst
        assert [fix.speed_mps for fix in receiver.fixes][1:] == [float(Fraction(k) * 10 / 36) for k in range(1, 6)]


def played(bursts, gap_s):
    """Fixes with the times at which they were ready, of bursts a second apart: each sentence `gap_s` after the other.

    The decoder is asked every 20 ms whether an epoch has ended by silence, as by the daemon.
    """
    decoder, ready = NmeaDecoder(), []
    due = [(k + i * gap_s, one) for k, burst in enumerate(bursts) for i, one in enumerate(burst) if one]
    for step in range(50 * len(bursts) + 50):
        now_s = step / 50
        while due and due[0][0] <= now_s:
            ready += [(fix, now_s) for fix in decoder.feed(due.pop(0)[1], 10**12 + round(now_s * 1e9))]
        ready += [(fix, now_s) for fix in decoder.flush(10**12 + round(now_s * 1e9))]
    return ready, decoder.counters


@pytest.mark.parametrize("order", [(gga, vtg, rmc), (rmc, vtg, gga), (gga, rmc, vtg), (rmc, gga)])
@pytest.mark.parametrize("gap_s", [0.2, 0.24, 0.3])
def test_sentences_that_a_multiplexer_passes_on_one_by_one_are_of_one_epoch(order, gap_s):
    """Less than half of the second is between two bursts, so that VTG, which has no time, is of the burst before it."""
    make = {gga: gga, vtg: lambda time: vtg(), rmc: rmc}
    fixes = [fix for fix, _ in played([[make[kind](at(k)) for kind in order] for k in range(40)], gap_s)[0]]
    assert [fix.utc_s - 43200 for fix in fixes] == list(range(40))
    assert all(fix.speed_mps and fix.alt_msl_m and fix.date for fix in fixes[12:])


def test_a_silence_ends_a_burst_as_soon_as_ever_unless_more_comes_after_it_again_and_again():
    bursts = [[gga(at(k)), rmc(at(k))] for k in range(30)]
    for k in (5, 6, 15):  # this process was delayed
        bursts[k] = [gga(at(k)), b"", b"", b"", rmc(at(k))]
    ready, counters = played(bursts, 0.1)
    assert counters["late"] == 3
    gaps = [now_s - k for k, (_, now_s) in enumerate(ready)]
    assert max(gaps) < 0.1 + SILENCE_NS * 1e-9 + 0.03


@pytest.mark.parametrize("paused", [True, False])
def test_a_damaged_sentence_costs_its_own_epoch_only(paused):
    receiver = Receiver(flush=paused)
    for k in range(8):
        first = b"$GPGGA,broken*00\r\n" if k == 4 else gga(at(k))
        receiver.burst(first, vtg(kmh=str(k)))
        if not paused:
            receiver.now_ns -= 900_000_000  # a line without a pause
    receiver.fixes += receiver.decoder.flush(receiver.now_ns + SILENCE_NS)
    assert [fix.utc_s - 43200 for fix in receiver.fixes] == [0, 1, 2, 3, 5, 6, 7]
    assert [round(fix.speed_mps * 3.6) for fix in receiver.fixes] == [0, 1, 2, 3, 5, 6, 7]


def test_the_end_of_a_burst_that_began_before_us_stays_out_of_the_next():
    decoder, stream = NmeaDecoder(), vtg(kmh="0")
    for k in range(1, 5):
        stream += gga(at(k)) + slow_rmc(at(k)) + vtg(kmh=str(k))
    fixes = decoder.feed(stream, 1) + decoder.flush(1 + SILENCE_NS)  # a line without pauses
    assert [fix.speed_mps for fix in fixes] == [float(Fraction(k) * 10 / 36) for k in range(1, 5)]


def test_a_lost_ending_is_replaced_by_the_next_burst():
    receiver = Receiver(flush=False)
    for k in range(3):
        receiver.burst(gga(at(k)), vtg())
    assert receiver.burst(gga(at(3))) == []
    assert receiver.burst(gga(at(4)), vtg()) == [0, 1]
    assert [fix.utc_s - 43200 for fix in receiver.fixes] == [0, 1, 2, 3, 4]


def test_a_changed_ending_is_learned_anew():
    receiver = Receiver()
    for k in range(3):
        receiver.burst(gga(at(k)), vtg())
    completed = [receiver.burst(gga(at(k)), vtg(), rmc(at(k))) for k in range(3, 8)]
    assert completed[-1] == [2]
    assert [fix.utc_s - 43200 for fix in receiver.fixes] == list(range(8))


def test_midnight_is_an_epoch_like_any_other():
    receiver = Receiver()
    for time, day in (("235959.000", "311225"), ("000000.000", "010126"), ("000001.000", "010126")):
        receiver.burst(gga(time), rmc(time, day=day))
    assert [fix.utc_s for fix in receiver.fixes] == [86399.0, 0.0, 1.0]
    assert [fix.date for fix in receiver.fixes] == [date(2025, 12, 31), date(2026, 1, 1), date(2026, 1, 1)]


def test_a_time_that_stands_still_is_dropped_and_counted():
    receiver = Receiver()
    for k in (0, 1, 1, 1, 2):
        receiver.burst(gga(at(k)), vtg())
    assert [fix.utc_s - 43200 for fix in receiver.fixes] == [0, 1, 2]
    assert receiver.decoder.counters["repeated"] == 2


def test_a_transition_epoch_with_a_position_but_quality_0_is_no_fix():
    fixes, decoder = decode(gga(rest="0,03,2.0,545.4,M,46.9,M,,") + vtg())
    assert fixes == []
    assert (decoder.status.quality, decoder.status.satellites) == (0, 3)
    fixes, decoder = decode(gga() + rmc(status="V"))
    assert fixes == []
    assert decoder.counters["no fix"] == 1


def gsa(mode, talker="GP"):
    return line(f"{talker}GSA,A,{mode},01,03,14,,,,,,,,,,3.1,3.1,")


def test_dimensions_are_the_last_reported_ones():
    receiver = Receiver()
    for k, modes in enumerate([(2,), (), (), (3,), (3, 1), (1, 3), (), (1,), (1, 1)]):
        receiver.burst(gga(at(k)), *[gsa(mode) for mode in modes], vtg())
    assert [fix.dimensions for fix in receiver.fixes] == [2, 2, 2, 3, 3, 3, 3, None, None]
    for k in range(40):
        receiver.burst(gga(at(100 + k)), gsa(2) if k == 0 else b"", vtg())
    assert receiver.fixes[-20].dimensions == 2
    assert receiver.fixes[-1].dimensions is None, "too long ago"


def test_a_clock_that_is_ahead_in_zda_makes_no_epoch():
    """Ashtech AC12 (gpsd's ac12.log): ZDA says two seconds more than GGA and RMC."""
    receiver = Receiver(flush=False)
    for k in range(6):
        receiver.burst(gga(at(k)), slow_rmc(at(k)), line(f"GPZDA,{at(k + 2)},23,03,1994,00,00"), vtg(kmh=str(k)))
    assert [fix.utc_s - 43200 for fix in receiver.fixes] == [0, 1, 2, 3, 4, 5][: len(receiver.fixes)]
    assert len(receiver.fixes) >= 5
    assert [round(fix.speed_mps * 3.6) for fix in receiver.fixes] == list(range(len(receiver.fixes)))


def test_zda_before_the_rest_dates_the_fix_and_begins_the_epoch():
    decoder, stream = NmeaDecoder(), b""
    for k in range(4):
        stream += line(f"GPZDA,{at(k)},2{k},11,2026,00,00") + gga(at(k))
    fixes = decoder.feed(stream, 1) + decoder.flush(1 + SILENCE_NS)
    assert [fix.date for fix in fixes] == [date(2026, 11, 20 + k) for k in range(4)]
    receiver = Receiver()
    receiver.burst(line(f"GPZDA,{at(0)},21,11,2026,00,00"), gga(at(0)))
    assert receiver.fixes[0].arrival_ns == 10**12 + 20_000_000


def test_times_rounded_apart_are_one_epoch():
    """Magellan eXplorist (gpsd's eXplorist210.log): GLL says .297, GGA and RMC .30."""
    gll = line("GPGLL,4807.038,N,01131.000,E,120000.297,A")
    fixes, _ = decode(gll + gga("120000.30") + rmc("120000.30"))
    assert [fix.utc_s for fix in fixes] == [43200.3]


def test_two_talkers_of_one_epoch_give_one_fix():
    receiver = Receiver()
    for k in range(4):
        receiver.burst(gga(at(k)), line(gga(at(k))[1:-5].replace(b"GP", b"GN")), rmc(at(k)))
    assert len(receiver.fixes) == 4


def test_rmc_and_gga_that_contradict_each_other_are_no_fix():
    """Two flipped bits can cancel in the checksum."""
    fixes, decoder = decode(gga(lat="5807.039,N") + rmc())
    assert fixes == []
    assert decoder.counters["contradictory"] == 1
    assert len(decode(gga(lat="4807.0380,N", lon="01131.0001,E") + rmc())[0]) == 1


@pytest.mark.parametrize(
    ("lon", "rmc_lon", "agree"),
    [
        ("01131.000,E", "01131.110,E", True),  # 0.11' of longitude at 60 degrees north: 0.92e-3 degrees of latitude
        ("01131.000,E", "01131.130,E", False),  # 1.08e-3
        ("17959.980,E", "17959.980,W", True),  # on both sides of the date line
        ("17959.900,E", "17959.900,W", False),
    ],
)
def test_sentences_of_one_epoch_agree_by_their_distance_on_the_ground(lon, rmc_lon, agree):
    second = line(f"GPRMC,120000.000,A,6000.000,N,{rmc_lon},022.4,084.4,230394,,,A")
    fixes, decoder = decode(gga(lat="6000.000,N", lon=lon) + second)
    assert (len(fixes), decoder.counters["contradictory"]) == ((1, 0) if agree else (0, 1))


@pytest.mark.parametrize(("difference_kmh", "used"), [(0.5, True), (-0.5, True), (0.6, False), (-0.6, False)])
def test_vtg_is_used_alone_only_if_it_gave_the_speed_of_rmc_but_for_rounding(difference_kmh, used):
    """0.15 m/s are 0.54 km/h."""
    decoder, stream = NmeaDecoder(), b""
    for k in range(5):
        knots = "" if k == 3 else f"{10 * k / 1.852}"
        stream += gga(at(k)) + rmc(at(k), motion=f"{knots},0") + vtg(kmh=f"{max(10 * k + difference_kmh, 0):.2f}")
    fixes = decoder.feed(stream, 1) + decoder.flush(1 + SILENCE_NS)
    assert (fixes[3].speed_mps is not None) == used
    assert [round(fix.speed_mps * 3.6) for fix in fixes if fix is not fixes[3]] == [0, 10, 20, 40]


def test_the_speed_of_rmc_is_preferred_to_that_of_vtg():
    assert decode(gga() + rmc(motion="10.0,20.0") + vtg(kmh="99.0"))[0][0].speed_mps == float(Fraction(18520, 3600))


def test_vtg_that_contradicts_rmc_is_not_used_alone():
    """A burst that begins with VTG, without a pause before: it looks like the end of the one before."""
    decoder, stream = NmeaDecoder(), b""
    for k in range(5):
        stream += vtg(kmh=str(10 * k)) + (rmc(at(k), motion=f"{k / 0.1852},0") if k != 3 else b"") + gga(at(k))
    fixes = decoder.feed(stream, 1) + decoder.flush(1 + SILENCE_NS)
    assert [fix.speed_mps and round(fix.speed_mps * 3.6) for fix in fixes] == [0, 10, 20, None, 40]


def test_endings_survive_losses_in_succession():
    receiver = Receiver(flush=False)
    for k in range(10):
        receiver.burst(gga(at(k)), b"" if k in (4, 5) else vtg(kmh=str(k)))
    completed = [receiver.burst(gga(at(k)), vtg(kmh=str(k))) for k in range(10, 13)]
    assert completed == [[1], [1], [1]]
    assert [fix.speed_mps is None for fix in receiver.fixes] == [k in (4, 5) for k in range(13)]


def test_a_burst_torn_by_lost_bytes_stays_one_epoch():
    decoder, now = NmeaDecoder(), 10**12
    fixes = decoder.feed(gga(), now) + decoder.feed(rmc(motion="10.0,20.0"), now + 300_000_000)
    fixes += decoder.flush(now + 10**9)
    assert [fix.course_deg for fix in fixes] == [20.0]


def plotted(time):
    """What a plotter makes of the last fix that it got: fewer digits, and a time of its own."""
    return line(f"IIRMC,{time},A,4807.03,N,01131.00,E,22,84,230394,,,A")


@pytest.mark.parametrize("status", ["A", "V"])
@pytest.mark.parametrize("shift_s", [-1, 0.5])
def test_what_an_instrument_repeats_of_a_receiver_on_the_same_line_is_no_fix(shift_s, status):
    receiver = Receiver()
    for k in range(86_390, 86_410):  # over midnight
        day = [f"{s // 3600 % 24:02}{s // 60 % 60:02}{s % 60:02}" for s in (k, int(k + shift_s))]
        own, repeated = rmc(day[0], status), plotted(f"{day[1]}.{int(shift_s % 1 * 10)}")
        receiver.burst(own)
        receiver.now_ns -= 500_000_000
        receiver.burst(repeated)
        receiver.now_ns -= 500_000_000
    assert len(receiver.fixes) == 20
    is_own = {fix.step_deg < 1e-4 for fix in receiver.fixes}
    assert is_own == {status == "A"}  # where the receiver has none, the plotter has one of its own


@pytest.mark.parametrize("order", ["before", "after"])
def test_a_system_without_a_fix_hides_none_of_another_system(order):
    """A receiver with a GGA and an RMC of each system: those of BeiDou say that there are no satellites of it."""
    receiver = Receiver()
    for k in range(10):
        gps = gga(at(k)), rmc(at(k))
        beidou = gga(at(k), rest="0,00,,,M,,M,,"), rmc(at(k), status="V", tail=",,,N")
        beidou = [line("BD" + sentence.split(b"*")[0].decode()[3:]) for sentence in beidou]
        receiver.burst(*(beidou + list(gps) if order == "before" else list(gps) + beidou))
    assert [fix.utc_s for fix in receiver.fixes] == [43200 + k for k in range(10)]
    assert {fix.quality for fix in receiver.fixes} == {1}
    assert receiver.decoder.counters["no fix"] == 0 and receiver.decoder.status.quality == 1
