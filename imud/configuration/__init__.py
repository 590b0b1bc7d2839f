"""What a user may set: the keys, how they are read, and what they make of a daemon."""
