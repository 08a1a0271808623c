"""Real time: processes, their scheduling, their end; what this machine is, and what its operating system grants."""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:  # `hil doctor` finds what stands before our packages, and imports none of them
    from hil.experiment.tables import Affinity
    from transport.links.traits import LinkTraits


MCL_CURRENT, MCL_FUTURE, PR_SET_PDEATHSIG, PR_SET_TIMERSLACK = 1, 2, 1, 29


def go_real_time(priority: int, cpu: int | None, awake: bool = False) -> str:
    """Ask for SCHED_FIFO, locked memory, one CPU and a still garbage collector; return one line that says what was given.

    Args:
        priority: SCHED_FIFO priority, 1 to 98.
        cpu: index into the CPUs that this process may use, counted from the last; None does not pin.
        awake: keep idle CPUs from sleeping until this process ends.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    got = ["memory locked" if libc.mlockall(MCL_CURRENT | MCL_FUTURE) == 0 else "memory not locked"]
    allowed = sorted(os.sched_getaffinity(0))
    if cpu is not None and len(allowed) > cpu + 1:
        try:
            os.sched_setaffinity(0, {allowed[-1 - cpu]})
            got.append(f"CPU {allowed[-1 - cpu]}")
        except OSError:
            got.append("any CPU")
    else:
        got.append("any CPU")
    if awake:
        try:
            os.write(os.open("/dev/cpu_dma_latency", os.O_WRONLY | os.O_CLOEXEC), bytes(4))  # in force while it is open
            got.append("CPUs awake")
        except OSError:
            got.append("CPUs may doze")
    sys.setswitchinterval(1e-4)
    gc.collect()
    gc.freeze()
    gc.disable()
    got.append("gc frozen")
    try:  # last: what takes long keeps no loop of another session from a CPU
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        got.insert(0, f"SCHED_FIFO {priority}")
    except OSError:
        libc.prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)
        got.insert(0, "SCHED_OTHER (no permission for SCHED_FIFO)")
    return ", ".join(got)


def leave_real_time() -> None:
    """Go back among the others: the end of a process, which takes long, keeps no loop of another session from a CPU.

    All threads do: one of a link that is flooded would keep the CPU from the thread that closes the link.
    """
    for thread in os.listdir("/proc/self/task"):
        with suppress(OSError):
            os.sched_setscheduler(int(thread), os.SCHED_OTHER, os.sched_param(0))


def cpu_for(affinity: Affinity, role: Literal["rig", "controller"], link: LinkTraits) -> int | None:
    """Return the CPU of a process, counted from the last; None leaves the choice to the scheduler.

    Args:
        affinity: what the experiment asks for; ``auto`` is ``shared`` over a link with threads of its own, else ``free``.
        role: whose CPU.
        link: the link between the two.

    >>> from transport.links.traits import traits_of
    >>> [cpu_for("auto", "controller", traits_of(uri)) for uri in ("can:hil:rig0", "zenoh:")]
    [None, 0]
    >>> [cpu_for("pinned", role, traits_of("zenoh:")) for role in ("rig", "controller")]
    [0, 1]
    """
    if affinity == "auto":
        affinity = "shared" if link.own_threads else "free"
    if affinity == "free":
        return None
    return 1 if affinity == "pinned" and role == "controller" else 0


def leave_to_loop(affinity: Affinity, link: LinkTraits) -> None:
    """Keep the calling thread off the CPU that rig and controller share, where there is another one.

    A system call of a thread of any priority is not interrupted on many kernels: what writes the log would delay the loop.

    Args:
        affinity: what the experiment asks for.
        link: between rig and controller.
    """
    rig, controller = cpu_for(affinity, "rig", link), cpu_for(affinity, "controller", link)
    allowed = sorted(os.sched_getaffinity(0))
    if rig is not None and rig == controller and len(allowed) > rig + 1:
        with suppress(OSError):
            os.sched_setaffinity(0, {*allowed} - {allowed[-1 - rig]})


def go_ahead_of_others() -> None:
    """Give the calling thread the lowest real-time priority, where allowed.

    For the reader of a loop's pipe: while it is in a read it holds the pipe's lock, and if another thread then takes its CPU, the
    loop waits that long.
    """
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))


def die_with_parent(parent: int) -> None:
    """Be killed when the parent process ends, however it ends; exit now if it has ended already."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        raise SystemExit(1)


def processor() -> str:
    """Return the processor's own name, or its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return f"{platform.machine()}, {next(named, 'no name')}"


def machine() -> dict[str, str]:
    """Return what a log in real time says of the machine."""
    return {
        "kernel": f"{platform.system()} {platform.release()}",
        "processor": f"{processor()}, {len(os.sched_getaffinity(0))} usable",
    }
