"""NMEA 0183: receivers, and compasses, logs and barometers (docs/protocols.md §4)."""
