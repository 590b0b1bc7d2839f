"""Watches the readings of an inertial sensor: whether each can be true, and where its ranges end."""
