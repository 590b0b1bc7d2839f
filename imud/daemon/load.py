"""Whether the machine keeps up with the sensor: by the number of samples that wait when the daemon reads.

States go to the stream and the shared memory in any case: that is compiled and takes microseconds. Messages for other
clients are made in Python. While batches keep coming late (an overload), they are made after some batches only, so that
estimation gets the processor; after all of them where that takes little time, as when another program or the sensor's
own line delays the batches.
"""

LATE_S, LATE_SAMPLES = 0.1, 5  # a batch is late if its samples span more time, and if it has at least so many
OVERLOAD_NS = 1_000_000_000  # lateness that lasts longer is an overload
RECOVERY_NS = 500_000_000  # time without a late batch that ends an overload
OVERLOAD_PERIOD_NS = 500_000_000  # between batches with messages during an overload
CHEAP_SHARE = 0.2  # of the processor's time: messages that take less never wait
STALL_NS = 1_000_000_000  # time between two checks that means that the process did not run


class Load:
    """Measures how late batches are. All times are monotonic nanoseconds; not thread-safe."""

    def __init__(self) -> None:
        self.overloaded = False
        self.shed = 0  # batches without messages during the last overload
        self._since_ns: int | None = None  # time of the first late batch in a row
        self._late_ns = 0  # time of the last late batch
        self._published_ns = 0
        self._share = 1.0  # processor time of the last messages over the time that their batch spans
        self._reported = False
        self._lost_before = 0

    def max_batch(self, period_s: float) -> int:
        """The largest batch after which messages may be sent without asking; -1: none, during an overload."""
        return -1 if self.overloaded else max(LATE_SAMPLES - 1, int(LATE_S / period_s))

    def leaves_time_for_messages(self, n: int, period_s: float, now_ns: int) -> bool:
        """Count a batch of n samples; returns whether to send messages after it."""
        if n >= LATE_SAMPLES and n * period_s > LATE_S:
            self._since_ns = now_ns if self._since_ns is None else self._since_ns
            self._late_ns = now_ns
        else:
            self._look_for_recovery(now_ns)
        self.overloaded = self._since_ns is not None and self._late_ns - self._since_ns > OVERLOAD_NS
        if self.overloaded and self._share > CHEAP_SHARE and now_ns - self._published_ns < OVERLOAD_PERIOD_NS:
            self.shed += 1
            return False
        self._published_ns = now_ns
        return True

    def _look_for_recovery(self, now_ns: int) -> None:
        if now_ns - self._late_ns > RECOVERY_NS:
            self._since_ns = None

    def published(self, n: int, period_s: float, processor_ns: int) -> None:
        """Messages were sent after a batch of n samples, which took `processor_ns` of processor time."""
        self._share = processor_ns * 1e-9 / (n * period_s)

    @property
    def is_settled(self) -> bool:
        """Whether no batch was late of late."""
        return self._since_ns is None and self.overloaded == self._reported

    def messages(self, lost: int, gap_ns: int, now_ns: int) -> list[str]:
        """Lines for the log since the last call; call it ten times a second while it is not settled.

        lost: samples so far; gap_ns: time since the fast loop's last check.
        """
        if not self.overloaded:  # then batches that are not late do not come here
            self._look_for_recovery(now_ns)
        texts = []
        if gap_ns > STALL_NS:
            texts += [
                f"this process stood still for {gap_ns * 1e-9:.1f} s: it was stopped, or starved of processor time"
            ]
        if self.overloaded != self._reported:
            self._reported = self.overloaded
            texts += [self._overload_message(lost)]
        return texts

    def _overload_message(self, lost: int) -> str:
        """The line with which an overload begins or ends."""
        if self.overloaded:
            self._lost_before, self.shed = lost, 0
            return "the machine cannot keep up with the sensor: estimation and stream go on, other messages may wait"
        lost -= self._lost_before if lost >= self._lost_before else 0  # counted anew after a reconnect
        return f"the machine keeps up again; {lost} samples lost, {self.shed} batches without messages"
