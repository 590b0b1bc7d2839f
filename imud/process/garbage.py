"""The garbage collector: objects that live on are set aside, so that a collection has next to nothing to look through.

To look at all that has been imported would take 20 to 50 ms. An object that was set aside is still freed by its
reference count, but no longer if it is part of a reference cycle; so nothing that comes and goes with a connection may
be part of one.
"""

import ctypes
import gc
import sys

_trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # here, as what CDLL makes is part of a reference cycle


def set_aside() -> None:
    """Collect garbage, and exempt what is left from later collections. Call it when nobody waits for a sample.

    Memory that is free then goes back to the system, 1 MB after the start: its C library must know how (glibc).
    """
    sys.path_importer_cache.clear()  # the names of all files in Python's folders; a later import lists them again
    gc.collect()
    gc.freeze()
    if _trim:
        _trim(ctypes.c_size_t(0))
