"""Requests that are no gpsd's: what the daemon tells of itself, and what it has done for whom."""

from collections.abc import Callable, Mapping

from .connection import Connection
from .gpsd_dialogue import Answer, Request, error_object

FRESH_NS = 100_000_000  # an answer is not older than this


class OwnRequests:
    """Answers them. All times are monotonic nanoseconds; not thread-safe."""

    def __init__(self, told: Mapping[str, Callable[[], str]], orders: Mapping[str, Callable[[bytes], str]]) -> None:
        """told: who makes the objects that answer them; orders: who obeys those with an argument, and answers.

        Orders are taken of trusted clients only.
        """
        self._told, self._orders = told, orders
        self._made: dict[str, tuple[int, str]] = {}

    def answer(self, request: Request, client: Connection, now_ns: int) -> Answer | None:
        """None: the request is none of these."""
        command, argument, policy = request.command, request.argument, client.policy
        if argument is None and command in self._told:
            return Answer((self._fresh(command, now_ns),), policy)
        if argument is None or command not in self._orders:
            return None
        if not client.trusted:
            refusal = error_object(f"{command} only by a client on this machine that says nothing else")
            return Answer((refusal,), policy, refused=True)
        self._made.pop(command, None)
        return Answer((self._orders[command](argument),), policy)

    def _fresh(self, command: str, now_ns: int) -> str:
        """Made at most ten times a second, however many ask however often: it may be costly."""
        made_ns, text = self._made.get(command, (-FRESH_NS, ""))
        if now_ns - made_ns >= FRESH_NS:
            made_ns, text = now_ns, self._told[command]()
            self._made[command] = made_ns, text
        return text
