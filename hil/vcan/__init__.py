"""A real vcan0 on any x86-64 Linux: what ``hil vcan -- COMMAND`` runs.

``native`` is this kernel's own vcan in a network namespace, ``uml`` a user-mode kernel that has one: ``kernel`` finds or
builds it from ``kernel.config`` by ``build_kernel``, ``packages`` has what a build needs, ``guest`` is what happens inside.
``supervise`` runs a child that cannot outlive us, ``runner`` takes the first way that this machine has. Standard library
only, as part of it runs without site-packages.
"""

from hil.vcan.runner import run_beside_vcan, what_would_run
from hil.vcan.supervise import RUNNER_FAILED, TIMED_OUT, RunnerError, Wanted

__all__ = ["RUNNER_FAILED", "TIMED_OUT", "RunnerError", "Wanted", "run_beside_vcan", "what_would_run"]
