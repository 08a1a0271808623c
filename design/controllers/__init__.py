"""What runs inside a loop. Importing this room imports numpy and nothing heavier, because a process that keeps time does.

Each name brings its module when it is first used: a process pays for the controller that it runs, and for no other.
"""

from __future__ import annotations

from design import exports

__getattr__, __dir__, __all__ = exports(__name__, __path__[0])
