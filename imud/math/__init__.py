"""Arithmetic on small fixed arrays: rotations, the earth, packed covariances."""
