"""How the kernels of the estimators are compiled: as those of the drivers are."""

from imud.drivers.jit import NumbaObject, inlined, interpreted, kernel, unrolled, written_out

__all__ = ["NumbaObject", "inlined", "interpreted", "kernel", "unrolled", "written_out"]
