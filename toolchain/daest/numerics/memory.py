"""Memory that is freed stays with the process, so that arrays of the same size find it again.

Searches make and drop the same arrays of megabytes thousands of times. The C library gives each of them back
to the system, which fills the next one with zeros page by page: in a diagnosis a tenth of all the time of the
processor.
"""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

MEGABYTE = 1 << 20
# Parameters of mallopt(3) by their numbers, in bytes: free memory at the end of the heap that is kept, what
# is asked for beside what is needed, and the size from which arrays have pages of their own, the largest that
# the library has by itself.
KEPT = {-1: 256 * MEGABYTE, -2: 16 * MEGABYTE, -3: 32 * MEGABYTE}


def keep_freed_memory() -> None:
    """Let this process, and copies of it, keep what they free, with the GNU C library; elsewhere nothing
    changes. No number depends on it."""
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError):  # another C library
        set_option = ctypes.CDLL(None).mallopt
        for option, value in KEPT.items():
            set_option(option, value)
