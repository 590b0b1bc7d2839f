"""Crossbow DMU RGA300CA: an inertial sensor with one gyro (docs/protocols.md §2)."""
