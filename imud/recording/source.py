"""Recordings as a user names them: files, in the order of one recording, with the settings they were made with."""

import re
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from importlib import util
from pathlib import Path
from typing import Any

import msgspec

from .. import __version__
from ..configuration.settings import Settings
from ..errors import BadDataError, ConfigError, InputMissingError, UsageError
from ..setup import config

_SETTINGS = "settings.json"  # name of the attachment


class Recording:
    """One recording: its files in order. `notes` says what is wrong with it, once it has been read."""

    def __init__(self, paths: Sequence[Path]) -> None:
        """Raises UsageError, InputMissingError, BadDataError."""
        if util.find_spec("mcap") is None:
            raise UsageError("recordings need the package mcap: pip install 'imud[record]'")
        from imud.drivers.capture import Capture
        from imud.drivers.capture_messages import FORMAT
        from imud.drivers.errors import CaptureError

        self.notes: list[str] = []
        self._files = ", ".join(map(str, paths))
        try:
            known = [(capture, *capture.session()) for capture in map(Capture, paths)]
        except CaptureError as error:
            raise BadDataError(str(error)) from error
        except OSError as error:
            raise InputMissingError(f"{error.filename} cannot be read: {error.strerror}") from error
        known.sort(key=lambda item: self._number(item[1], "part"))
        self._captures = [capture for capture, _, _ in known]
        self.facts = known[0][1]
        self._attached = known[0][2]
        self.paths = tuple(capture.path for capture in self._captures)
        self.path = self.paths[0]
        self.bytes = sum(path.stat().st_size for path in paths)
        if (written := self._number(self.facts, "format")) > FORMAT:
            raise BadDataError(
                f"{self.path} was made by a newer imud (format {written}, this one knows {FORMAT}): update"
            )
        numbers = [self._number(facts, "part") for _, facts, _ in known]
        if not self.facts:
            self.notes.append(f"{self.path} was not made by imud: there may be nothing in it that can be replayed")
        if numbers != list(range(len(numbers))):
            self.notes.append(f"{self.path}: parts {numbers} of a recording; what lies between them is missing")

    def _number(self, facts: dict[str, str], name: str) -> int:
        """A number of the metadata; 0 if it is missing. Raises BadDataError."""
        text = facts.get(name, "0")
        if not re.fullmatch(r"-?[0-9]{1,19}", text):
            raise BadDataError(f"{self._files} is damaged: {name} = {text[:40]!r} in its metadata is no number")
        return int(text)

    def settings(self, adapt: Callable[[Any], Settings]) -> Settings:
        """What it was made with, adapted. Raises BadDataError where the recording does not hold settings."""
        if self.facts and _SETTINGS not in self._attached:
            raise BadDataError(f"{self._files} is damaged: the settings that it was made with are missing")
        try:
            recorded = msgspec.json.decode(self._attached.get(_SETTINGS, b"{}"), type=dict[str, Any])
        except (msgspec.DecodeError, ValueError, RecursionError) as error:
            raise BadDataError(f"{self._files} is damaged: the settings in it cannot be read: {error}") from error
        return adapt(recorded)

    def __iter__(self) -> Iterator[Any]:
        """All messages (`imud.drivers.capture_messages.Entry`)."""
        return self.entries()

    def entries(self, topics: Collection[str] | None = None) -> Iterator[Any]:
        """Those on these topics; None: all."""
        for capture in self._captures:
            yield from capture.entries(topics)
            if capture.broken:
                self.notes.append(capture.broken)

    @property
    def unix_less_monotonic_ns(self) -> int:
        """Unix time minus the host's monotonic time, at the recording's start."""
        return self._number(self.facts, "unix_less_monotonic_ns")

    @property
    def read_bytes(self) -> int:
        """So far."""
        return sum(capture.read_bytes for capture in self._captures)

    def version_notes(self) -> list[str]:
        """Reasons why estimates may differ from the recorded ones although no setting was changed."""
        version = __version__
        recorded = self.facts.get("version", version)
        return [] if recorded == version else [f"recorded by imud {recorded}, this is {version}: estimates may differ"]


def group(paths: Sequence[Path]) -> tuple[list[Recording], list[str]]:
    """Recordings, each with all its files, and why others of several cannot be read. Raises ImudError if it is one.

    A second file of the same part is a copy, and a recording of its own.
    """
    sessions: dict[tuple[str, int], list[Recording]] = {}
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
            sessions.setdefault((session, seen[part]), []).append(single)
            seen[part] += 1
    return [
        parts[0] if len(parts) == 1 else Recording([path for part in parts for path in part.paths])
        for parts in sessions.values()
    ], failed


def print_notes(command: str, notes: Sequence[str]) -> None:
    """Print on stderr what is wrong with a recording."""
    for note in notes:
        print(f"{f'imud {command}'.strip()}: {note}", file=sys.stderr)


def adapter(file: Path | None, overrides: Sequence[str], estimator: str | None) -> Callable[[Any], Settings]:
    """From recorded settings to those to replay with: the recorded ones, or `file`'s, and what overrides them."""

    def adapt(recorded: Any) -> Settings:
        chosen = config.load(file, overrides) if file else _with_overrides(recorded, overrides)
        ports = recorded.get("ports", ()) if isinstance(recorded, dict) else ()
        chosen = msgspec.structs.replace(chosen, ports=tuple(map(str, ports)))
        return msgspec.structs.replace(chosen, estimator=estimator) if estimator else chosen

    return adapt


def _with_overrides(recorded: Any, overrides: Sequence[str]) -> Settings:
    """Raises ConfigError for what the user asked for, BadDataError for what the recording holds."""
    if not isinstance(recorded, dict):
        raise BadDataError("the recording holds no settings; name a configuration with --config")
    config.from_table({}, overrides, "the options")
    try:
        return config.from_table(recorded, overrides, "the recording")
    except ConfigError as error:
        raise BadDataError(
            f"the settings in the recording are not valid; name others with --config: {error}"
        ) from error
