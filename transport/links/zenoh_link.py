"""A link over zenoh, peer to peer: ``zenoh:`` on one machine, ``zenoh:tls/host:7447?keys=DIR`` between two.

The rig listens at the endpoint and the controller connects to it; there is no router, no multicast and no gossip. Sensor
packets are published under ``hil/<name>/sensor``, control packets under ``hil/<name>/control``, so that any zenoh program
that is let in at the rig's endpoint can watch, or be the controller. A peer of the rig does not see what another peer
publishes, so the rig says again under ``hil/<name>/received`` what control packets it receives, once a subscriber listens
there. Every packet has the encoding `ENCODING` and an attachment ``slot=K;session=S``. Liveliness tokens say who is there
and which controller commands the rig (`transport.links.zenoh_access`), and the rig answers queries for ``hil/<name>/info``.
Certificates and passwords keep all other programs from both.

Without an endpoint the link is a Unix socket in a directory of mode 0700 (`zenoh_directory`): who is not this user cannot
reach it. ``tls/`` takes certificates of both ends, and only the one called *controller* is accepted: see
`transport.links.zenoh_access`. Over ``tcp/`` only this machine is reachable unless the URI says ``lan=1``: whoever reaches it
can command the plant, unless ``users=FILE`` asks for a password (which travels in clear).

A packet for which zenoh's queue has no room is lost; zenoh does not say so, the gap in `seq` does.
"""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event
from typing import TYPE_CHECKING, Any, Final

from transport.links import Closing, LinkCounters, Role, TransportError, split_uri
from transport.links.private_directory import Claim, namespace, private_directory
from transport.links.zenoh_access import LEASE_S, OPTIONS, Access, Claims, access, own_name
from transport.links.zenoh_refusals import CallbackThreads, add_refused, count_into, require_zenoh, say

if TYPE_CHECKING:
    import zenoh

QUEUE_LIMIT: Final = 256
"""Packets that wait for `receive`; what comes on top is dropped and counted."""
LARGEST: Final = 4096
"""Bytes of a packet (`transport.wire`); a longer payload is counted as malformed."""

ENCODING: Final = "application/octet-stream;hilrig"
"""Encoding of every packet; its version stands in the packet."""

_NETWORKED: Final = ("tcp", "tls", "udp", "ws")
_LOCAL: Final = ("unixsock-stream",)
_LOOPBACK: Final = re.compile(r"(127\.\d+\.\d+\.\d+|\[::1\]|localhost)")
_SOURCE: Final = re.compile(r" at \S+\.rs:\d+\.?")  # where in zenoh's source an error arose
NAME: Final = re.compile(r"[A-Za-z0-9_.-]{1,64}")
"""Of a link over zenoh."""


class ZenohLink(Closing):
    """One end of a link over zenoh.

    Args:
        uri: for messages.
        role: the rig listens, the controller connects (and connects again when the rig comes back).
        endpoint: zenoh endpoint, as in ``tcp/127.0.0.1:7447``.
        name: second part of the key expressions.
        who: who this end is, and whose packets it accepts.
        claims: closed with the link.

    Raises:
        TransportError: the file of passwords cannot be had.
        zenoh.ZError: the endpoint cannot be had.
    """

    def __init__(self, uri: str, role: Role, endpoint: str, name: str, who: Access, claims: Sequence[Closing] = ()) -> None:
        import zenoh

        self.uri = uri
        self.counters = LinkCounters()
        self._error = zenoh.ZError
        self._closed, self._claims = False, tuple(claims)
        # A queue in C: the callback runs in a thread of zenoh, whose waking of ours is most of a round trip.
        self._queue: SimpleQueue[bytes] = SimpleQueue()
        self._get = self._queue.get
        self._session_id, self._name = os.urandom(8).hex(), name
        self._say_again: Callable[..., None] | None = None
        self._listened_to = Event()
        if role == "rig" or who.tls or who.users:
            count_into(self.counters)
        self._session = zenoh.open(config(role, endpoint, who.config(name)))
        sends, receives = ("sensor", "control") if role == "rig" else ("control", "sensor")
        try:
            if who.tls:
                met = zenoh.handlers.Callback(partial(_meet, who, self.counters), indirect=False)
                self._session.info.declare_link_events_listener(met, history=True)
            declared = partial(
                self._session.declare_publisher,
                encoding=ENCODING,
                express=True,  # no batching
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            publisher = declared(f"hil/{name}/{sends}")
            if role == "rig":  # what has no subscriber is not said again: it would come before an answer is looked at
                again = declared(f"hil/{name}/received")
                again.declare_matching_listener(zenoh.handlers.Callback(partial(_note, self._listened_to), indirect=False))
                self._say_again = again.put
            self._roles = Claims(self._session, name, role, own_name(self._session_id))  # before anything is received
            # indirect=False: no Python thread in between, which would keep the process alive for ever if left open.
            take = partial(_take, CallbackThreads().keep, self._queue, self.counters, self._roles)
            callback = zenoh.handlers.Callback(take, indirect=False)
            self._session.declare_subscriber(f"hil/{name}/{receives}", callback)
        except BaseException:
            self._session.close()  # type: ignore[no-untyped-call]
            raise
        self._publish = publisher.put

    def send(self, packet: bytes) -> None:
        if self._closed:
            self.counters.dropped += 1
            return
        try:
            self._publish(packet, attachment=self._about(packet))
        except self._error:
            self.counters.errors += 1
            self.counters.dropped += 1
        else:
            self.counters.sent += 1

    def receive(self, timeout_s: float) -> bytes | None:
        if self._closed:
            return None
        try:
            packet = self._get(True, timeout_s) if timeout_s > 0 else self._get(False)
        except Empty:
            return None
        self.counters.received += 1
        if self._say_again is not None and self._listened_to.is_set():
            with suppress(self._error):
                self._say_again(packet, attachment=self._about(packet))
        return packet

    def _about(self, packet: bytes) -> str:
        return f"slot={int.from_bytes(packet[4:8], 'little')};session={self._session_id}"

    def check_alone(self) -> None:
        self._roles.check(self.uri)

    def announce(self, about: Mapping[str, object]) -> None:
        """Answer queries for ``hil/<name>/info`` with this, and the session, as JSON.

        Args:
            about: plain values.
        """
        import zenoh

        key, text = f"hil/{self._name}/info", json.dumps({**about, "session": self._session_id})
        self._session.declare_queryable(key, zenoh.handlers.Callback(partial(answer, key, text), indirect=False))

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            with suppress(self._error):
                self._session.close()  # type: ignore[no-untyped-call]
            for claim in self._claims:
                claim.close()


def _take(
    keep: Callable[[], None], queue: SimpleQueue[bytes], counters: LinkCounters, roles: Claims, sample: zenoh.Sample
) -> None:
    keep()
    if not roles.admits(sample):
        add_refused(counters)
    elif len(sample.payload) > LARGEST:
        counters.malformed += 1
    elif queue.qsize() < QUEUE_LIMIT:
        queue.put(sample.payload.to_bytes())
    else:
        counters.dropped += 1


def _meet(who: Access, counters: LinkCounters, event: zenoh.LinkEvent) -> None:
    """Count who connects with a certificate of our authority, but another's name; the access-control list keeps it silent."""
    name = event.link.auth_identifier
    if str(event.kind).endswith("PUT") and name != who.peer:
        add_refused(counters)
        why = "a name that is revoked" if name in who.revoked else f"expected {who.peer}"
        say(f"the certificate is called {str(name)[:80]!r}, {why}")


def _note(listened_to: Event, status: zenoh.MatchingStatus) -> None:
    (listened_to.set if status.matching else listened_to.clear)()


def answer(key: str, text: str, query: zenoh.Query) -> None:
    """Answer a query with a text in JSON, unless it has ended meanwhile."""
    with suppress(Exception):
        query.reply(key, text, encoding="application/json")


def zenoh_directory() -> Path:
    """Return the directory of the Unix sockets of ``zenoh:`` links of this user."""
    return Path(os.environ.get("HIL_ZENOH_DIR") or f"/tmp/hil-zenoh-{os.geteuid()}")


def config(role: Role, endpoint: str, entries: dict[str, Any]) -> zenoh.Config:
    """Return the configuration of one end: a peer that is not found by itself.

    Args:
        role: the rig listens, the controller connects.
        endpoint: zenoh's.
        entries: further ones, which replace ours.

    Raises:
        TransportError: the rig's endpoint is the place of a file that is no socket.
    """
    import zenoh

    if role == "rig":
        _refuse_a_file(endpoint)

    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # A peer listens on all interfaces unless it is given where, also one that only connects.
        "listen/endpoints": [endpoint] if role == "rig" else [],
        "connect/endpoints": [] if role == "rig" else [endpoint],
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 2},
        "transport/link/tx/lease": round(1e3 * LEASE_S),
        # `transport/unicast/lowlatency` is a quarter faster, but there a peer that is stopped (SIGSTOP) blocks `put` for ever.
        "transport/link/tx/queue/size/real_time": 16,  # the default of 2 is less than the frames of one slot may be
        # zenoh closes a connection by a call that holds its thread: for 4 ms, or 10 s where the other end answers nothing (its
        # issue 2350). So one that says nothing stays open, and is counted.
        "transport/unicast/accept_pending": 1 << 20,
        "transport/unicast/accept_timeout": 1 << 30,
        "transport/link/rx/max_message_size": 1 << 20,  # the default of 1 GiB is kept for every peer that begins such a message
        **entries,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _refuse_a_file(endpoint: str) -> None:
    """Refuse a Unix socket in the place of a file: zenoh removes what is there, and what is called so and ``.lock``."""
    protocol, _, path = endpoint.partition("#")[0].partition("/")
    for place, is_left in ((path, stat.S_ISSOCK), (f"{path}.lock", stat.S_ISREG)) if protocol in _LOCAL else ():
        with suppress(OSError, ValueError):  # nothing is there, or nothing can be: zenoh says so
            status = os.lstat(place)
            if status.st_size or not is_left(status.st_mode):
                raise TransportError(f"{place}: is in the way of the socket {path}, and none of zenoh's; name another endpoint")


def open_zenoh(uri: str, role: Role) -> ZenohLink:
    """Open one end of a link over zenoh.

    Args:
        uri: ``zenoh:[<endpoint>]``, with the options ``name`` (default rig0), ``lan`` (1 allows other machines), and those of
            `transport.links.zenoh_access`.
        role: "rig" listens, "controller" connects.

    Raises:
        TransportError: a bad URI, an endpoint that other machines reach, or one that is taken.

    >>> open_zenoh("zenoh:tcp/127.0.0.1", "rig")
    Traceback (most recent call last):
    transport.links.TransportError: link 'zenoh:tcp/127.0.0.1': address '127.0.0.1', expected host:port, as in 127.0.0.1:7447
    """
    _, endpoint, options = split_uri(uri)
    if not endpoint and NAME.fullmatch(options.get("name", "rig0")):
        try:
            endpoint = f"unixsock-stream/{private_directory(zenoh_directory())}/{options.get('name', 'rig0')}"
        except TransportError as error:
            raise TransportError(f"link {uri!r}: {error}") from error
    protocol, _, address = endpoint.partition("/")
    if protocol not in _NETWORKED + _LOCAL or not address:
        expected = ", ".join(f"{p}/" for p in _NETWORKED + _LOCAL)
        raise TransportError(
            f"link {uri!r}: endpoint {endpoint!r}, expected one that begins with {expected} as in tcp/127.0.0.1:7447"
        )
    who = access(uri, role, protocol, options)
    name, lan = options.pop("name", "rig0"), options.pop("lan", "0")
    if options:
        known = ", ".join(("lan", *OPTIONS))
        raise TransportError(f"link {uri!r}: no option is called {next(iter(options))!r}, expected name or {known}")
    if lan not in ("0", "1"):
        raise TransportError(f"link {uri!r}: lan={lan}, expected 1 (other machines may connect) or 0")
    if not NAME.fullmatch(name):
        raise TransportError(f"link {uri!r}: name {name!r}, expected up to 64 letters, digits, '_', '-', '.'")
    if protocol in _NETWORKED:
        host, _, port = address.partition("#")[0].rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            raise TransportError(f"link {uri!r}: address {address!r}, expected host:port, as in 127.0.0.1:7447")
        if lan != "1" and protocol != "tls" and not _LOOPBACK.fullmatch(host):
            raise TransportError(
                f"link {uri!r}: {host} is not this machine alone, and who reaches it can command the plant; "
                "use 127.0.0.1, or append ?lan=1"
            )
    require_zenoh(uri)
    import zenoh

    where = (namespace("net"), _LOOPBACK.sub("loopback", address)) if protocol in _NETWORKED else (address,)
    with ExitStack() as held:  # until the link holds it; of two rigs the second finds the endpoint taken
        claims = [Claim(uri, role, "zenoh", *where, name, choose="another name")] if role == "controller" else []
        for claim in claims:
            held.enter_context(claim)
        try:
            link = ZenohLink(uri, role, endpoint, name, who, claims)
        except zenoh.ZError as error:
            said = _SOURCE.sub("", str(error))
            hint = "; is another rig running there?" if "in use" in said or "acquire lock" in said else ""
            raise TransportError(f"link {uri!r}: {said}{hint}") from error
        held.pop_all()
    return link
