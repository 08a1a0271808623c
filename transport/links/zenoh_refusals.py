"""What a link over zenoh needs of its package: whom it turns away, counted from its log; threads of its own that call Python.

zenoh keeps no statistics, and a denied message reaches no callback, but its log has a line.

zenoh writes its log to standard output and to nothing else. So refusals are counted only in a process that says its standard
output is not read by it, as a rig's process does. A line is counted by what it says and goes nowhere. A pipe of 1 MiB holds what
refused peers cause between two looks; a flood that fills it waits for the next look, 20 ms at most.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import re
import sys
import time
from contextlib import suppress
from importlib import import_module
from threading import Lock, Thread, get_ident
from typing import Final

from transport.links import LinkCounters, TransportError

INSTALL = "pip install 'hilrig[zenoh]'"

ONE_THREAD: Final = (
    "(app: (worker_threads: 1), " + ", ".join(f"{part}: (handover: app)" for part in ("acc", "net", "tx", "rx")) + ")"
)
"""All of zenoh's work in one thread: a packet wakes the same thread to send, to receive and for its socket, not three."""


def require_zenoh(uri: str) -> None:
    """Refuse a link over zenoh where zenoh is not installed; have it work in `ONE_THREAD`.

    Raises:
        TransportError: with the command that installs it.
    """
    try:
        import_module("zenoh")
    except ModuleNotFoundError as error:
        if error.name != "zenoh":
            raise
        raise TransportError(f"link {uri!r}: zenoh is not installed: {INSTALL}") from None
    os.environ["ZENOH_RUNTIME"] = ONE_THREAD  # read at zenoh's first use, which ends in Rust's words over what is no such value


class CallbackThreads:
    """Keeps the thread state of every thread that calls, from its first call on, as long as the process lives.

    A thread that was not started by Python gets a thread state when it calls, and loses it when the call returns. The memory of
    the state's stack is mapped and unmapped each time: four page faults, and a word to every CPU that runs this process. Under a
    hypervisor that is most of what a callback costs.

    Reference: Python/C API, "Non-Python created threads", ``PyGILState_Ensure``: calls nest, and only the outermost release
    takes the state away. One that is never released keeps it, as every thread of Python's own has one.
    """

    __slots__ = ("_known",)

    def __init__(self) -> None:
        self._known: set[int] = set()

    def keep(self) -> None:
        """Keep the calling thread's state; called inside of a callback, first thing."""
        ident = get_ident()
        if ident not in self._known:
            self._known.add(ident)  # one for each thread of the library, of which there are few
            ctypes.pythonapi.PyGILState_Ensure()


_SAYS: Final = (
    "off,zenoh::net::routing::interceptor=trace,zenoh::net::routing::interceptor::access_control=off,"
    "zenoh_transport::unicast::establishment::accept=debug,zenoh_link_tcp::unicast=debug,zenoh_link_tls::unicast=warn,"
    "zenoh::net::runtime::orchestrator=debug"  # why this end did not connect
)
_REFUSAL: Final = re.compile(
    rb"Msg intercepted!"  # a message that the access-control list denies
    rb"|UsrPwd extension - Recv"  # no password, or a wrong one
    rb"|WARN[^\n]*zenoh_link_tls::unicast"  # no certificate, or one of another authority
)
_CONNECTED: Final = re.compile(rb"Accepted TCP connection")
_OPENED: Final = re.compile(rb"New transport link accepted[^\n]*tcp/")
_WHY: Final = (
    (re.compile(rb"certificate expired|CertificateExpired"), "a certificate has expired"),
    (re.compile(rb"certificate not valid yet"), "a certificate is not yet valid"),
    (re.compile(rb"UnknownIssuer|UnknownCA|BadSignature|DecryptError|unknown ca"), "a certificate is of another authority"),
    (re.compile(rb"sent no certificates|CertificateRequired"), "the other end showed no certificate"),
    (re.compile(rb"UsrPwd extension - Recv"), "a password is missing or wrong"),
    (re.compile(rb"Timeout during TLS handshake"), "the other end said nothing"),
)
"""What zenoh's log says of a connection that was refused, and what that means."""

_BETWEEN_LOOKS_S: Final = 0.02  # a flood wakes the reader fifty times a second, and not once for each line
_PIPE_BYTES: Final = 1 << 20

_lock: Final = Lock()
_counted: list[LinkCounters] = []
_said: Final = set[str]()
_MOST_SAID: Final = 16
_free = False


def standard_output_is_free() -> None:
    """Say that nothing in this process writes to standard output: a link may take it for zenoh's log.

    To be called before zenoh is used.
    """
    global _free
    _free = True


def count_into(counters: LinkCounters) -> None:
    """Count there whom zenoh turns away from now on, if `standard_output_is_free`; what prints then goes to standard error.

    Args:
        counters: of one end of a link.
    """
    if not _free:
        return
    _counted.append(counters)
    if len(_counted) > 1:
        return
    import zenoh

    ours, theirs = os.pipe()
    with suppress(OSError):  # a user's pipes may be as large as they may be: it stays as it is, and a flood waits more often
        fcntl.fcntl(theirs, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    if sys.stdout is not None:  # closed by who started this process
        sys.stdout.flush()
    os.dup2(theirs, 1)  # a program that a control law starts has a standard output, too
    os.close(theirs)
    sys.stdout = sys.stderr
    os.environ["RUST_LOG"] = _SAYS  # zenoh prefers it to what it is given
    zenoh.init_log_from_env_or(_SAYS)
    Thread(target=_read, args=(ours,), name="zenoh's log", daemon=True).start()


def add_refused(counters: LinkCounters, number: int = 1) -> None:
    """Count that many more refused; from any thread.

    Args:
        counters: of a link.
        number: how many.
    """
    with _lock:
        counters.refused += number


def say(why: str) -> None:
    """Say on standard error why zenoh refused a connection, once a reason; not where standard output is in use.

    Args:
        why: in words.
    """
    with _lock:
        if _free and why not in _said and len(_said) < _MOST_SAID:
            _said.add(why)
            sys.stderr.write(f"hil: zenoh refused a connection: {why}\n")
            sys.stderr.flush()


def _read(fd: int) -> None:
    rest = b""
    while text := os.read(fd, _PIPE_BYTES):
        lines, newline, rest = (rest + text).rpartition(b"\n")
        unopened = len(_CONNECTED.findall(lines)) - len(_OPENED.findall(lines))
        for counters in _counted:
            add_refused(counters, len(_REFUSAL.findall(lines)))
            counters.unopened += unopened
        for pattern, why in _WHY:
            if pattern.search(lines):
                say(why)
        rest = rest if newline else rest[-4096:]
        time.sleep(_BETWEEN_LOOKS_S)
