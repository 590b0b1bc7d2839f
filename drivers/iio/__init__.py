"""Inertial sensors that the Linux kernel has a driver of: Industrial I/O."""
