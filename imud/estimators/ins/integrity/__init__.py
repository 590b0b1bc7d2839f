"""Monitors above aiding and alignment. The test for a drifting receiver is in `observers`: it needs every gain."""
