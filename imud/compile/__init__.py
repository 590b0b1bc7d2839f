"""Kernels as machine code: `c` translates them to C."""
