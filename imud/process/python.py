"""Python, to run a module of this imud in a process of its own."""

import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]


def python_command(module: str, *arguments: str) -> list[str]:
    """What runs a module of this imud: one that the current folder happens to hold is not imported.

    Python's -m looks there first, which is right only where this imud is: `python -m imud` in a checkout.
    """
    safe = () if Path.cwd() == _ROOT else ("-P",)
    return [sys.executable, *safe, "-m", module, *arguments]
