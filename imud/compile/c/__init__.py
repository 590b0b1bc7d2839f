"""Kernels as C: `Translation` collects them, `UnsupportedError` says what has no translation, and where."""

from .kinds import FLOAT, INT, Kind, UnsupportedError
from .translation import Translation

__all__ = ["FLOAT", "INT", "Kind", "Translation", "UnsupportedError"]
