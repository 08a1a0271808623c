"""One controller of a rig, over zenoh, from whatever machine: the rig says by a token which one it hears.

A controller of ours has a liveliness token ``hil/<name>/controller/<session>/<host>/<pid>``, which zenoh takes away when it
ends, dies or is not heard of for a lease. The rig hears the first of them and says so with a token of its own,
``hil/<name>/hears/<session>/<host>/<pid>``. A controller that sees another one's there takes no packet, and says whose it is;
what it has sent already, the rig throws away. The rig decides, so two that come at once cannot both win.

A program without such a token is no controller of ours: what it answers shows in the answers.
"""

from __future__ import annotations

import os
import re
import socket
from time import monotonic
from typing import TYPE_CHECKING, Final

from transport.links.link import Role, TransportError

if TYPE_CHECKING:
    import zenoh

LEASE_S: Final = 1.0
"""A peer that says nothing for so long is gone for zenoh."""

_PATIENCE_S: Final = 1.5 * LEASE_S
"""For so long one that died without a word may still stand in its role."""

_MOST: Final = 256
"""Controllers that a rig keeps in mind."""


def own_name(session: str) -> str:
    """Return who this process is, as the end of a key expression: session, host and pid.

    Args:
        session: of its link.
    """
    host = re.sub(r"[^A-Za-z0-9_.-]", "-", socket.gethostname())[:64] or "host"
    return f"{session}/{host}/{os.getpid()}"


class Claims:
    """What one end of a link knows of the controllers on it.

    Args:
        session: zenoh's, open.
        name: of the link.
        role: of this end.
        own: `own_name` of this end.
    """

    __slots__ = ("_alive", "_heard", "_own", "_said", "_session", "_since_s", "_token", "_where")

    def __init__(self, session: zenoh.Session, name: str, role: Role, own: str) -> None:
        import zenoh

        self._session, self._own = session, own
        self._where = f"hil/{name}/hears"
        self._alive: list[str] = []  # rig: controllers, in the order in which they came
        self._heard: set[str] = set()  # controller: whom rigs hear
        self._said: zenoh.LivelinessToken | None = None
        self._since_s: float | None = None
        alive = session.liveliness()
        self._token = alive.declare_token(f"hil/{name}/rig" if role == "rig" else f"hil/{name}/controller/{own}")
        key, took = (f"hil/{name}/controller", self._met) if role == "rig" else (self._where, self._told)
        alive.declare_subscriber(f"{key}/*/*/*", zenoh.handlers.Callback(took, indirect=False), history=True)

    def _met(self, sample: zenoh.Sample) -> None:
        """Keep whom this rig hears: the first that came and has not gone."""
        before, who = self._alive[:1], _end_of(sample)
        if not _came(sample):
            self._alive = [each for each in self._alive if each != who]
        elif who not in self._alive and len(self._alive) < _MOST:
            self._alive = [*self._alive, who]
        if before != self._alive[:1]:
            if self._said is not None:
                self._said.undeclare()  # type: ignore[no-untyped-call]
            first = self._alive[:1]
            self._said = self._session.liveliness().declare_token(f"{self._where}/{first[0]}") if first else None

    def _told(self, sample: zenoh.Sample) -> None:
        who = _end_of(sample)
        self._heard = self._heard | {who} if _came(sample) else self._heard - {who}

    def admits(self, sample: zenoh.Sample) -> bool:
        """Return whether a packet is to be taken: not from a controller of ours that the rig does not hear, and not by one.

        Args:
            sample: from the link, with the sender's session attached.
        """
        if not (self._alive[1:] or self._heard):
            return True
        about = "" if sample.attachment is None else sample.attachment.to_bytes().decode(errors="replace")
        return self._alone and not any(about.endswith(f"session={who.partition('/')[0]}") for who in self._alive[1:])

    @property
    def _alone(self) -> bool:
        return not self._heard or self._own in self._heard

    def check(self, uri: str) -> None:
        """Refuse to go on where the rig hears another controller, and has for longer than one that died stands there.

        Args:
            uri: of the link, for the message.

        Raises:
            TransportError: who it is.
        """
        if self._alone:
            self._since_s = None
            return
        self._since_s = monotonic() if self._since_s is None else self._since_s
        if monotonic() - self._since_s >= _PATIENCE_S:
            _, host, pid = min(self._heard).split("/")
            raise TransportError(
                f"link {uri!r}: the rig hears another controller, process {pid} on {host}; stop that one, or choose another name"
            )


def _end_of(sample: zenoh.Sample) -> str:
    return "/".join(str(sample.key_expr).split("/")[-3:])


def _came(sample: zenoh.Sample) -> bool:
    return str(sample.kind).endswith("PUT")
