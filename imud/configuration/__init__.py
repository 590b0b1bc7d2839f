"""What a user may set: the keys, with their types, ranges, units and defaults."""
