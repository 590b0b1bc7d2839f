"""What the navigation filter has found that contradicts the settings, in words."""

from ...math.arrays import Records
from .state import LAND

_NO_LAND_VEHICLE = 'the vehicle moves sideways, or up and down: navigation.vehicle = "land" is not used'


def findings(parameters: Records, state: Records) -> tuple[str, ...]:
    """See `Estimator`."""
    nhc = state["core"][0, 0]["nhc"]
    is_dropped = parameters["vehicle"][0] == LAND and nhc["disable_count"] > 0 and not nhc["enabled"]
    return (_NO_LAND_VEHICLE,) if is_dropped else ()
