"""Emulated devices, at the other end of the wire: they share no code with the drivers, so no mistake either."""
