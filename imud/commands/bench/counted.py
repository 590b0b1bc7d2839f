"""`python -m imud.commands.bench.counted [OPTION …]`: replays on request, while callgrind counts the instructions.

OPTIONs are passed to the C compiler. A request is a line `ours N` or `c N` on stdin: turn N frames of an M-G350 into
attitude solutions. One line answers each request.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def main() -> int:
    from . import reference, signals, throughput

    wire = np.ascontiguousarray(signals.frames(10_000)).reshape(-1)
    period_ns = 1_000_000 // signals.FRAME
    contestants: dict[str, Callable[[Any, int], int]] = {
        "ours": lambda wire, period_ns: throughput.replay_wire(throughput.attitude_pipeline(), wire, period_ns)
    }
    with tempfile.TemporaryDirectory() as folder:
        try:
            contestants["c"] = throughput.CReplay(Path(folder), sys.argv[1:])
        except reference.NoReferenceError as error:
            print(error)
        else:
            print("ready")
        sys.stdout.flush()
        for line in sys.stdin:
            name, n = line.split()
            print(contestants[name](wire[: int(n) * signals.FRAME], period_ns), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
