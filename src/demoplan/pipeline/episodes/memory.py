"""Memory of a process that works on one episode after the other: kept for the next table, not given back."""

import ctypes
import functools
import sys
from typing import Any

import pyarrow as pa

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
"""Names of the settings in glibc's malloc.h; each is an int."""

MOST_KEPT_BYTES = 256 << 20
"""How much freed memory at the end of the heap stays with the process."""
MAPPED_FROM_BYTES = 1 << 30
"""Larger blocks than this still come from the system one by one, and go back at once."""


@functools.cache
def keep_memory() -> bool:
    """Keep freed memory for reuse; called again, it does nothing.

    Tables are columns of some megabytes. By default the C library maps each one anew, and the system has to
    clear every page of it: a tenth and more of the time that ingesting takes. Blocks from a heap that stays
    are used again as they are. Arrow's own allocator is put aside for the same one.

    It changes no result. Only glibc knows these settings; elsewhere nothing happens.

    Source: mallopt(3), Linux man-pages.

    Returns:
        Whether the settings were taken.
    """
    mallopt = _of_libc("mallopt")
    if mallopt is None:
        return False
    settings = {
        _MMAP_THRESHOLD: MAPPED_FROM_BYTES,
        _TRIM_THRESHOLD: MOST_KEPT_BYTES,
        _TOP_PAD: MOST_KEPT_BYTES // 4,
    }
    is_taken = all(mallopt(name, value) == 1 for name, value in settings.items())
    if is_taken:
        pa.set_memory_pool(pa.system_memory_pool())
    return is_taken


def give_memory_back() -> bool:
    """Give all freed memory back to the system: what a long episode needed, the next stage may not.

    Source: malloc_trim(3), Linux man-pages.

    Returns:
        Whether there was any that could be given back.
    """
    trim = _of_libc("malloc_trim")
    return trim is not None and bool(trim(0))


def _of_libc(name: str) -> Any:
    """A function that glibc has, or None."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
