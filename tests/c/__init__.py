"""The C side of the comparison: kernels translated, and the daemon around them. `imud.bench.reference` loads it."""
