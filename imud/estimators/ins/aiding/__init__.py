"""Measurements, real or assumed, one file each: innovation, Jacobian, noise, gate; `fusion` fuses them."""
