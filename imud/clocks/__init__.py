"""Time: devices' counters and receivers' UTC on the host's monotonic clock."""
