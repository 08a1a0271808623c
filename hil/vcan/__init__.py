"""A real vcan0 on any x86-64 Linux: what ``hil vcan -- COMMAND`` runs.

``native`` is this kernel's own vcan in a network namespace, ``uml`` a user-mode kernel that has one: ``kernel`` finds or
builds it from ``kernel.config`` by ``build_kernel``, ``packages`` has what a build needs, ``guest`` is what happens inside.
``supervise`` runs a child that cannot outlive us; the first way that this machine has is taken. Standard library only, as part
of it runs without site-packages.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from hil.vcan import kernel, native, uml
from hil.vcan.supervise import RUNNER_FAILED, TIMED_OUT, RunnerError, Wanted, run

__all__ = ["RUNNER_FAILED", "TIMED_OUT", "RunnerError", "Wanted", "run_beside_vcan", "what_would_run"]

Start = Callable[[Wanted], list[str]]  # what to execute


def run_beside_vcan(wanted: Wanted, timeout_s: float | None = None) -> int:
    """Run a command where a vcan0 exists, to its end, and return its status; nothing stays behind, whatever ends us.

    Args:
        wanted: the command, and where it may run.
        timeout_s: seconds of real time after which it is ended.

    Returns:
        The command's own status, 128 + N if signal N ended it, 124 after the time limit.

    Raises:
        RunnerError: this machine has no way to a vcan0; a line for each that was tried.
    """
    return run(start(wanted), timeout_s)


def start(wanted: Wanted) -> list[str]:
    """Return what to execute: the first way that this machine has."""
    kernel.clear_half_built()
    missing = []
    for name, way in ways(wanted):
        try:
            return way(wanted)
        except RunnerError as why:
            missing.append(f"{name}: {why}")
    raise RunnerError("\n".join(["no vcan0 could be had", *(line for why in missing for line in why.split("\n"))]))


def ways(wanted: Wanted) -> list[tuple[str, Start]]:
    """Return the ways to a vcan0 that are allowed, best first."""
    small: tuple[str, Start] = ("uml", partial(uml.argv, find=kernel.small))
    real: list[tuple[str, Start]] = [("native", native.argv), small, ("debian", partial(uml.argv, find=kernel.debian))]
    return [way for way in ([small] if wanted.virtual_time else real) if wanted.backend in ("auto", way[0])]


def what_would_run() -> tuple[bool, str, str]:
    """Return whether ``hil vcan`` works here, what it takes, and what helps where it does not; builds nothing."""
    try:
        native.argv(Wanted(command=("true",)))
    except RunnerError as why:
        refused = str(why)
    else:
        return True, "this kernel's own vcan", ""
    built = kernel.built()
    if built is not None:
        return True, f"a user-mode kernel, as {refused}: {built}", ""
    try:
        kernel.need_for_build(None)
    except RunnerError as why:
        return False, f"{refused}, and no user-mode kernel can be built yet", str(why)
    return True, f"a user-mode kernel, as {refused}; the first use builds it, some minutes", ""
