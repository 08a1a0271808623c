"""A full disk without a disk: no file of this process may grow beyond a size, as long as a block lasts.

The limit is for the block alone: that of a fixture still holds while pytest writes its report, which may go into a file.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Let no file grow beyond a size in bytes; writing more is an OSError (EFBIG), as Python ignores the signal."""
    bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True  # it would be kept as far as it could be written
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = bytecode
