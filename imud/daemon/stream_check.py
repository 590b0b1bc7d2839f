"""Checks of what streams: a device that fell silent, an inertial sensor at another rate than agreed."""

from ..sensors.inertial import Inertial
from ..sensors.rate import ALIKE
from ..sensors.receiver import Receiver
from .fast_loop import PAUSE_NS


class StreamCheck:
    """Call `tick` several times a second, before the checks. Times are monotonic nanoseconds; not thread-safe."""

    def __init__(self) -> None:
        self._running_since_ns = 0  # the end of the last pause of this process
        self._restarted_at: float | None = None  # ratio to the agreed rate for which the sensor was last set up anew

    def tick(self, gap_ns: int, now_ns: int) -> None:
        """Notice pauses of this process: a silence may be its own. gap_ns: since the fast loop's last check."""
        if gap_ns > PAUSE_NS:
            self._running_since_ns = now_ns

    def silent_from_ns(self, sensor: Inertial | Receiver) -> int:
        """From when on nothing of use will have come for too long, if nothing comes."""
        return max(sensor.last_data_ns, self._running_since_ns) + sensor.silence_ns

    def wrong_rate(self, sensor: Inertial) -> str:
        """Why to set up the sensor anew; empty: no reason. One that keeps its wrong rate is set up anew once only."""
        ratio = sensor.rate_ratio()
        if ratio == 1.0:
            self._restarted_at = None
        elif ratio and (self._restarted_at is None or abs(ratio / self._restarted_at - 1.0) > ALIKE):
            self._restarted_at = ratio
            agreed_hz = 1.0 / sensor.period_s
            return f"about {ratio * agreed_hz:.3g} samples/s come, {agreed_hz:g} were agreed: set up anew"
        return ""
