"""Requests that gpsd does not have: queries of the daemon's state, and commands to the daemon."""

from collections.abc import Callable, Mapping

from .connection import Connection
from .gpsd_dialogue import Answer, Request, error_object

FRESH_NS = 100_000_000  # an answer is not older than this


class ExtensionRequests:
    """Answers the queries and commands of the daemon. All times are monotonic nanoseconds; not thread-safe."""

    def __init__(
        self, queries: Mapping[str, Callable[[], str]], commands: Mapping[str, Callable[[bytes], str]]
    ) -> None:
        """queries: by request, the function that makes the answer; commands: the function that takes the argument,
        carries the command out and makes the answer. Only trusted clients may send commands.
        """
        self._queries, self._commands = queries, commands
        self._cached: dict[str, tuple[int, str]] = {}

    def answer(self, request: Request, client: Connection, now_ns: int) -> Answer | None:
        """The answer; None: the request is neither a query nor a command of the daemon."""
        command, argument, policy = request.command, request.argument, client.policy
        if argument is None and command in self._queries:
            return Answer((self._cached_answer(command, now_ns),), policy)
        if argument is None or command not in self._commands:
            return None
        if not client.trusted:
            error = error_object(f"{command} only by a client on this machine that sends no other text")
            return Answer((error,), policy, refused=True)
        self._cached.pop(command, None)
        return Answer((self._commands[command](argument),), policy)

    def _cached_answer(self, command: str, now_ns: int) -> str:
        """The answer to a query, made anew at most ten times per second: making it may be costly."""
        cached_ns, text = self._cached.get(command, (-FRESH_NS, ""))
        if now_ns - cached_ns >= FRESH_NS:
            cached_ns, text = now_ns, self._queries[command]()
            self._cached[command] = cached_ns, text
        return text
