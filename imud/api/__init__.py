"""imud as a library: arrays in, arrays out, by the same filters, and to the same bits, as the commands.

    import imud
    solution = imud.attitude(t, gyro, accel)
    solution = imud.navigate({"t": t, "gyro": gyro, "accel": accel}, fixes)
    recording = imud.read("drive.mcap")

A user writes `imud.attitude`; `imud/__init__.py` imports this package at the first use of one of its names.
"""

from .filters import AttitudeFilter, NavigationFilter
from .recordings import Recording, read
from .solution import Innovations, Solution
from .whole import attitude, navigate

__all__ = [
    "AttitudeFilter",
    "Innovations",
    "NavigationFilter",
    "Recording",
    "Solution",
    "attitude",
    "navigate",
    "read",
]
