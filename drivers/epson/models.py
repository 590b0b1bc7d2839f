"""The models of the flat dialect, one row each: scale factors, output rates and filters.

Sources: M-G350-PD11 brief sheet (2013); Epson's public driver for the V340 (sensor_epsonV340.h).
"""

import math
from dataclasses import dataclass

STANDARD_GRAVITY = 9.80665  # m/s^2

RATES = {1: 1000.0, 2: 500.0, 3: 250.0, 4: 125.0, 5: 62.5, 6: 31.25, 7: 15.625}
"""Output rate in samples per second by the code in the high byte of SMPL_CTRL."""


@dataclass(frozen=True)
class Model:
    """One row. Scales are per LSB of the signed 16-bit words."""

    name: str
    product_code: str  # stands in PROD_ID
    profile: str
    gyro_dps: float
    accel_mg: float
    temperature_degc: float
    temperature_raw_25: int  # the word at 25 degC
    range_lsb: int  # |word| at the end of the rated range
    tap_codes: dict[int, int]  # number of taps of the moving average: code in the low byte of MODE_CTRL
    filter_hz: float  # a rate is valid with at least filter_hz / rate taps

    @property
    def gyro_scale(self) -> float:
        """rad/s per LSB."""
        return math.radians(self.gyro_dps)

    @property
    def accel_scale(self) -> float:
        """m/s^2 per LSB."""
        return self.accel_mg * 1e-3 * STANDARD_GRAVITY

    @property
    def rates(self) -> dict[int, float]:
        """The rows of `RATES` that this model has a valid filter for."""
        longest = max(self.tap_codes)
        return {code: rate for code, rate in RATES.items() if longest * rate >= self.filter_hz}

    def taps(self, rate_hz: float) -> int:
        """The shortest valid filter, for the least delay."""
        return min(taps for taps in self.tap_codes if taps * rate_hz >= self.filter_hz)

    def delay_ns(self, rate_hz: float) -> int:
        """Group delay of that filter: (taps - 1) / 2 of its input periods."""
        return round((self.taps(rate_hz) - 1) / 2 / self.filter_hz * 1e9)


G350 = Model(
    name="M-G350",
    product_code="G350",
    profile="m-g350",
    gyro_dps=0.0125,
    accel_mg=0.125,
    temperature_degc=0.0042725,
    temperature_raw_25=-15214,
    range_lsb=24000,  # 300 deg/s and 3 G
    tap_codes={2: 1, 4: 2, 8: 3, 16: 4, 32: 5, 64: 6, 128: 7},
    filter_hz=2000.0,  # its successors' rule; the brief sheet's own pair, 125/s with 16 taps, agrees
)
V340 = Model(
    name="M-V340",
    product_code="V340",
    profile="consumer-mems",  # no noise figures published
    gyro_dps=0.015,
    accel_mg=0.18,
    temperature_degc=-0.0053964,
    temperature_raw_25=2634,
    range_lsb=32767,
    tap_codes={1: 2, 2: 3, 4: 4, 8: 5, 16: 6, 32: 7},
    filter_hz=1000.0,
)
MODELS = (G350, V340)


def model_of(product_id: str) -> Model:
    """The model that says `product_id` of itself; an M-G350, which may say nothing, if no other fits."""
    return next((model for model in MODELS if model.product_code in product_id), G350)
