"""Fault detection: is the receiver frozen, does it contradict itself, are heading and gyro bias right?

The tests that follow every update of the filter are in `glr_tests/`.
"""
