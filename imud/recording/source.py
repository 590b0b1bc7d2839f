"""Recordings as a user names them: files, in the order of one recording, with the settings they were made with."""

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata, util
from pathlib import Path
from typing import Any

import msgspec

from ..configuration import config
from ..configuration.settings import Settings
from ..errors import BadDataError, InputMissingError, UsageError


class Recording:
    """One recording: its files in order. `notes` tells what is wrong with it, once it has been read."""

    def __init__(self, paths: Sequence[Path]) -> None:
        """Raises UsageError, InputMissingError, BadDataError."""
        if util.find_spec("mcap") is None:
            raise UsageError("recordings need the package mcap: pip install 'imud[record]'")
        from drivers.capture import Capture
        from drivers.errors import CaptureError

        self.notes: list[str] = []
        try:
            known = [(capture, *capture.session()) for capture in map(Capture, paths)]
        except CaptureError as error:
            raise BadDataError(str(error)) from error
        except OSError as error:
            raise InputMissingError(f"{error.filename} cannot be read: {error.strerror}") from error
        known.sort(key=lambda item: int(item[1].get("part", 0)))
        self._captures = [capture for capture, _, _ in known]
        self.facts = known[0][1]
        self._attached = known[0][2]
        self.paths = tuple(capture.path for capture in self._captures)
        self.path = self.paths[0]
        self.bytes = sum(path.stat().st_size for path in paths)
        numbers = [int(facts.get("part", 0)) for _, facts, _ in known]
        if not self.facts:
            self.notes.append(f"{self.path} was not made by imud: there may be nothing in it that can be replayed")
        if numbers != list(range(len(numbers))):
            self.notes.append(f"{self.path}: parts {numbers} of a recording; what lies between them is missing")

    def settings(self, adapt: Callable[[Any], Settings]) -> Settings:
        """What it was made with, adapted."""
        return adapt(msgspec.json.decode(self._attached.get("settings.json", b"{}")))

    def __iter__(self) -> Iterator[Any]:
        """All messages (`drivers.capture.Entry`)."""
        for capture in self._captures:
            yield from capture
            if capture.broken:
                self.notes.append(capture.broken)

    @property
    def unix_less_monotonic_ns(self) -> int:
        """Unix time minus the host's monotonic time, at the recording's start."""
        return int(self.facts.get("unix_less_monotonic_ns", 0))

    @property
    def read_bytes(self) -> int:
        """So far."""
        return sum(capture.read_bytes for capture in self._captures)

    def doubts(self) -> list[str]:
        """Reasons why estimates may differ from the recorded ones although no setting was changed."""
        version = metadata.version("imud")
        recorded = self.facts.get("version", version)
        return [] if recorded == version else [f"recorded by imud {recorded}, this is {version}: estimates may differ"]


def group(paths: Sequence[Path]) -> tuple[list[Recording], list[str]]:
    """Recordings, each with all its files, and why others of several cannot be read. Raises ImudError if it is one.

    A second file of the same part is a copy, and a recording of its own.
    """
    sessions: dict[tuple[str, int], list[Path]] = {}
    seen = Counter[tuple[str, str]]()
    failed: list[str] = []
    for path in paths:
        try:
            single = Recording([path])
        except (BadDataError, InputMissingError) as error:
            if len(paths) == 1:
                raise
            failed.append(str(error))
        else:
            session = single.facts.get("session", str(path))
            part = session, single.facts.get("part", "")
            sessions.setdefault((session, seen[part]), []).append(path)
            seen[part] += 1
    return [Recording(files) for files in sessions.values()], failed


def tell(command: str, notes: Sequence[str]) -> None:
    """Print on stderr what is wrong with a recording."""
    for note in notes:
        print(f"imud{command and ' '}{command}: {note}", file=sys.stderr)


def adapter(file: Path | None, overrides: Sequence[str], estimator: str | None) -> Callable[[Any], Settings]:
    """From recorded settings to those to replay with: the recorded ones, or `file`'s, and what overrides them."""

    def adapt(recorded: Any) -> Settings:
        ports = tuple(recorded.get("ports", ()))
        chosen = config.load(file, overrides) if file else config.from_table(recorded, overrides, "the recording")
        chosen = msgspec.structs.replace(chosen, ports=ports)
        return msgspec.structs.replace(chosen, estimator=estimator) if estimator else chosen

    return adapt
