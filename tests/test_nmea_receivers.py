"""Receivers of many makes, whole and with damaged sentences: every good epoch gives its fix once, with its own values.

The bursts are of our own making, in the styles of the receivers whose logs gpsd keeps in test/daemon (named below).
"""

import random
from functools import cache

import pytest
from nmea_lines import line

from imud.drivers.nmea.decoder import NmeaDecoder

START_S = 86_390  # midnight comes soon
EPOCHS = 200
PLACES = ("GGA", "GNS", "RMC", "GLL")

# order and form of a burst, and its interval in s
STYLES = {
    "mtk-3301": (
        1.0,
        "GPGGA,{t}.000,{lat6},{lon6},1,8,1.10,{alt:.3f},M,36.700,M,,|GPGSA,A,3,21,28,08,,,,,,,,,,1.98,1.10,1.65|"
        "GPRMC,{t}.000,A,{lat6},{lon6},{kn},{cog},{date},,,A|PMTKCHN,21452,28472,08442,25422|"
        "GPVTG,{cog},T,,M,{kn},N,{kmh},K,A",
    ),
    "mtk-3301, GGA and VTG": (
        1.0,
        "GPGGA,{t}.000,{lat6},{lon6},1,8,1.10,{alt:.3f},M,36.700,M,,|GPVTG,{cog},T,,M,{kn},N,{kmh},K,A",
    ),
    "mtk-3301, 5 Hz": (
        0.2,
        "GPGGA,{t}.{f}00,{lat6},{lon6},1,8,1.10,{alt:.3f},M,36.700,M,,|GPRMC,{t}.{f}00,A,{lat6},{lon6},{kn},{cog},{date},,,A|"
        "GPVTG,{cog},T,,M,{kn},N,{kmh},K,A",
    ),
    "nmea-rtk, 10 Hz": (
        0.1,
        "GNGGA,{t}.{f}0,{lat8},{lon8},4,19,0.7,{alt:.3f},M,-31.442,M,6.1,0002|"
        "GNRMC,{t}.{f}0,A,{lat8},{lon8},{kn},{cog},{date},11.5982,E,D",
    ),
    "quectel-LC79D": (
        1.0,
        "GPGSV,1,1,01,31,29,056,18,1|GNGSA,A,3,01,03,04,,,,,,,,,,1.6,0.9,1.3,1|GNVTG,{cog},T,,M,{kn},N,{kmh},K,A|"
        "GNRMC,{t}.00,A,{lat6},{lon6},{kn},{cog},{date},,,A,V|GNGGA,{t}.00,{lat6},{lon6},1,14,0.9,{alt:.1f},M,,M,,|"
        "GNGLL,{lat6},{lon6},{t}.00,A,A",
    ),
    "quectel-L70": (
        1.0,
        "GPZDA,{t}.000,{d},{m},{y},,|GPRMC,{t}.000,A,{lat4},{lon4},{kn},{cog},{date},,,D|"
        "GPGGA,{t}.000,{lat4},{lon4},2,8,0.94,{alt:.1f},M,-17.5,M,,|GPGST,{t}.000,004.0,008.7,004.7,132.3,006.8,007.2,00014",
    ),
    "furuno_gl_ga": (
        1.0,
        "GNRMC,{t}.000,A,{lat4},{lon4},{kn},{cog},{date},,,D,V|GNGNS,{t}.000,{lat4},{lon4},NDD,11,1.3,{alt:.1f},39.5,,,V|"
        "GNGGA,{t}.000,{lat4},{lon4},2,00,1.3,{alt:.1f},M,39.5,M,,|GNGSA,A,3,04,05,,,,,,,,,,,1.5,1.3,1.0,3|"
        "GPZDA,{t}.000,{d},{m},{y},+00,00",
    ),
    "ac12 (ZDA is ahead)": (
        1.0,
        "GPGGA,{t}.00,{lat5},{lon5},1,04,1.7,{alt:.2f},M,-13.9,M,,|GPRMC,{t}.00,A,{lat4},{lon4},{kn},{cog},{date},01,W,A|"
        "GPZDA,{ahead}.00,{d},{m},{y},00,00",
    ),
    "telit-he910": (
        1.0,
        "GPGGA,{t}.408,{lat4},{lon4},1,04,2.25,{alt:.1f},M,,M,,0000|GPGLL,{lat4},{lon4},{t}.408,A,A|"
        "GPRMC,{t}.408,A,{lat4},{lon4},{kn},{cog},{date},,,A|GPVTG,{cog},T,,M,{kn},N,{kmh},K,A",
    ),
    "magellan315 (times rounded apart)": (
        1.0,
        "GPGLL,{lat4},{lon4},{t}.758,A|GPGGA,{t}.76,{lat4},{lon4},1,06,2.1,{alt:05.0f},M,,,,|"
        "GPRMC,{t}.76,A,{lat4},{lon4},{kn},{cog},{date},01.,W",
    ),
    "st-teseo-liv4f": (
        1.0,
        "$GNRMC,{t}.000,A,{lat5},{lon5},{kn},{cog},{date},,,A,C|$GNGGA,{t}.000,{lat5},{lon5},1,13,1.7,{alt:06.2f},M,48.3,M,,|"
        "$GNVTG,{cog},T,,M,{kn},N,{kmh},K,A|$GNGST,{t}.000,6.1,4.0,4.0,61.0,4.6,4.4,4.8|$GNGBS,{t}.000,4.6,4.4,4.8,,,,,,",
    ),
    "ait250 (RMC among AIS)": (1.0, "GPRMC,{t}.00,A,{lat5},{lon5},{kn},{cog},{date},,,A|GPGBS,{t}.00,3.0,1.9,4.2,,,,"),
    "GGA alone": (1.0, "GPGGA,{t},{lat4},{lon4},1,08,0.9,{alt:.1f},M,46.9,M,,"),
    "GLL and VTG": (1.0, "GPGLL,{lat4},{lon4},{t},A|GPVTG,{cog},T,,M,{kn},N,{kmh},K"),
    "dual antenna": (
        0.2,
        "GNGGA,{t}.{f}0,{lat8},{lon8},4,19,0.7,{alt:.3f},M,-31.442,M,6.1,0002|GNVTG,{cog},T,,M,{kn},N,{kmh},K,D|"
        "GNHDT,{heading:.3f},T",
    ),
}  # fmt: skip


class Burst:
    """What a receiver of a style says of epoch k. Every value tells the epoch."""

    def __init__(self, style, k):
        self.interval, form = STYLES[style]
        time = START_S + k * self.interval + 1e-6
        self.utc_s = time % 86_400
        self.lat, self.lon, self.alt = 47.9 + 1e-5 * k, -5.2 - 1e-5 * k, 100.0 + k
        self.kmh, self.course, self.heading = 1.0 + k, k % 360, (k + 90.0) % 360.0
        self.day = 21 if time < 86_400 else 22
        self.bodies = [body.format(**self.words()) for body in form.split("|")]
        self.kinds = [body.lstrip("$")[2:5] for body in self.bodies]
        self.lines = [line(body) if body[0] != "$" else b"$" + line(body[1:]) for body in self.bodies]

    def words(self):
        def hms(s):
            return f"{int(s) // 3600 % 24:02}{int(s) // 60 % 60:02}{int(s) % 60:02}"

        angles = {f"lat{n}": f"{dm(self.lat, 2, n)},N" for n in (4, 5, 6, 8)}
        angles |= {f"lon{n}": f"{dm(-self.lon, 3, n)},W" for n in (4, 5, 6, 8)}
        tenth = int(self.utc_s * 10) % 10
        speed = {"kmh": f"{self.kmh:.3f}", "kn": f"{self.kmh / 1.852:.3f}", "cog": f"{self.course:05.1f}"}
        date = {"date": f"{self.day}1126", "d": self.day, "m": 11, "y": 2026}
        time = {"t": hms(self.utc_s), "f": tenth, "ahead": hms(self.utc_s + 2)}
        return {**angles, **speed, **date, **time, "alt": self.alt, "heading": self.heading}


def dm(degrees, digits, decimals):
    units = round(degrees * 60 * 10**decimals)
    whole, minutes = divmod(units, 60 * 10**decimals)
    return f"{whole:0{digits}}{minutes // 10**decimals:02}.{minutes % 10**decimals:0{decimals}}"


def flip(rng, data):
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]


def drop(rng, data):
    at = rng.randrange(len(data))
    return data[:at] + data[at + rng.randint(1, 20) :]


def duplicate(rng, data):
    at = rng.randrange(len(data))
    return data[:at] + data[at : at + rng.randint(1, 20)] + data[at:]


def insert(rng, data):
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.randint(1, 8)) + data[at:]


def nuls(rng, data):
    at = rng.randrange(len(data))
    return data[:at] + bytes(rng.randint(1, 8)) + data[at + rng.choice((0, 4)) :]


def cut(rng, data):
    return data[: rng.randrange(len(data))]


def swap_in_another(rng, data):
    at = rng.randrange(len(data))
    return data[at:] + data[:at]


def lose(rng, data):
    return b""


@cache
def bursts(style):
    """All that a receiver of a style says."""
    return [Burst(style, k) for k in range(EPOCHS)]


DAMAGE = (flip, drop, duplicate, insert, nuls, cut, swap_in_another, lose)


class Run:
    """A receiver's stream with a share of its sentences damaged, decoded."""

    def __init__(self, style, seed, share, paused):
        rng = random.Random(f"{style} {seed} {share}")
        self.decoder, self.fixes, self.damaged = NmeaDecoder(), [], 0
        self.bursts, self.whole = bursts(style), []
        now = 10**12
        for k, burst in enumerate(self.bursts):
            now = max(now, 10**12 + int(k * STYLES[style][0] * 1e9)) if paused else now
            kept = set()
            for kind, whole in zip(burst.kinds, burst.lines, strict=True):
                hurt = rng.random() < share
                self.damaged += hurt
                kept |= set() if hurt else {kind}
                data = rng.choice(DAMAGE)(rng, whole) if hurt else whole
                span = 10_000_000 if paused else int(burst.interval * 1e9 / len(burst.lines))
                for i in range(8):  # as the line carries them
                    now += span // 8
                    self.feed(data[len(data) * i // 8 : len(data) * (i + 1) // 8], now)
            self.whole.append(kept)
            self.fixes += self.decoder.flush(now + 250_000_000) if paused and burst.interval == 1.0 else []
        self.fixes += self.decoder.flush(now + 10**10)

    def feed(self, data, now):
        self.fixes += self.decoder.feed(data, now) if data else []


@pytest.mark.thorough
@pytest.mark.parametrize("paused", [True, False])
@pytest.mark.parametrize("style", STYLES)
def test_undamaged_streams_give_every_epoch_once(style, paused):
    run = Run(style, 0, 0.0, paused)
    assert len(run.fixes) == EPOCHS
    check(run)
    assert not any(" " in reason for reason in run.decoder.counters if reason != "noise bytes")


@pytest.mark.thorough
@pytest.mark.parametrize("paused", [True, False])
@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("seed", range(4))
def test_three_percent_damage_costs_the_damaged_sentences_only(style, paused, seed):
    run = Run(style, seed, 0.03, paused)
    check(run)
    assert lost_speeds(run) <= 4


def check(run):
    """Every epoch with a whole position has its one fix; every fix is an epoch's, with nothing of another's."""
    by_epoch = {}
    for fix in run.fixes:
        k = round((fix.lat_deg - 47.9) / 1e-5)
        assert 0 <= k < EPOCHS
        assert k not in by_epoch, f"epoch {k} twice"
        by_epoch[k] = fix
    for k, (burst, whole) in enumerate(zip(run.bursts, run.whole, strict=True)):
        if whole & set(PLACES):
            assert k in by_epoch, f"epoch {k} lost"
        if k in by_epoch:
            compare(by_epoch[k], burst, whole)


def lost_speeds(run):
    """Epochs whose position and VTG were whole, but went apart: without RMC their pairing is cautious."""
    if "RMC" in run.bursts[0].kinds:
        return 0
    by_epoch = {round((fix.lat_deg - 47.9) / 1e-5): fix for fix in run.fixes}
    whole = [k for k in range(EPOCHS) if "VTG" in run.whole[k] and run.whole[k] & set(PLACES)]
    return sum(by_epoch[k].speed_mps is None for k in whole)


def compare(fix, burst, whole):
    assert 0.0 <= fix.utc_s - burst.utc_s + 2e-6 < (0.9 if burst.interval == 1.0 else 0.001)
    assert fix.lat_deg == pytest.approx(burst.lat, abs=1e-6)
    assert fix.lon_deg == pytest.approx(burst.lon, abs=1e-6)
    assert fix.alt_msl_m in (None, burst.alt)
    assert fix.alt_msl_m is not None or not whole & {"GGA", "GNS"}
    assert fix.speed_mps is None or fix.speed_mps == pytest.approx(burst.kmh / 3.6, abs=3e-4)
    assert fix.course_deg is None or fix.course_deg == burst.course
    assert fix.speed_mps is not None or "RMC" not in whole
    assert fix.date is None or fix.date.day == burst.day
