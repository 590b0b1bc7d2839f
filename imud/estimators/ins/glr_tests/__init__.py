"""Fault detection that follows every update: generalised likelihood ratio (GLR) tests, one file a fault.

`fault_sensitivity` is what they share: `fusion` propagates and updates it along with P, and gives each test its
innovations. `gnss_position` (aiding) and `gnss_fix` ask for the verdicts.
"""
