"""A reading of a receiver's protocol as the values of an aiding source, by the columns of its table."""

import math

from imud.drivers.fix import Reading

from ..configuration.settings import Aiding, Gnss

_LEAST_SIGMA_DEG = 0.05  # of a heading: some round theirs to zero
_SCALE_HEIGHT_M = 8434.0  # of the atmosphere at 288 K: what a relative error of the pressure is in height


def measured_of(reading: Reading, gnss: Gnss, aiding: Aiding) -> tuple[str, dict[str, float]] | None:
    """The name of the source, and its values by column; None: the settings leave such readings out."""
    sigma = math.nan if reading.sigma is None else reading.sigma
    if reading.source == "heading" and gnss.heading:
        sigma_deg = math.nan if math.isnan(sigma) else max(sigma, _LEAST_SIGMA_DEG)
        return "heading", {"heading_deg": reading.value, "sigma_deg": sigma_deg}
    if reading.source == "pressure":
        return "barometer", {"pressure_pa": reading.value, "sigma_m": _SCALE_HEIGHT_M * sigma / reading.value}
    if reading.source == "speed":
        return "odometer", {"speed_mps": reading.value, "sigma_mps": sigma}
    if reading.source == "water speed" and aiding.current_mps > 0.0:
        return "odometer", {"speed_mps": reading.value, "sigma_mps": sigma, "current_mps": aiding.current_mps}
    return None
