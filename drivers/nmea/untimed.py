"""VTG has no time: the pauses of the line before and after it show of which burst it is, the one before or the next."""

from dataclasses import dataclass

from .content import Vtg
from .sentences import Sentence

ADJACENT, SAME_BURST = 0.25, 0.5  # intervals between fixes: at most so long is a pause in a burst, surely; perhaps
NEARER = 2  # times as long is the pause on the one side as that on the other


@dataclass
class HeldVtg:
    """A VTG that waits for the next sentence. `before_ns`, `after_ns`: pauses of the line; None: nothing came yet."""

    sentence: Sentence
    content: Vtg
    before_ns: int
    after_ns: int | None = None

    @property
    def is_of_next(self) -> bool:
        """Whether the burst that begins after it is nearer than the one before."""
        return self.after_ns is not None and self.before_ns > NEARER * self.after_ns
