"""A real vcan0 on any x86-64 Linux: what ``hil vcan -- COMMAND`` runs.

``native`` is this kernel's own vcan in a network namespace, ``uml`` a user-mode kernel that has one: ``kernel`` finds or
builds it from ``kernel.config`` by ``build_kernel``, ``packages`` has what a build needs, ``guest`` is what happens inside.
``supervise`` runs a child that cannot outlive us; the first way that this machine has is taken. Standard library only, as part
of it runs without site-packages.
"""

from __future__ import annotations

import shutil
import socket
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from hil.vcan import kernel, uml
from hil.vcan.guest import LINKS
from hil.vcan.supervise import RUNNER_FAILED, TIMED_OUT, RunnerError, Wanted, run, say, unshare, works

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
    with suppress(RunnerError):  # no place for a kernel, which this machine's own way needs not
        kernel.clear_half_built()
    missing = []
    for name, way in ways(wanted):
        try:
            return way(wanted)
        except RunnerError as why:
            missing.append(f"{name}: {why}")
    raise RunnerError("\n".join(["no vcan0 is available", *(line for why in missing for line in why.split("\n"))]))


def ways(wanted: Wanted) -> list[tuple[str, Start]]:
    """Return the ways to a vcan0 that are allowed, best first."""
    small: tuple[str, Start] = ("uml", partial(uml.argv, find=kernel.small))
    real: list[tuple[str, Start]] = [("native", native), small, ("debian", partial(uml.argv, find=kernel.debian))]
    return [way for way in ([small] if wanted.virtual_time else real) if wanted.backend in ("auto", way[0])]


def what_would_run() -> tuple[bool, str, str]:
    """Return whether ``hil vcan`` works here, what it takes, and what helps where it does not; builds nothing."""
    try:
        native(Wanted(command=("true",)))
    except RunnerError as why:
        refused = str(why)
    else:
        return True, "this kernel's own vcan", ""
    try:
        built = kernel.built()
        if built is not None:
            return True, f"a user-mode kernel, as {refused}: {built}", ""
        kernel.need_for_build(None)
    except RunnerError as why:
        return False, f"{refused}, and no user-mode kernel can be built yet", str(why)
    return True, f"a user-mode kernel, as {refused}; the first use builds it, some minutes", ""


def native(wanted: Wanted) -> list[str]:
    """Return what to execute so that the command runs beside a vcan0 of this kernel.

    Where new namespaces are refused, a vcan0 that is there already must do, which others may use too.

    Raises:
        RunnerError: this kernel has none.
    """
    if not hasattr(socket, "AF_CAN"):
        raise RunnerError("this Python has no AF_CAN")
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as why:
        raise RunnerError(f"this kernel has no CAN ({why.strerror})") from why
    try:
        return _in_a_namespace(wanted)
    except RunnerError:
        if not _vcan0_is_there():
            raise
    if wanted.verbose:
        say("the vcan0 that is there, real time")
    return ["env", "VCAN_BACKEND=native", *wanted.command]


def _in_a_namespace(wanted: Wanted) -> list[str]:
    """Return what to execute for a vcan0 of the command's own."""
    if not shutil.which("ip"):
        raise RunnerError("ip is missing (apt-get install iproute2)")
    private = [*unshare("net", "pid", "mount"), "--mount-proc"]
    if not works([*private, "sh", "-ec", LINKS]):
        raise RunnerError("this kernel makes no vcan here (as root: modprobe vcan)")
    if wanted.verbose:
        say("this kernel's own vcan, real time")
    # /sys belongs to a network namespace, too; a container may refuse the mount, and little needs it.
    # The shell stays as the namespace's first process, which signals do not end and which orphans fall to.
    script = f"""\
set -e
mount -t sysfs sysfs /sys 2>/dev/null || :
{LINKS}
set +e
VCAN_BACKEND=native "$@"
exit $?
"""
    return [*private, "sh", "-c", script, "sh", *wanted.command]


def _vcan0_is_there() -> bool:
    """Whether a vcan0 can be bound."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as s:
            s.bind(("vcan0",))
    except OSError:
        return False
    return True
