"""The driver's decoder: one kernel for both dialects, and the state with which it begins."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..driver import ImuConfigured
from ..jit import kernel
from ..sample import STANDARD_GRAVITY
from .dialects import WINDOWED
from .flat import CONSTANT, SHORT, decode_flat
from .models import G350, model_of
from .state import new_state
from .windowed import NUMBERED, READABLE, decode_windowed

SPIKE_RADPS, SPIKE_MPS2 = math.radians(20.0), 0.25 * STANDARD_GRAVITY  # per ms: more than motion makes within 140 Hz


def state_for(configured: ImuConfigured) -> NDArray[np.void]:
    """A fresh decoder state (array of one `STATE`) for the stream that was configured."""
    model = model_of(configured.identity.model) or G350
    windowed = model.dialect is WINDOWED
    state = new_state(model, READABLE[configured.frame_bytes] if windowed else 2)
    state["windowed"], state["numbered"] = windowed, configured.frame_bytes in NUMBERED
    state["polled"] = configured.request is not None
    state["length"] = configured.frame_bytes
    if not windowed:
        state["length"], state["mask"] = SHORT, CONSTANT
    per_ms = configured.period_ns * 1e-6
    floors = SPIKE_RADPS * per_ms / state["gyro_scale"][0], SPIKE_MPS2 * per_ms / state["accel_scale"][0]
    state["spikes"]["floor"] = np.repeat(floors, 3)
    return state


@kernel
def decode(rx: NDArray[np.uint8], fill: int, state: NDArray[np.void], samples: NDArray[np.void]) -> int:
    """See `ImuDriver.decode`. rx must hold 64 bytes more than one read brings; samples at least one row."""
    s: Any = state[0]
    if s.windowed:
        return decode_windowed(rx, fill, s, samples)
    return decode_flat(rx, fill, s, samples)
