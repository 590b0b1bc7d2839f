"""Whether the machine keeps up with the sensor, judged from how much waits when the daemon comes to read.

A single late batch is a hiccup: it is worked off whole. If batches keep coming late there is no time for everything;
publishing is then cut down to a trickle, so that estimation gets the time.
"""

LATE_S, LATE_SAMPLES = 0.1, 5  # a batch is late if it holds more time than that, and at least so many samples
PATIENCE_NS = 1_000_000_000  # lateness that lasts longer is an overload
CALM_NS = 500_000_000  # without a late batch, after which lateness is over
TRICKLE_NS = 500_000_000  # between batches published during an overload
STANDSTILL_NS = 1_000_000_000  # between two looks: the process did not run


class Load:
    """Takes note of batches. All times are monotonic nanoseconds; not thread-safe."""

    def __init__(self) -> None:
        self.overloaded = False
        self.shed = 0  # batches that were not published in this spell
        self._since_ns: int | None = None  # of the first late batch of this spell
        self._late_ns = 0  # of the last one
        self._published_ns = 0
        self._looked_ns = 0
        self._told = False
        self._lost_before = 0

    def usual(self, period_s: float) -> int:
        """The largest batch that may be published without asking; -1: none, while lateness is being watched."""
        return max(LATE_SAMPLES - 1, int(LATE_S / period_s)) if self._since_ns is None else -1

    def leaves_time_to_publish(self, n: int, period_s: float, now_ns: int) -> bool:
        """Take note of a batch of n samples; returns whether to publish it."""
        if n >= LATE_SAMPLES and n * period_s > LATE_S:
            self._since_ns = now_ns if self._since_ns is None else self._since_ns
            self._late_ns = now_ns
        elif self._since_ns is not None and now_ns - self._late_ns > CALM_NS:
            self._since_ns = None
        self.overloaded = self._since_ns is not None and self._late_ns - self._since_ns > PATIENCE_NS
        if self.overloaded and now_ns - self._published_ns < TRICKLE_NS:
            self.shed += 1
            return False
        self._published_ns = now_ns
        return True

    def news(self, lost: int, now_ns: int) -> list[str]:
        """Lines for the log since the last call; call it several times a second. lost: samples lost so far."""
        gap_ns = now_ns - self._looked_ns if self._looked_ns else 0
        self._looked_ns = now_ns
        told = []
        if gap_ns > STANDSTILL_NS:
            told += [
                f"this process stood still for {gap_ns * 1e-9:.1f} s: it was stopped, or starved of processor time"
            ]
        if self.overloaded != self._told:
            self._told = self.overloaded
            told += [self._turn(lost)]
        return told

    def _turn(self, lost: int) -> str:
        """The line with which an overload begins or ends."""
        if self.overloaded:
            self._lost_before, self.shed = lost, 0
            return "the machine cannot keep up with the sensor: publishing waits, estimation goes on"
        lost -= self._lost_before if lost >= self._lost_before else 0  # counted anew after a reconnect
        return f"the machine keeps up again; {lost} samples lost, {self.shed} batches not published"
