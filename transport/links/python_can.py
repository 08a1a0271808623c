"""python-can without asammdf, which it imports where it is installed, and with it pandas and cryptography.

Only who reads or writes ``.mf4`` needs it (`with_mf4`). Its import takes longer than all others of a process of a loop
together, and swallows a Ctrl-C that comes meanwhile.
"""

from __future__ import annotations

import importlib
import sys

if "can" in sys.modules or "asammdf" in sys.modules:
    import can
else:
    sys.modules["asammdf"] = None  # type: ignore[assignment]
    try:
        import can
    finally:
        del sys.modules["asammdf"]

__all__ = ["can", "with_mf4"]


def with_mf4() -> type[can.io.mf4.MF4Writer]:
    """Return python-can's writer of ``.mf4``, with asammdf imported.

    Raises:
        ImportError: asammdf is not installed.
    """
    import asammdf  # noqa: F401

    writer: type[can.io.mf4.MF4Writer] = importlib.reload(can.io.mf4).MF4Writer
    return writer
