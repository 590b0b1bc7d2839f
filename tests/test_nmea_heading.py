"""Headings in NMEA: which sentences hold one, of which time, and that the fixes beside them stay what they are."""

import numpy as np
import pytest
from navigation_simulation import drive, errors, received, sensed
from nmea_lines import decode, gga, line, rmc
from test_navigation_aiding import KNOWN, estimated, headings

from imud.configuration.settings import Gnss
from imud.drivers.nmea.decoder import NmeaDecoder
from imud.drivers.nmea.driver import Nmea
from imud.estimators import registry
from imud.sensors.receiver import Receiver

NOON_S = 43200.0
SECOND = 1_000_000_000


def of(*pieces):
    """Headings of pieces of bytes, each with its arrival in s."""
    decoder = NmeaDecoder()
    for data, t_s in pieces:
        decoder.feed(data, round(t_s * SECOND))
    return decoder.take_readings(), decoder


@pytest.mark.parametrize(
    ("body", "degrees", "sigma"),
    [
        ("HEHDT,123.45,T", 123.45, None),
        ("GPHDT,360.0,T", 0.0, None),
        ("GNTHS,77.5,A", 77.5, None),
        ("PASHR,120000.00,201.5,T,-0.1,0.2,0.0,0.03,0.03,0.25,1,1", 201.5, 0.25),
    ],
)
def test_a_heading_and_its_sigma(body, degrees, sigma):
    [heading], decoder = of((line(body) + line("GPHDT,1.0,T"), 1.0))
    assert (heading.value, heading.sigma) == (degrees, sigma)
    assert decoder.counters["heading"] == 2


@pytest.mark.parametrize(
    "body",
    ["GPHDT,,T", "GPHDT,12.0,M", "GPTHS,12.0,V", "GPTHS,12.0,E", "GPHDT,361.0,T", "GPHDT,abc,T", "PASHR,130,0,RMM,4"],
)
def test_a_sentence_without_a_true_heading_gives_none(body):
    found, decoder = of((line(body) * 2, 1.0))
    assert not found and not decoder.counters["heading"]


def test_in_the_burst_of_an_epoch_a_heading_has_its_time_wherever_it_stands():
    hdt = line("GPHDT,10.0,T")
    for burst in (hdt + gga() + rmc(), gga() + hdt + rmc(), gga() + rmc() + hdt):
        [heading], _ = of((burst, 1.0))
        assert heading.utc_s == pytest.approx(NOON_S)
    alone, later = of((hdt, 1.0), (gga(), 1.5), (hdt, 1.9), (hdt, 2.0))[0]
    assert alone.utc_s is None and later.utc_s is None


def test_headings_change_nothing_about_the_fixes():
    bursts = [gga(f"1200{k:02d}.000") + rmc(f"1200{k:02d}.000") for k in range(5)]
    plain, _ = decode(b"".join(bursts))
    hdt = line("HEHDT,10.0,T")
    mixed, decoder = decode(b"".join(hdt + burst[:40] + burst[40:] + hdt * 3 for burst in bursts))
    assert mixed == plain and decoder.counters["heading"] == 20


def test_a_receivers_headings_go_to_the_filter_as_measurements():
    receiver = Receiver(Nmea(), Gnss(latency_s=0.2), 0)
    receiver.feed(gga("115959.000"), 4 * SECOND)  # the age of a first one is not known
    receiver.feed(gga() + line("GPHDT,90.0,T") + line("PASHR,120000.00,180.0,T,0,0,0,0,0,0.5,1,1"), 5 * SECOND)
    receiver.feed(line("GPHDT,270.0,T") + line("GPHDT,271.0,T"), 7 * SECOND)
    first, second, third = receiver.measured
    assert first.t_ns == second.t_ns == 5 * SECOND - 200_000_000  # the epoch's, which is the latency before its arrival
    assert third.t_ns == 7 * SECOND - 200_000_000
    rows = [each.row(registry.by_name("navigation").sources) for each in (first, second)]
    assert [row["value"][0, 0] for row in rows] == pytest.approx([np.pi / 2, np.pi])
    assert np.isnan(rows[0]["sigma"][0, 0]) and rows[1]["sigma"][0, 0] == pytest.approx(np.radians(0.5))
    assert first.row(()) is None


def correlated(rows, d, rng, sigma, tau=10.0):
    """The same headings with an error of that correlation time."""
    decay = np.exp(-0.2 / tau)
    error = np.zeros(len(rows))
    error[0] = rng.standard_normal()
    for k in range(1, len(rows)):
        error[k] = decay * error[k - 1] + np.sqrt(1.0 - decay**2) * rng.standard_normal()
    rows = rows.copy()
    rows["value"][:, 0] += sigma * error
    return rows


def test_a_heading_whose_error_lasts_is_not_trusted_more_than_it_is_worth():
    nees, at_rest, sigma = [], [], np.radians(0.3)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        d = drive(90.0, rest=45.0)
        rows = headings(d, rng, sigma=1e-9)
        rows["sigma"][:, 0] = sigma
        out, innovations = estimated(sensed(d, rng), received(d, rng), correlated(rows, d, rng, sigma), KNOWN)
        yaw = errors(d, out)[2][:, 2]
        k = slice(1000, None, 100)
        nees.append(np.mean((yaw[k] / out["sigma_rpy"][k, 2]) ** 2))
        at_rest.append(yaw[1000:4500:50])
        assert innovations["used"].mean() > 0.98
    assert 0.2 < np.mean(nees) < 1.8
    assert np.sqrt(np.mean(np.square(at_rest))) < 1.1 * sigma
