"""What happens inside a user-mode kernel: its first process, and the command's environment."""

from __future__ import annotations

import os
import shlex
import site
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

# vcan0 takes classic and FD frames (MTU 72). Multicast on lo is what zenoh and udp_multicast expect of a machine.
LINKS: Final = """\
ip link set lo up multicast on
ip route add 224.0.0.0/4 dev lo
ip link add dev vcan0 type vcan
ip link set vcan0 mtu 72 up
"""

WORK = "/run/hil-vcan"  # where the guest sees the runner's work directory

# Wrong inside: the guest has its own home, temporary directory and terminal.
DROPPED = {"HOME", "TMPDIR", "XDG_RUNTIME_DIR", "DISPLAY", "OLDPWD", "_"}
# A shell ends where one of these is set, or set to no number.
DROPPED |= {"OPTIND", "PPID", "UID", "EUID", "SHELLOPTS", "BASHOPTS"}

# Carries stdin through a terminal line, which knows no end of file: every chunk comes with its length, the last is 0.
# Each chunk is asked for: a user-mode kernel never again listens to a line that was full once (line_throttle).
CHUNK = 2048  # half of what a line holds
UNFRAME = """
import os
def exactly(n):
    data = b""
    while len(data) < n:
        data += os.read(0, n - len(data))
    return data
while os.write(0, b"+") and (n := int(exactly(6), 16)):
    os.write(1, exactly(n))
"""


def frame(chunk: bytes) -> bytes:
    r"""Return one chunk of stdin as ``UNFRAME`` reads it; an empty one ends it.

    >>> frame(b"hello\n")
    b'000006hello\n'
    """
    return b"%06x" % len(chunk) + chunk


def first_process(
    *, work: Path, readable: Sequence[str], writable: Sequence[str], modules: Sequence[Path], python: str, stdin: bool
) -> str:
    """Return the guest's PID 1: a private layer over this machine's files, vcan0, the command, its status, power off.

    Args:
        work: the runner's work directory; receives ``status``.
        readable: directories below /tmp that the command needs: its Python, its programs.
        writable: directories in which what it writes stays.
        modules: what the kernel loads.
        python: of the program that carries stdin.
        stdin: whether the third terminal carries the command's stdin.
    """
    quote, lines = shlex.quote, "\n".join
    return f"""#!/bin/sh
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
# The command may have taken /proc away; without it the end of PID 1 ends the kernel.
off() {{ sync; mount -t proc proc /proc; echo o >/proc/sysrq-trigger && sleep 60; }}
trap off EXIT
set -ex  # up to the command; the last line in the kernel's log says how far it came

# A writable layer in memory over this machine's files, and that as the root.
mount -t proc proc /proc
mount -t tmpfs tmpfs /mnt
mkdir /mnt/up /mnt/wk /mnt/new /mnt/low
mount -t hostfs -o / none /mnt/low
{lines(f"insmod {quote(str(m))}" for m in modules if m.name == "overlay.ko")}
mount -t overlay -o lowerdir=/mnt/low,upperdir=/mnt/up,workdir=/mnt/wk overlay /mnt/new
cd /mnt/new
mount -t tmpfs -o mode=755 tmpfs run
mkdir run/old run/hil-vcan
pivot_root . run/old  # not chroot, which would forbid user namespaces inside
cd /
mount -t hostfs -o {quote(str(work))} none {WORK}
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs dev /dev
mkdir -p /dev/shm /dev/pts
mount -t devpts -o ptmxmode=666 devpts /dev/pts
mount -t tmpfs -o mode=1777 tmpfs /dev/shm
mount -t tmpfs -o mode=1777 tmpfs /tmp
mkdir /tmp/home
{lines(f"mkdir -p {d}; mount -t hostfs -o ro,{d} none {d}" for d in map(quote, readable))}
{lines(f"mkdir -p {d}; mount -t hostfs -o rw,{d} none {d}" for d in map(quote, writable))}
{lines(f"insmod {quote(f'/run/old{m}')}" for m in modules if m.name != "overlay.ko")}
{LINKS.rstrip()}
stty -F /dev/tty1 -opost
stty -F /dev/tty2 -opost
# The terminals are our way out; the command itself shall see pipes, as under any other program.
mkfifo /run/in /run/out /run/err
cat </run/out >/dev/tty1 &
out=$!
cat </run/err >/dev/tty2 &
err=$!
set +ex
{_stdin(python) if stdin else "exec </dev/null"}
setsid sh {WORK}/command >/run/out 2>/run/err
echo $? >{WORK}/status.new
mv {WORK}/status.new {WORK}/status
{{ sleep 2; kill $out $err; }} 2>/dev/null &  # whom the command left behind may hold the pipes open
wait $out $err
"""


def command(argv: Sequence[str], environ: Mapping[str, str], backend: str, virtual_time: bool) -> str:
    """Return the script that becomes the command, with this machine's environment where it fits.

    >>> print(command(["echo", "a b"], {"LANG": "C", "HOME": "/root"}, "uml", False).splitlines()[-1])
    exec echo 'a b'
    """
    env = {
        # A page fault costs some 30 us here: keep malloc from giving large arrays back each time.
        "MALLOC_MMAP_THRESHOLD_": "33554432",
        "MALLOC_TRIM_THRESHOLD_": "1073741824",
        **{k: v for k, v in environ.items() if k.isascii() and k.isidentifier() and k not in DROPPED},
        "HOME": "/tmp/home",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONUSERBASE": environ.get("PYTHONUSERBASE") or site.getuserbase(),  # which follows HOME otherwise
        "VCAN_BACKEND": backend,
    }
    if virtual_time:
        env |= {"VCAN_VIRTUAL_TIME": "1", "PYTHONHASHSEED": "0"}
    exports = [f"export {k}={shlex.quote(v)}" for k, v in sorted(env.items())]
    return "\n".join([*exports, f"cd {shlex.quote(os.getcwd())} || exit 125", "exec " + shlex.join(argv), ""])


def _stdin(python: str) -> str:
    """The third terminal, opened once (closing would discard input) and raw before the first chunk is asked for."""
    return f"""exec 3<>/dev/tty3
stty raw -echo <&3
{shlex.quote(python)} -ISc {shlex.quote(UNFRAME)} <&3 >/run/in &
exec 3<&- </run/in"""
