"""Sentences of one receiver at different rates: a velocity is that of its own epoch, and other epochs have none."""

import pytest
from nmea_lines import line

from imud.drivers.nmea.decoder import NmeaDecoder

START_MS = 86_395_000  # midnight comes soon
LATENCY_MS = 30


def sentence(kind, ms, talker="GP"):
    """Of the epoch `ms` ms of the day; the speed in tenths of km/h is the number of the tenth of a second."""
    s = ms // 1000
    time = f"{s // 3600 % 24:02}{s // 60 % 60:02}{s % 60:02}"
    lat = f"4800.{ms // 100 % 100_000:05}"
    kmh = ms // 100 % 1000 / 10
    knots, place = f"{kmh / 1.852:.5f}", f"{lat},N,01131.00000,E"
    return line(
        talker
        + {
            "GGA": f"GGA,{time}.{ms % 1000:03},{place},4,12,0.60,500.0,M,46.9,M,1.0,0001",
            "GNS": f"GNS,{time}.{ms % 1000 // 10:02},{place},RR,12,0.60,500.0,46.9,1.0,",
            "RMC": f"RMC,{time}.{ms % 1000 // 10:02},A,{place},{knots},084.4,230394,,,A",
            "GLL": f"GLL,{place},{time}.{ms % 1000 // 10:02},A,A",
            "VTG": f"VTG,084.4,T,,M,{knots},N,{kmh:.1f},K,A",
            "GSA": "GSA,A,3,01,03,14,,,,,,,,,,3.1,0.6,",
            "GST": f"GST,{time}.{ms % 1000 // 10:02},0.5,,,,0.02,0.02,0.04",
        }[kind]
    )


def received(order, hz, seconds=20, baud=115_200, chunk_ms=5, lost=lambda k, kind: False):
    """(fix, epoch in ms of the day, ms from its epoch until it is ready) of a line; order: kind, epochs between two."""
    wire, busy_ms = [], 0.0
    for k in range(seconds * hz):
        at_ms = max(busy_ms, k * 1000 / hz + LATENCY_MS)
        for kind, every in order:
            if k % every == 0 and not lost(k, kind):
                for byte in sentence(kind, (START_MS + k * 1000 // hz) % 86_400_000):
                    at_ms += 10_000 / baud
                    wire.append((at_ms, byte))
        busy_ms = at_ms
    decoder, chunks = NmeaDecoder(), {}
    for at_ms, byte in wire:
        chunks.setdefault(int(at_ms // chunk_ms + 1) * chunk_ms, bytearray()).append(byte)
    ready, last_ms = [], 0
    for now_ms, data in chunks.items():
        if now_ms - last_ms > 210:
            ready += [(fix, last_ms + 210) for fix in decoder.flush((10**6 + last_ms + 210) * 10**6)]
        ready += [(fix, now_ms) for fix in decoder.feed(bytes(data), (10**6 + now_ms) * 10**6)]
        last_ms = now_ms
    epochs_ms = [round(fix.utc_s * 1000) for fix, _ in ready]
    return [
        (fix, ms, now_ms - (ms - START_MS) % 86_400_000) for (fix, now_ms), ms in zip(ready, epochs_ms, strict=True)
    ]


def with_speed(found):
    """The number of fixes that have a speed; all of them must be those of their epochs."""
    rows = [(fix, ms) for fix, ms, _ in found if fix.speed_mps is not None]
    for fix, ms in rows:
        assert fix.speed_mps * 3.6 == pytest.approx(ms // 100 % 1000 / 10, abs=2e-3), ms
    return len(rows)


RARE_VELOCITIES = [
    [("GGA", 1), ("RMC", 10)],
    [("RMC", 10), ("GGA", 1)],
    [("GGA", 1), ("VTG", 10)],
    [("VTG", 10), ("GGA", 1)],
    [("RMC", 10), ("VTG", 10), ("GGA", 1)],
    [("GGA", 1), ("GSA", 10), ("VTG", 10)],
    [("VTG", 10), ("GSA", 10), ("GGA", 1)],
    [("GLL", 1), ("VTG", 10)],
    [("GNS", 1), ("RMC", 10)],
    [("GGA", 1), ("RMC", 10), ("VTG", 10), ("GST", 10)],
]


@pytest.mark.parametrize("order", RARE_VELOCITIES, ids=lambda order: " ".join(kind for kind, _ in order))
@pytest.mark.parametrize("chunk_ms", [1, 5, 16])
def test_a_velocity_each_second_is_that_of_its_epoch_among_ten_positions(order, chunk_ms):
    found = received(order, 10, chunk_ms=chunk_ms)
    assert len(found) >= 199
    assert with_speed(found) >= 19


@pytest.mark.parametrize("order", [[("VTG", 1), ("GGA", 1)], [("GGA", 1), ("VTG", 1)], [("VTG", 1), ("RMC", 1)]])
@pytest.mark.parametrize("hz", [1, 5, 10])
def test_vtg_is_of_its_own_burst_on_whichever_side_of_the_position_it_stands(order, hz):
    found = received(order, hz)
    assert with_speed(found) >= len(found) - 1 >= 20 * hz - 2


@pytest.mark.parametrize("hz", [25, 50, 100])
def test_every_epoch_of_a_fast_receiver_is_a_fix_with_its_velocity(hz):
    """RMC has its time in hundredths of a second: at 100 Hz these are the epochs themselves."""
    fixes = [fix for fix, *_ in received([("GGA", 1), ("RMC", 1)], hz, seconds=3, baud=921_600)]
    assert len(fixes) == 3 * hz and all(fix.speed_mps is not None for fix in fixes)


@pytest.mark.parametrize("order", [[("GGA", 1), ("RMC", 5)], [("GGA", 1), ("VTG", 5)], [("VTG", 5), ("GGA", 1)]])
def test_the_same_holds_at_9600_baud(order):
    assert with_speed(received(order, 5, baud=9600)) >= 19


@pytest.mark.parametrize("order", [[("GGA", 1), ("VTG", 10)], [("VTG", 10), ("GGA", 1)], [("GGA", 1), ("RMC", 10)]])
def test_a_lost_position_does_not_give_its_velocity_to_a_neighbour(order):
    found = received(order, 10, lost=lambda k, kind: kind == "GGA" and k % 7 == 0)
    assert 14 <= with_speed(found) <= 20


def test_bursts_longer_than_their_period_keep_their_velocities():
    found = received([("GGA", 1), ("RMC", 10), ("VTG", 10)], 10, baud=9600)
    assert with_speed(found) >= 19


@pytest.mark.parametrize("order", [[("RMC", 1), ("GGA", 10)], [("GGA", 10), ("RMC", 1)]])
def test_quality_and_dilution_of_a_position_each_second_are_those_of_the_fixes_between(order):
    found = received(order, 10)
    assert with_speed(found) >= 199
    later = [fix for fix, *_ in found[20:]]
    assert {(fix.quality, fix.hdop, fix.satellites) for fix in later} == {(4, 0.6, 12)}
    assert sum(fix.alt_msl_m is not None for fix in later) == pytest.approx(len(later) / 10, abs=1), "no old height"


def test_sigmas_each_second_are_those_of_the_fixes_between():
    found = received([("GGA", 1), ("RMC", 1), ("GST", 10)], 10)
    assert {fix.sigma_n_m for fix, *_ in found[20:]} == {0.02}


@pytest.mark.parametrize("rare", [("GST", 10), ("GST", 2), ("VTG", 10)])
def test_a_rare_companion_delays_no_fix_once_the_order_is_known(rare):
    found = received([("GGA", 1), ("RMC", 1), rare], 10, seconds=40)
    assert len(found) >= 399 and with_speed(found) == len(found)
    assert max(ready_ms for *_, ready_ms in found[250:]) < 100
    assert rare[0] != "GST" or {fix.sigma_n_m for fix, *_ in found[20:]} == {0.02}


RARE_ENDS = [
    (10, [("GGA", 1), ("RMC", 10)]),
    (10, [("GGA", 1), ("RMC", 50)]),
    (10, [("GGA", 1), ("RMC", 3)]),
    (10, [("GGA", 1), ("VTG", 10)]),
    (10, [("RMC", 1), ("GGA", 10)]),
    (5, [("GNS", 1), ("RMC", 5)]),
    (1, [("GGA", 1), ("RMC", 5)]),
]


@pytest.mark.parametrize(("hz", "order"), RARE_ENDS, ids=str)
@pytest.mark.parametrize("lost", [0, 97])
def test_what_comes_at_equal_intervals_delays_no_fix_but_its_own_and_is_used(hz, order, lost):
    """It is waited for where it is due. lost: of so many sentences one; then a single fix may wait for the next."""
    found = received(order, hz, seconds=300 // hz + 60, lost=lambda k, kind: lost and (k + len(order)) % lost == 0)
    every = max(often for _, often in order)
    assert with_speed(found) >= len(found) * (1 if order[0][0] == "RMC" else 1 / every) - 3
    ready_ms = sorted(ms for *_, ms in found[len(found) // 2 :])
    assert ready_ms[-1 if lost == 0 else len(ready_ms) * 49 // 50] < 60


@pytest.mark.parametrize("order", [[("GGA", 1), ("RMC", 2)], [("GGA", 1), ("RMC", 2), ("VTG", 10)]])
def test_a_lost_position_does_not_make_later_fixes_wait(order):
    """Two bursts in sequence then have an RMC, but not all have."""
    found = received(order, 10, seconds=60, lost=lambda k, kind: kind == "GGA" and k in (201, 301, 401, 501))
    assert len(found) >= 595
    ready_ms = sorted(ms for *_, ms in found[100:])
    assert ready_ms[-5] < 60, "the few beside the lost ones may wait"


def test_what_no_longer_comes_is_not_waited_for():
    found = received([("GGA", 1), ("RMC", 10)], 10, seconds=60, lost=lambda k, kind: kind == "RMC" and k > 300)
    assert max(ready_ms for *_, ready_ms in found[400:]) < 60


def test_a_companion_that_becomes_frequent_is_waited_for_again():
    """Then the sigmas are those of the fix's own burst, not of the one before."""

    def burst(k):
        sigma = f"{k % 10 + 1}.00"
        gst = sentence("GST", k * 100).split(b"*")[0][1:].decode().replace("0.02,0.02", f"{sigma},{sigma}")
        return sentence("GGA", k * 100) + sentence("RMC", k * 100) + (line(gst) if k % 10 == 0 or k > 200 else b"")

    decoder, fixes = NmeaDecoder(), []
    for k in range(300):
        fixes += decoder.feed(burst(k), (k + 10) * 10**8)
    assert len(fixes) >= 299
    assert {fix.sigma_n_m for fix in fixes[20:200]} == {1.0}
    assert [fix.sigma_n_m for fix in fixes[220:]] == [round(fix.utc_s * 10) % 10 + 1.0 for fix in fixes[220:]]


def rmc_at(ms, mode):
    return sentence("RMC", ms).split(b"*")[0][1:-1] + mode


def test_what_was_said_of_the_accuracy_ends_with_another_quality_and_after_a_time():
    decoder, fixes = NmeaDecoder(), []
    burst = sentence("GGA", 0) + sentence("GST", 0) + line(rmc_at(0, b"R"))
    later = [line(rmc_at(ms, mode)) for ms, mode in [(500, b"R"), (1000, b"F"), (1500, b"R"), (3500, b"R")]]
    for k, data in enumerate([burst, *later]):
        fixes += decoder.feed(data, k * 10**9) + decoder.flush(k * 10**9 + 5 * 10**8)
    assert [fix.quality for fix in fixes] == [4, 4, 5, 4, 4]
    assert [fix.hdop for fix in fixes] == [0.6, 0.6, None, 0.6, None]
    assert [fix.sigma_n_m for fix in fixes] == [0.02, 0.02, None, None, None]


def test_velocities_between_positions_do_not_delay_them():
    found = received([("GGA", 10), ("VTG", 1)], 10)
    assert len(found) == 20
    assert max(ready_ms for *_, ready_ms in found[2:]) < 400
    assert with_speed(found) >= 19


def test_a_velocity_that_waits_for_its_burst_is_pending_until_the_line_is_silent():
    decoder = NmeaDecoder()
    fixes = decoder.feed(sentence("GGA", 0), 10**9) + decoder.feed(sentence("VTG", 0), 10**9 + 10**7)
    assert (fixes, decoder.pending) == ([], True)
    assert [fix.speed_mps for fix in decoder.flush(2 * 10**9)] == [0.0]
    assert not decoder.pending


def test_the_first_sentences_of_all_may_be_a_velocity():
    decoder = NmeaDecoder()
    assert decoder.feed(sentence("VTG", 0) * 3, 10**9) == []
    assert decoder.flush(2 * 10**9) == []
    assert not decoder.pending
