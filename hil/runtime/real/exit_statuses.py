"""Exit statuses of the processes of a session, which its parent reads."""

from __future__ import annotations

from typing import Final

NOBODY: Final = 3
"""The rig: no controller answered."""
FAILED: Final = 4
"""The rig: a part of the loop failed in the run, as an event of the log says."""
ENDED: Final = 5
"""The rig: the run ended in order. 0 is what any code ends a process with."""
