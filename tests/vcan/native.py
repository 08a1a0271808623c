"""The running kernel's own vcan, in a private network namespace."""

from __future__ import annotations

import argparse
import shutil
import socket

from .supervise import RunnerError, say, unshare, works

# vcan0 takes classic and FD frames (MTU 72). Multicast on lo is what zenoh and udp_multicast expect of a machine.
LINKS = """\
ip link set lo up multicast on
ip route add 224.0.0.0/4 dev lo
ip link add dev vcan0 type vcan
ip link set vcan0 mtu 72 up
"""


def argv(options: argparse.Namespace) -> list[str]:
    """What to execute so that the command runs beside a vcan0 of this kernel. Raises RunnerError where it has none."""
    if not hasattr(socket, "AF_CAN"):
        raise RunnerError("this Python has no AF_CAN")
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as why:
        raise RunnerError(f"this kernel has no CAN ({why.strerror})") from why
    if not shutil.which("ip"):
        raise RunnerError("ip is missing (apt-get install iproute2)")
    private = [*unshare("net", "pid", "mount"), "--mount-proc"]
    if not works([*private, "sh", "-ec", LINKS]):
        raise RunnerError("this kernel makes no vcan here (as root: modprobe vcan)")
    if options.verbose:
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
    return [*private, "sh", "-c", script, "sh", *options.command]
