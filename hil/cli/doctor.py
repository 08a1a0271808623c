"""``hil doctor``: what this machine is and offers: for real-time runs, each line with its remedy, and for numbers.

What numbers depend on is its processor, and what numpy, OpenBLAS and libm choose by it.
"""

from __future__ import annotations

import errno
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import socket
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
import numpy as np
from threadpoolctl import threadpool_info

from hil.cli.terminal import answer, json_option, print_folded
from hil.plugins import REMEDY, shadows
from hil.runtime.real import processor
from hil.vcan import what_would_run

if TYPE_CHECKING:
    from transport.links.traits import Certificates


def vector_units() -> list[str]:
    """Return what numpy can use beyond its baseline, such as X86_V3 and X86_V4."""
    config: Any = np.show_config(mode="dicts")
    return [str(name) for name in config["SIMD Extensions"].get("found", [])]


def blas_kernel() -> str:
    """Return the kernel that OpenBLAS has chosen, such as SkylakeX."""
    return ", ".join(sorted({str(each.get("architecture", "?")) for each in threadpool_info() if each["user_api"] == "blas"}))


def libm() -> str:
    """Return the C library."""
    name, version = platform.libc_ver()
    return f"{name} {version}".strip() or "unknown"


Check = tuple[str, bool, str, str]  # what, fine, finding, remedy
CLEARLY: Final = 0.7
"""One round trip takes so much less of another before anything is said of them: the machine may be busy."""
BELOW: Final = " " * len("missing  ")  # where a line of a check goes on


def _vcan() -> Check:
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as s:
            s.bind(("vcan0",))
        return "SocketCAN", True, "vcan0 is there", ""
    except OSError as e:
        remedy = "hil vcan -- COMMAND"
        if e.errno == errno.EAFNOSUPPORT:
            return "SocketCAN", False, "this kernel has no CAN", f"{remedy} brings a user-mode kernel that has one"
        remedy += "; or sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 mtu 72 up"
        return "SocketCAN", False, f"no vcan0: {e.strerror}", remedy


def _ours(what: str, found: Callable[[], tuple[bool, str, str]]) -> Check:
    """Return a check that imports more of ours: where a foreign package has its name, "package ownership" reports it."""
    try:
        return what, *found()
    except ImportError as e:
        return what, False, str(e), "see package ownership"


def _hil_can() -> tuple[bool, str, str]:
    from transport.links.python_can import can

    try:
        with can.Bus(interface="hil", channel=f"doctor{os.getpid()}", fd=True):
            return True, "can.Bus(interface='hil') opens", ""
    except (can.CanError, OSError, ValueError) as e:
        return False, str(e), "set HIL_CAN_DIR to a private folder that can be written"


def _zenoh() -> Check:
    if importlib.util.find_spec("zenoh") is None:
        return "zenoh", False, "not installed", "pip install 'hilrig[zenoh]'"
    return "zenoh", True, f"eclipse-zenoh {importlib.metadata.version('eclipse-zenoh')}", ""


def _zenoh_cpus() -> tuple[bool, str, str]:
    """Measure round trips over zenoh with rig and controller on one CPU and on any."""
    from hil.bench.links import bench_links

    rows = bench_links(500.0, 0.5, links=["zenoh:unixsock-stream/{folder}/doctor"], floor=False)
    failed = [row["note"] for row in rows if row["note"]]
    if failed:
        return False, failed[0], "hil run uses can:hil: unless --link names another"
    free, shared = (row["p50_us"] for row in rows)
    finding = f"{shared:.0f} us (median) on one CPU, {free:.0f} us on any"
    if free < CLEARLY * shared:
        return True, f'{finding}: timing.affinity = "free" may be faster here', ""
    return True, f"{finding}: timing.affinity = auto takes one CPU", ""


def _scheduler() -> Check:
    try:
        old, param = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, old, param)
        return "scheduler", True, "SCHED_FIFO is allowed", ""
    except OSError as e:
        remedy = f"add '{os.environ.get('USER', 'USER')} - rtprio 98' and '- memlock unlimited' to /etc/security/limits.conf"
        return "scheduler", False, f"SCHED_FIFO is refused: {e.strerror}", remedy


def _idle() -> Check:
    device = "/dev/cpu_dma_latency"
    if os.access(device, os.W_OK):
        return "idle CPUs", True, "can be kept awake (timing.idle)", ""
    if not os.path.exists(device):
        return "idle CPUs", False, f"no {device}", "none: this kernel decides alone; expect tens of microseconds more per wake-up"
    return "idle CPUs", False, f"{device} is not yours to write", "run as root, or give your group access by a udev rule"


LATE_US: Final = 1000.0


def _clock() -> Check:
    late = []
    for _ in range(20):
        at = time.monotonic_ns() + 2_000_000
        time.sleep(0.002)
        late.append((time.monotonic_ns() - at) / 1e3)
    source = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    name = source.read_text().strip() if source.exists() else "unknown"
    return clock_check(name, late)


def clock_check(source: str, late_us: Sequence[float]) -> Check:
    """Return whether sleeps end in time: half of them less than a millisecond late."""
    median, worst = float(np.median(late_us)), max(late_us)
    fine = median < LATE_US
    remedy = "" if fine else "the machine is busy or virtual: use longer periods, or virtual time"
    return "clock", fine, f"{source}; a 2 ms sleep ends {median:.0f} us late (median), {worst:.0f} us at worst", remedy


def _cpus() -> Check:
    n = len(os.sched_getaffinity(0))
    return "processors", n >= 2, f"{n} usable", "" if n >= 2 else "rig and controller share one: expect late packets at 1 kHz"


def _packages() -> Check:
    """Our top-level names are plain words; say so if another distribution owns one of them."""
    owners = importlib.metadata.packages_distributions()
    foreign = [
        f"{name} belongs to {', '.join(d for d in owners[name] if d != 'hilrig')}"
        for name in ("hil", "plants", "transport", "design")
        if any(d != "hilrig" for d in owners.get(name, []))
    ]
    shadowed = shadows()
    if shadowed:
        found = [f"{path or 'no module'} shadows our {name}" for name, path in shadowed.items()]
        return "package ownership", False, "; ".join(found), REMEDY
    if foreign:
        return "package ownership", False, "; ".join(foreign), "install hilrig in a virtual environment of its own"
    return "package ownership", True, f"hil, plants, transport, design are hilrig's, Python {sys.version.split()[0]}", ""


def _machine() -> Check:
    units = ", ".join(vector_units()) or "its baseline"
    found = f"{processor()}; numpy uses {units}; OpenBLAS {blas_kernel()}; {libm()}"
    return "kind of machine", True, f"{found}; runs in virtual time have the same bits on all kinds", ""


def _loop() -> tuple[bool, str, str]:
    from hil.log.write.provenance import loop_form

    return True, f"{loop_form()}; both forms compute the same bits", ""


def _who(uri: str | None) -> tuple[bool, str, str]:
    from transport.links.traits import traits_of

    links = ("can:hil:rig0", "zenoh:") if uri is None else (uri,)
    return True, "; ".join(f"over {link} {traits_of(link).commanders}" for link in links), ""


def _certificates_of(link: str) -> Certificates | None:
    from transport.links.traits import traits_of

    return traits_of(link).certificates


def _certificates(shown: Certificates) -> tuple[bool, str, str]:
    """Say until when the certificates of a link are valid, or what is wrong with those that are here."""
    from transport.links import TransportError
    from transport.links.authentication import check_certificate

    found = list[str]()
    for role, name in shown.names.items():
        cert = shown.own[role]
        if found and cert == shown.own["rig"]:
            break  # one end's only
        if not Path(cert).exists():
            continue
        try:
            ends = check_certificate(shown.ca, cert, name)
        except TransportError as error:
            return False, str(error), "hil keys renew DIR"
        found.append(f"{role} until {ends:%Y-%m-%d}")
    return bool(found), ", ".join(found) or "none is here", "" if found else "hil keys new DIR"


def _tool(program: str, package: str, why: str) -> Check:
    found = shutil.which(program)
    return program, found is not None, found or "absent", "" if found else f"apt-get install {package} ({why})"


@click.command()
@click.option("--link", metavar="URI", help="Say from whom a rig on this link accepts commands.")
@json_option("Print one JSON list.")
def command(link: str | None) -> None:
    """Check CAN, zenoh, scheduler, clock and packages. A missing part limits some real-time runs, but no run in virtual time."""

    there = importlib.util.find_spec("zenoh") is not None
    certificates = None if link is None else _certificates_of(link)
    shown = [] if certificates is None else [_ours("certificates", partial(_certificates, certificates))]
    checks = [_ours("commands accepted from", partial(_who, link)), *shown, _packages(), _ours("CAN without a kernel", _hil_can),
              _vcan(), ("hil vcan", *what_would_run()), _zenoh(),
              *([_ours("zenoh round trip", _zenoh_cpus)] if there else []), _scheduler(), _idle(), _clock(), _cpus(),
              _machine(), _ours("loop", _loop),
              _tool("cyclictest", "rt-tests", "hil bench timing compares with it"),
              _tool("cc", "gcc", "hil bench links has its floor in C")]  # fmt: skip
    answer([dict(zip(("what", "ok", "finding", "remedy"), c)) for c in checks], show, checks)


def show(checks: Sequence[Check]) -> None:
    """Print a line for each check, and one for its remedy; what a terminal has no room for goes on below itself."""
    for what, fine, finding, remedy in checks:
        print_folded(f"{'ok     ' if fine else 'missing'}  {what}: {finding}", BELOW)
        print_folded(f"{BELOW}remedy: {remedy}" if remedy else "", BELOW)
