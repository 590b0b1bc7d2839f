"""What a user may set: the keys, with their types, ranges, units and defaults."""

from ..late_imports import hidden

with hidden("typing_extensions"):  # which msgspec does without
    import msgspec  # noqa: F401
