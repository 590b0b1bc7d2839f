"""The C side of the comparison: kernels translated, and a daemon around them; `commands.bench.reference` loads it."""
