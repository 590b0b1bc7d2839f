"""Which recording a daemon makes: the one it was started with, or one that a client on this machine begins and ends.

A client never names a file: it is made in `record.folder`, if there is one, and named after the time.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import msgspec

from ..configuration.settings import Settings
from ..errors import ImudError
from ..folders import forbids_writing

if TYPE_CHECKING:
    from .recorder import Recorder

_PAUSE_S = 2.0  # between the beginnings of recordings that clients ask for
LogLines = list[tuple[str, str]]


class _Command(msgspec.Struct, forbid_unknown_fields=True):
    enable: bool


class Recordings:
    """Never waits except in `close`. Not thread-safe. `current` is the recorder at work; None: nothing is recorded.

    on_begin: called when a client has begun one, for the sensors that stream already; on_end: when it has ended it.
    """

    def __init__(self, settings: Settings) -> None:
        """Begins the recording of `settings.record.path`. Raises UsageError, CannotCreateError."""
        self.current = _recorder(settings) if settings.record.path else None
        self.on_begin: Callable[[], None] = lambda: None
        self.on_end: Callable[[], None] = lambda: None
        self._settings = settings
        self._configured = self.current is not None
        self._closing: list[Recorder] = []
        self._begun_s = -math.inf
        self._trouble = folder_trouble(settings.record.folder)
        self._trouble_reported = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        if self.current and isinstance(error, ImudError):
            self.current.discard_unused()
        for recorder in filter(None, (self.current, *self._closing)):
            recorder.close()

    def event(self, level: str, text: str, facts: dict[str, Any]) -> None:
        """A line of the log."""
        if self.current:
            self.current.record_event(level, text, facts)

    @property
    def is_settled(self) -> bool:
        """Whether no recording is being made or finished."""
        return self.current is None and not self._closing

    def tick(self) -> LogLines:
        """Call several times per second; returns (level, text) of each new line for the log."""
        self._closing = [recorder for recorder in self._closing if not recorder.is_finished()]
        messages = [] if self._trouble_reported or not self._trouble else [("warning", self._trouble)]
        self._trouble_reported = True
        messages += self.current.tick() if self.current else []
        if self.current and self.current.has_lost_its_writer and not self._configured:
            self._trouble = self.current.state["trouble"]
            self._set_recording(False)  # the client may begin another one
        return messages

    def status(self, misunderstood: str = "") -> str:
        """The answer to ?RECORD. misunderstood: why the one that asks was not understood, which is no one else's."""
        state = self.current.state if self.current else {}
        answer = {
            "class": "RECORD",
            "allowed": bool(self._settings.record.folder) and not self._configured,
            "recording": self.current is not None,
            "path": state.get("path", ""),
            "bytes": state.get("bytes", 0),
            "trouble": misunderstood or state.get("trouble", "") or self._trouble,
        }
        return msgspec.json.encode(answer).decode()

    def handle_command(self, argument: bytes) -> str:
        """The answer to ?RECORD={"enable":…}, once it is done; why it cannot be is in it."""
        try:
            command = msgspec.json.decode(argument, type=_Command)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return self.status(f"what is to be done? {error}")
        self._trouble = ""
        self._trouble_reported = True  # the client reads the next one
        self._set_recording(command.enable)
        return self.status()

    def _set_recording(self, enable: bool) -> None:
        if not self._settings.record.folder:
            self._trouble = "the daemon has no folder for recordings: set record.folder"
        elif self._configured:
            self._trouble = "the daemon records by its configuration (record.path)"
        elif enable and self.current is None:
            self._begin()
        elif not enable and self.current is not None:
            self._closing.append(self.current)
            self.current.begin_close()
            self.current = None
            self.on_end()

    def _begin(self) -> None:
        if self._closing or time.monotonic() - self._begun_s < _PAUSE_S:  # each is a process, and a file
            self._trouble = f"the recording before has only just been made: try again in {_PAUSE_S:g} s"
            return
        self._begun_s = time.monotonic()
        path = Path(self._settings.record.folder) / time.strftime("imud-%Y%m%d-%H%M%SZ.mcap", time.gmtime())
        record = msgspec.structs.replace(self._settings.record, path=str(path))
        try:
            self.current = _recorder(msgspec.structs.replace(self._settings, record=record))
        except (ImudError, OSError) as error:
            self._trouble = str(error)
        else:
            self.on_begin()


def _recorder(settings: Settings) -> "Recorder":
    from .recorder import Recorder  # which a daemon that records nothing does not need

    return Recorder(settings)


def folder_trouble(folder: str) -> str:
    """Why no recording can be made in `record.folder`; empty: nothing is known against it, or there is none."""
    if not folder:
        return ""
    try:
        why = forbids_writing(Path(folder)) if Path(folder).is_dir() else "there is no such folder"
    except OSError as error:
        why = error.strerror or str(error)
    return f"no recordings can be made in {folder} (record.folder): {why}" if why else ""
