"""`python -m imud.commands.bench.observed FILE COMMAND …`: runs a command, and writes its interpreter's counts to FILE.

As JSON: functions compiled since READY; and since the last device connected, for which drivers are imported, pauses of
the garbage collector in ns, objects that it visits, blocks of memory that stayed allocated.
"""

import gc
import json
import sys
import time
from pathlib import Path
from typing import Any

from ...process import garbage


class Observer:
    """Hooks of the interpreter and of numba. One per process."""

    def __init__(self) -> None:
        self.pauses_ns: list[int] = []
        self.compiled = self.objects = 0
        self.ready = False
        self._begin_ns = self._blocks = 0
        self._compilations: Any = None
        gc.callbacks.append(self._collecting)

    def watch(self) -> None:
        """To be called before the daemon starts."""
        from ...process.notify import Notifier

        say = Notifier.send

        def observed(notifier: Notifier, *assignments: str) -> None:
            if "READY=1" in assignments:
                self.ready, self._blocks, self._compilations = True, sys.getallocatedblocks(), _recorded()
            if "STOPPING=1" in assignments:
                self.ready, self.compiled = False, self._count()
                self._blocks = sys.getallocatedblocks() - self._blocks
                self.objects = len(gc.get_objects())
            say(notifier, *assignments)

        Notifier.send = observed  # type: ignore[method-assign, assignment]
        set_aside = garbage.set_aside

        def unobserved() -> None:
            ready, self.ready = self.ready, False
            set_aside()
            self.ready = ready
            self.pauses_ns.clear()
            self._blocks = sys.getallocatedblocks()

        garbage.set_aside = unobserved

    def _count(self) -> int:
        """Count a compilation if numba is loaded only now: nothing else would load it."""
        return int("numba" in sys.modules) if self._compilations is None else len(self._compilations.buffer)

    def _collecting(self, phase: str, info: dict[str, int]) -> None:
        now_ns = time.thread_time_ns()
        if phase == "start":
            self._begin_ns = now_ns
        elif self.ready:
            self.pauses_ns.append(now_ns - self._begin_ns)

    def report(self) -> dict[str, Any]:
        self.ready = True
        gc.collect()
        *during, full = self.pauses_ns
        pauses = {"pauses_ns": during, "full_collection_ns": full, "objects": self.objects}
        return {**pauses, "compiled": self.compiled, "blocks": self._blocks}


def _recorded() -> Any:
    """numba's compilations from now on; None if numba is not loaded."""
    if "numba" not in sys.modules:
        return None
    from numba.core import event

    recorder: Any = event.RecordingListener()  # type: ignore[no-untyped-call]
    event.register("numba:compile", recorder)  # type: ignore[no-untyped-call]
    return recorder


def main() -> int:
    file, *arguments = sys.argv[1:]
    observer = Observer()
    observer.watch()
    from .. import main as imud

    code = imud(arguments)
    Path(file).write_text(json.dumps(observer.report()))
    return code


if __name__ == "__main__":
    sys.exit(main())
