"""Memory of a program that does the same again and again, for months."""

from __future__ import annotations

import ctypes
import gc

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_KEPT_BYTES = 64 << 20  # several times what one ping needs at once


def keep_freed_memory() -> bool:
    """Tell the C library not to give freed memory back to the system.

    It would otherwise take it anew at each ping, page by page: over a thousand page faults, which
    cost more than a tenth of the processing.

    Returns
    -------
    bool
        Whether the C library took it; others than glibc have no such setting.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES // 2)) and bool(
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
    )


def keep_what_is_loaded() -> None:
    """Tell Python's collector that what there is now stays, so that it need not look at it again.

    It would otherwise walk through all modules and the model every few minutes, for more
    milliseconds than a ping has to spare.
    """
    gc.collect()
    gc.freeze()
