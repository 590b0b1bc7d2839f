"""The models, one row each: dialect, scale factors, range and filters.

Sources of the scale factors: M-G350-PD11 brief sheet (2013); Epson's public drivers: sensor_epsonV340.h, the models of
py_esensorlib (mg320.py to mg370pdt0.py); for the M-G362 its data sheet and NASA Astrobee's G362P.h. Ranges are the
rated ones of Epson's product pages.
"""

import math
from dataclasses import dataclass, field

from ..sample import STANDARD_GRAVITY
from .dialects import FLAT, WINDOWED, Dialect
from .registers import Register, Setting


@dataclass(frozen=True)
class Model:
    """One row. Scales are per LSB of signed 16-bit words; 32-bit words have 65536 times finer ones."""

    code: str  # with which the product name in PROD_ID begins
    gyro_dps: float
    accel_mg: float
    temperature_degc: float
    temperature_raw_25: int  # the word at 25 degC
    gyro_range_dps: float
    accel_range_g: float
    dialect: Dialect = WINDOWED
    profile: str = "epson-windowed"
    # number of taps of the moving average: filter code
    tap_codes: dict[int, int] = field(default_factory=lambda: {1 << code: code for code in range(8)})
    filter_hz: float = 2000.0  # a rate is valid with at least filter_hz / rate taps
    settings: tuple[Setting, ...] = ()  # registers that must be set for this row to be valid

    @property
    def name(self) -> str:
        """As it is shown."""
        return f"M-{self.code}"

    @property
    def gyro_scale(self) -> float:
        """rad/s per LSB."""
        return math.radians(self.gyro_dps)

    @property
    def accel_scale(self) -> float:
        """m/s^2 per LSB."""
        return self.accel_mg * 1e-3 * STANDARD_GRAVITY

    @property
    def range_lsb(self) -> tuple[int, int]:
        """|word| at the end of the range, gyros and accelerometers; at most the end of the word."""
        return (
            min(round(self.gyro_range_dps / self.gyro_dps), 32767),
            min(round(self.accel_range_g * 1e3 / self.accel_mg), 32767),
        )

    @property
    def rates(self) -> dict[int, float]:
        """The dialect's rates for which this model has a valid filter: samples per second by code."""
        longest = max(self.tap_codes)
        return {code: rate for code, rate in self.dialect.rates.items() if longest * rate >= self.filter_hz}

    def possible_taps(self, rate_hz: float) -> list[int]:
        """Taps of the filters that are valid at that rate, shortest first; those of the longest filter if none is."""
        taps = sorted(self.tap_codes)
        return [count for count in taps if count * rate_hz >= self.filter_hz] or taps[-1:]

    def taps(self, rate_hz: float) -> int:
        """The shortest filter that is valid."""
        return self.possible_taps(rate_hz)[0]

    def delay_ns(self, taps: int) -> int:
        """Group delay of a filter: (taps - 1) / 2 of its input periods."""
        return round((taps - 1) / 2 / self.filter_hz * 1e9)


FALLING = (-0.0037918, 2634)  # degC per LSB, and the word at 25 degC
RISING = (1 / 256, 0)
TO_8_G = ((Register(0x12, 1), None, 0),)  # A_RANGE in GLOB_CMD3: otherwise 16 G and twice the scale

G350 = Model(
    *("G350", 0.0125, 0.125, 0.0042725, -15214, 300.0, 3.0),
    dialect=FLAT,
    profile="m-g350",
    tap_codes={2: 1, 4: 2, 8: 3, 16: 4, 32: 5, 64: 6, 128: 7},  # 2 kHz: its successors' rule, and the sheet's 125/s, 16
)
V340 = Model(
    *("V340", 0.015, 0.18, -0.0053964, 2634, 1000.0, 10.0),  # ranges not published: the end of the word
    dialect=FLAT,
    profile="consumer-mems",  # no noise figures published
    tap_codes={1: 2, 2: 3, 4: 4, 8: 5, 16: 6, 32: 7},
    filter_hz=1000.0,
)
MODELS = (
    G350,
    V340,
    Model("G320", 1 / 125, 1 / 5, *FALLING, 150.0, 5.0),
    Model("G330", 1 / 66, 1 / 4, *RISING, 450.0, 8.0, settings=TO_8_G),
    Model("G354", 1 / 62.5, 1 / 5, *FALLING, 450.0, 5.0),
    Model("G362", 0.005, 0.125, 0.0042725, -15214, 150.0, 3.0),
    Model("G364PDC0", 0.0075, 1 / 8, *FALLING, 200.0, 3.0),
    Model("G364PDCA", 0.00375, 1 / 8, *FALLING, 100.0, 3.0),
    Model("G365PDC", 1 / 66, 1 / 6.25, *FALLING, 450.0, 6.0),
    Model("G365PDF", 1 / 66, 1 / 2.5, *FALLING, 450.0, 10.0),
    Model("G366", 1 / 66, 1 / 4, *RISING, 450.0, 8.0, settings=TO_8_G),
    Model("G370PDF", 1 / 66, 1 / 2.5, *FALLING, 450.0, 10.0),
    Model("G370PDS", 1 / 150, 1 / 2.5, *FALLING, 200.0, 10.0),
    Model("G370PDG", 1 / 66, 1 / 4, *RISING, 450.0, 8.0, settings=TO_8_G),
    Model("G370PDT", 1 / 150, 1 / 4, *RISING, 200.0, 8.0, settings=TO_8_G),
)


def model_of(name: str) -> Model | None:
    """The model whose code stands in `name`, a product name or that of a model."""
    return next((model for model in MODELS if model.code in name), None)
