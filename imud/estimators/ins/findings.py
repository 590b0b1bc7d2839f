"""What the navigation filter has found that contradicts the settings, in words."""

import numpy as np

from ...compile.jit import interpreted
from ...math.arrays import Records
from ...math.kalman import packed_index
from .state import GNSS_LEVER_ARM, LAND, NAVIGATING, STATES

_NO_LAND_VEHICLE = 'the vehicle moves sideways, or up and down: navigation.vehicle = "land" is not used'

_FOUND = "; `imud status`, or `imud replay --states`, has what was found (gnss_lever_arm_x_m, …)"
_ANTENNA_ELSEWHERE = (
    f"the fixes show an antenna that is not where navigation.lever_arm_m says: measure it again{_FOUND}"
)
_ANTENNA_AWAY = (
    f"the fixes show an antenna away from the sensor, and navigation.lever_arm_m is not set: measure and set it{_FOUND}"
)
_ELSEWHERE_M, _ELSEWHERE_SIGMAS = 0.5, 4.0
_ARM_IN_P = [interpreted(packed_index)(STATES, k, k) for k in range(GNSS_LEVER_ARM, GNSS_LEVER_ARM + 3)]


def findings(parameters: Records, state: Records) -> tuple[str, ...]:
    """See `Estimator`."""
    c = state["core"][0, 0]
    nhc = c["nhc"]
    is_dropped = parameters["vehicle"][0] == LAND and nhc["disable_count"] > 0 and not nhc["enabled"]
    found = {
        _NO_LAND_VEHICLE: is_dropped,
        _ANTENNA_ELSEWHERE if parameters["lever_arm_is_set"][0] else _ANTENNA_AWAY: _is_elsewhere(c),
        _late_velocity(parameters["tuning"]["max_lag_s"][0]): state["velocity_lag"]["late"][0] != 0,
    }
    return tuple(text for text, is_so in found.items() if is_so)


def _late_velocity(max_lag_s: float) -> str:
    return (
        f"the receiver's velocity lags behind its positions by more than {max_lag_s:g} s and is not used: the receiver "
        "smooths it, or sends that of an earlier epoch; choose a dynamic model for faster motion there, or switch its "
        "smoothing off"
    )


def _is_elsewhere(c: np.void) -> bool:
    """Whether the estimated lever arm contradicts the one of the settings."""
    if c["alignment"]["mode"] != NAVIGATING:
        return False
    away = np.abs(c["nav"]["gnss_lever_arm"] - c["gnss"]["given_lever_arm"])
    sigma = np.sqrt(np.maximum(c["cov"]["P"][_ARM_IN_P], 0.0))
    return bool((away > np.maximum(_ELSEWHERE_M, _ELSEWHERE_SIGMAS * sigma)).any())
