"""The errors of a sensor: noise profiles, calibrations by serial number, and the estimation of both."""
