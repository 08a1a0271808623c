"""The running kernel's own vcan, in a private network namespace."""

from __future__ import annotations

import shutil
import socket
from typing import Final

from hil.vcan.supervise import RunnerError, Wanted, say, unshare, works

# vcan0 takes classic and FD frames (MTU 72). Multicast on lo is what zenoh and udp_multicast expect of a machine.
LINKS: Final = """\
ip link set lo up multicast on
ip route add 224.0.0.0/4 dev lo
ip link add dev vcan0 type vcan
ip link set vcan0 mtu 72 up
"""


def argv(wanted: Wanted) -> list[str]:
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
