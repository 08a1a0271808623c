"""Access to a link over zenoh: certificates, passwords, the access-control list that follows, one controller at a time.

With ``tls/`` both ends show a certificate of one authority, and zenoh's access-control list denies whatever it does not name:
the peer whose certificate is called *controller* may write the control key at the rig and read the sensor key, the one called
*rig* the reverse at the controller. With a file of passwords the rig's list names the user *controller* in the same way; the
controller, which connects, knows its rig by the endpoint alone.

A rule must cover the subscriber's own key expression, so both ends subscribe to exactly what the list names. Whoever
else connects is given what this end listens to and answers, and that it is there: a zenoh program sends only what another
listens to, and so what it writes comes to this end and is denied here, where `transport.links.zenoh_refusals` counts it.
"""

from __future__ import annotations

import os
import re
import socket
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from transport.links import Role, TransportError
from transport.links.authentication import check_certificate, refuse_revoked, revoked_names
from transport.links.private_directory import read_secret

if TYPE_CHECKING:
    import zenoh


OPTIONS: Final = ("keys", "ca", "cert", "key", "rig", "controller", "users")
"""Options of a zenoh URI that say who may send."""

_PASSED: Final = {"ca": "{keys}/ca.pem", "cert": "{keys}/{name}.pem", "key": "{keys}/{name}.key"}


class Access(Struct, frozen=True, kw_only=True):
    """Who this end is, and whose packets it accepts.

    Args:
        role: this end's.
        peer: name that the other end's certificate or login must have.
        tls: `ca`, `cert` and `key`, paths; empty without TLS.
        users: file of ``name:password`` lines, empty without passwords.
        revoked: names whose certificates are let in no more.
    """

    role: Role
    peer: str
    tls: dict[str, str]
    users: str
    revoked: frozenset[str] = frozenset()

    def config(self, name: str) -> dict[str, Any]:
        """Return the entries of zenoh's configuration.

        Args:
            name: second part of the key expressions.

        Raises:
            TransportError: the file of passwords is not to be had, or has no line for the controller.
        """
        entries: dict[str, Any] = {}
        subject: dict[str, Any] = {}
        if self.tls:
            at = "transport/link/tls"
            entries = {f"{at}/root_ca_certificate": self.tls["ca"], f"{at}/enable_mtls": True}
            entries[f"{at}/close_link_on_expiration"] = True
            for side in ("listen", "connect"):
                entries |= {f"{at}/{side}_certificate": self.tls["cert"], f"{at}/{side}_private_key": self.tls["key"]}
            subject = {"cert_common_names": [self.peer]}
        if self.users:
            lines = read_secret(self.users, "the file of passwords").decode(errors="replace").split("\n")
            known = dict(line.strip().split(":", 1) for line in lines if ":" in line)
            login = self.peer if self.role == "rig" else "controller"
            if login not in known:
                raise TransportError(f"{self.users}: no line {login}:PASSWORD")
            if self.role == "rig":
                mine = {"user": "rig", "password": os.urandom(16).hex()}  # never used: a rig connects to none
                entries["transport/auth/usrpwd"] = mine | {"dictionary_file": self.users}
                subject |= {"usernames": [self.peer]}
            else:
                entries["transport/auth/usrpwd"] = {"user": login, "password": known[login]}
        if subject:
            entries["access_control"] = _deny_all_but(subject, self.role, name)
        return entries


def _deny_all_but(subject: dict[str, Any], role: Role, name: str) -> dict[str, Any]:
    sends, receives = ("sensor", "control") if role == "rig" else ("control", "sensor")
    to, of = ("egress", "ingress") if role == "rig" else ("ingress", "egress")  # of the rig's answers, of questions to it

    def allow(flow: str, message: str, *keys: str) -> dict[str, Any]:
        key_exprs = [f"hil/{name}/{key}" for key in keys]
        return {"id": f"{message} {flow}", "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": key_exprs}

    tokens = {"rig": ("rig", "commander/*/*/*"), "controller": ("controller", "controller/*/*/*")}
    declared = [
        allow("egress", "declare_subscriber", receives),
        allow("egress", "declare_queryable", "info"),
        allow("egress", "liveliness_token", *tokens[role]),
    ]
    peers = [
        allow("ingress", "put", receives),
        allow("egress", "put", sends),
        allow("ingress", "declare_subscriber", sends),
        allow("ingress", "declare_queryable", "info"),
        allow("ingress", "liveliness_token", *tokens["controller" if role == "rig" else "rig"]),
        allow(of, "query", "info"),
        allow(to, "reply", "info"),
    ]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [*declared, *peers],
        "subjects": [{"id": "peer", **subject}, {"id": "anybody"}],
        "policies": [
            {"id": "only", "rules": [rule["id"] for rule in (*declared, *peers)], "subjects": ["peer"]},
            {"id": "declared", "rules": [rule["id"] for rule in declared], "subjects": ["anybody"]},
        ],
    }


def access(uri: str, role: Role, protocol: str, options: dict[str, str]) -> Access:
    """Take the options that say who may send out of a URI's.

    ``keys=DIR`` stands for ``ca=DIR/ca.pem&cert=DIR/NAME.pem&key=DIR/NAME.key``, as `hil keys new` makes them; NAME is this
    end's, rig or controller unless ``rig=`` or ``controller=`` choose another. ``{role}`` in a path is rig or controller, so that
    one URI serves both ends.

    Args:
        uri: for messages.
        role: this end's.
        protocol: zenoh's, such as tls.
        options: of the URI; those in `OPTIONS` are taken out.

    Raises:
        TransportError: certificates without TLS, TLS without certificates, files that are not to be had, a
            certificate that the other end would refuse, or a name that is revoked.
    """
    said: dict[str, str] = {option: options.pop(option) for option in OPTIONS if option in options}
    if "keys" in said:
        made = {k: v.replace("{name}", said.get(role, role)).replace("{keys}", said["keys"]) for k, v in _PASSED.items()}
        said = made | {k: v for k, v in said.items() if k != "keys"}
    tls = {name: said[name].replace("{role}", role) for name in _PASSED if name in said}
    if protocol == "tls" and len(tls) < len(_PASSED):
        raise TransportError(
            f"link {uri!r}: tls/ needs ca, cert and key, or keys=DIR of `hil keys new DIR`: without them any program may connect"
        )
    if protocol != "tls" and tls:
        raise TransportError(f"link {uri!r}: {', '.join(sorted(tls))}: certificates need an endpoint tls/host:port")
    peer = said.get("controller", "controller") if role == "rig" else said.get("rig", "rig")
    try:
        if tls:
            check_certificate(tls["ca"], tls["cert"], said.get(role, role))
            read_secret(tls["key"], f"the private key of the {role}")
            refuse_revoked(tls["ca"], peer)
        if "users" in said:
            read_secret(said["users"], "the file of passwords")
    except TransportError as error:
        raise TransportError(f"link {uri!r}: {error}") from error
    revoked = revoked_names(tls["ca"]) if tls else frozenset[str]()
    absolute = {k: str(Path(v).absolute()) for k, v in tls.items()}
    return Access(role=role, peer=peer, tls=absolute, users=said.get("users", ""), revoked=revoked)


LEASE_S: Final = 1.0
"""A peer that says nothing for so long is gone for zenoh."""

_PATIENCE_S: Final = 1.5 * LEASE_S
"""For so long one that died without a word may still stand in its role."""

_MOST: Final = 256
"""Controllers that an end keeps in mind."""


def own_name(session: str) -> str:
    """Return who this process is, as the end of a key expression: session, host and pid.

    Args:
        session: of its link.
    """
    host = re.sub(r"[^A-Za-z0-9_.-]", "-", socket.gethostname())[:64] or "host"
    return f"{session}/{host}/{os.getpid()}"


class Claims:
    """What one end of a link knows of the controllers on it.

    One controller commands a rig, from whatever machine: the rig says by a token which one that is.

    A controller of ours has a liveliness token ``hil/<name>/controller/<session>/<host>/<pid>``, which zenoh takes away when it
    ends, dies or is silent for a lease. The rig accepts the first of them and says so with a token of its own,
    ``hil/<name>/commander/<session>/<host>/<pid>``. A controller that sees another one's there takes no packet, and says whose it
    is; what it has sent already, the rig throws away. The rig decides, so two that come at once cannot both win.

    A program without such a token is no controller of ours: what it answers shows in the answers.

    Args:
        session: zenoh's, open.
        name: of the link.
        role: of this end.
        own: `own_name` of this end.
    """

    def __init__(self, session: zenoh.Session, name: str, role: Role, own: str) -> None:
        import zenoh

        self._session, self._own = session, own
        self._where = f"hil/{name}/commander"
        self._alive: list[str] = []  # rig: controllers, in the order in which they came
        self._commanders: set[str] = set()  # controller: whom rigs accept
        self._said: zenoh.LivelinessToken | None = None
        self._since_s: float | None = None
        alive = session.liveliness()
        self._token = alive.declare_token(f"hil/{name}/rig" if role == "rig" else f"hil/{name}/controller/{own}")
        key, took = (f"hil/{name}/controller", self._met) if role == "rig" else (self._where, self._seen)
        alive.declare_subscriber(f"{key}/*/*/*", zenoh.handlers.Callback(took, indirect=False), history=True)

    def _met(self, sample: zenoh.Sample) -> None:
        """Keep whom this rig accepts: the first that came and has not gone."""
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

    def _seen(self, sample: zenoh.Sample) -> None:
        who = _end_of(sample)
        if not _came(sample):
            self._commanders = self._commanders - {who}
        elif len(self._commanders) < _MOST:
            self._commanders = self._commanders | {who}

    def admits(self, sample: zenoh.Sample) -> bool:
        """Return whether a packet is to be taken: not from a controller of ours that the rig does not accept, and not by one.

        Args:
            sample: from the link, with the sender's session attached.
        """
        if not (self._alive[1:] or self._commanders):
            return True
        about = "" if sample.attachment is None else sample.attachment.to_bytes().decode(errors="replace")
        return self._alone and not any(about.endswith(f"session={who.partition('/')[0]}") for who in self._alive[1:])

    @property
    def _alone(self) -> bool:
        return not self._commanders or self._own in self._commanders

    def check(self, uri: str) -> None:
        """Refuse to go on where the rig accepts another controller, and has for longer than one that died stands there.

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
            _, host, pid = min(self._commanders).split("/")
            raise TransportError(
                f"link {uri!r}: the rig has another controller already, process {pid} on {host}; stop it, or take another name"
            )


def _end_of(sample: zenoh.Sample) -> str:
    return "/".join(str(sample.key_expr).split("/")[-3:])


def _came(sample: zenoh.Sample) -> bool:
    return str(sample.kind).endswith("PUT")
